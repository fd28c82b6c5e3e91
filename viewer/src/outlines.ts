// Outlines of the quadtree's nodes in the view, at most to a chosen depth, as thin lines.

import Layer from 'ol/layer/Layer';
import type { FrameState } from 'ol/Map';
import type View from 'ol/View';
import { type Bounds, type Leaf, getRegion } from './api';
import { make, paced } from './dom';
import { type Grid, plural, short } from './grid';

/** Most nodes drawn; where there are more, they are drawn coarser. */
const MOST = 20_000;

/** Nodes narrower than this are not drawn, pixels: lines would be all there is. */
const NARROWEST = 4;

/** A first look, where nothing is known of how many nodes there are. */
const FIRST = 1024;

interface Answer {
  leaves: Leaf[];
  depth: number;
}

export class Outlines {
  readonly layer: Layer;
  private leaves: Leaf[] = [];
  private on = false;
  private depth: number;
  private asked: AbortController | null = null;
  private readonly refreshSoon = paced(300, () => void this.refresh());

  constructor(
    private readonly grid: Grid,
    private readonly view: View,
    private readonly size: () => [number, number],
    private readonly colour: () => string,
    private readonly note: (text: string) => void,
  ) {
    this.depth = grid.map.config.depth;
    const canvas = make('canvas');
    // Within a box of its own: layers above would draw into a bare canvas, and this one would wipe it.
    const box = make('div', { className: 'outlines' }, canvas);
    // Without a place of its own it would lie below the tiles and push the layers above it down.
    for (const element of [box, canvas]) Object.assign(element.style, { position: 'absolute', inset: '0', width: '100%', height: '100%' });
    this.layer = new Layer({
      render: (frame) => {
        this.draw(canvas, frame);
        return box;
      },
    });
    view.on('change', this.refreshSoon);
  }

  set(on: boolean, depth: number): void {
    this.on = on;
    this.depth = depth;
    if (!on) {
      this.asked?.abort();
      this.leaves = [];
      this.layer.changed();
      this.note('');
      return;
    }
    this.refreshSoon();
  }

  changed(): void {
    this.refreshSoon();
  }

  dispose(): void {
    this.on = false;
    this.asked?.abort();
    this.view.un('change', this.refreshSoon);
    this.layer.dispose();
  }

  private async refresh(): Promise<void> {
    if (!this.on) return;
    const [min_x, min_y, max_x, max_y] = this.view.calculateExtent(this.size()) as [number, number, number, number];
    const box = this.grid.clip({ min_x, min_y, max_x, max_y });
    this.asked?.abort();
    const asked = new AbortController();
    this.asked = asked;
    try {
      const answer = box === null ? { leaves: [], depth: this.depth } : await this.ask(box, asked.signal);
      this.leaves = answer.leaves;
      this.layer.changed();
      this.note(this.words(answer));
    } catch (error) {
      if (!asked.signal.aborted) this.note(error instanceof Error ? error.message : String(error));
    }
  }

  /** Goes down as far as the number of nodes surely allows: each node that was cut has at most 4 below it a level. */
  private async ask(box: Bounds, signal: AbortSignal): Promise<Answer> {
    const width = Math.max(box.max_x - box.min_x, box.max_y - box.min_y);
    const narrowest = NARROWEST * (this.view.getResolution() ?? 1);
    const finest = Math.max(0, Math.floor(Math.log2(this.grid.side / narrowest)));
    const target = Math.min(this.depth, finest);
    let depth = Math.min(target, Math.max(0, Math.floor(Math.log2((this.grid.side / width) * Math.sqrt(FIRST)))));
    let leaves = await getRegion(this.grid.map.name, this.grid.at, box, depth, signal);
    while (depth < target) {
      const cut = leaves.filter((leaf) => leaf.depth === depth).length;
      const deeper = cut === 0 ? target : depth + Math.floor(Math.log2(MOST / cut) / 2);
      if (deeper <= depth) break;
      depth = Math.min(target, deeper);
      leaves = await getRegion(this.grid.map.name, this.grid.at, box, depth, signal);
      if (cut === 0) break;
    }
    return { leaves, depth };
  }

  private words({ leaves, depth }: Answer): string {
    const nodes = `${plural(leaves.length, 'node')} in view`;
    if (depth >= this.depth) return nodes;
    return `${nodes}, drawn to depth ${depth} (${short(this.grid.size(depth))} m): zoom in for finer ones`;
  }

  private draw(canvas: HTMLCanvasElement, frame: FrameState): void {
    const ratio = frame.pixelRatio;
    const [width, height] = frame.size as [number, number];
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
    const context = canvas.getContext('2d');
    if (context === null) return;
    const { center, resolution } = frame.viewState;
    const scale = ratio / resolution;
    const left = center[0]! - (width * resolution) / 2;
    const top = center[1]! + (height * resolution) / 2;
    // Half a pixel aside a line is one pixel wide.
    const snap = (value: number) => Math.round(value) + 0.5;
    context.beginPath();
    for (const leaf of this.leaves) {
      const box = this.grid.node(leaf.depth, leaf.x, leaf.y);
      const x = snap((box.min_x - left) * scale);
      const y = snap((top - box.max_y) * scale);
      context.rect(x, y, snap((box.max_x - left) * scale) - x, snap((top - box.min_y) * scale) - y);
    }
    context.strokeStyle = this.colour();
    context.lineWidth = 1;
    context.stroke();
  }
}
