// What lies under the cursor: place, class and node of the quadtree.

import type Feature from 'ol/Feature';
import { fromExtent } from 'ol/geom/Polygon';
import { type Leaf, getRegion } from './api';
import { get, tell } from './dom';
import { type Grid, isSound, short, stands, word } from './grid';
import type { Tiles } from './tiles';

export class Readout {
  private at: [number, number] | null = null;
  private asking = false;
  private ended = false;
  private leaf: Leaf | null = null;

  constructor(
    private readonly grid: Grid,
    private readonly tiles: Tiles,
    private readonly mark: Feature,
    private readonly onClass: (cls: number | null) => void,
  ) {}

  /** Reads at a point, or nowhere. */
  move(at: [number, number] | null): void {
    this.at = at;
    if (at === null) {
      this.clear();
      return;
    }
    tell(get('at'), `x ${this.grid.metres(at[0])}  y ${this.grid.metres(at[1])} m`);
    if (!this.grid.holds(...at)) {
      this.leaf = null;
      this.mark.setGeometry(undefined);
      this.show(this.grid.map.unknown_class, 'outside the map');
      return;
    }
    if (this.leaf !== null && this.within(this.leaf, at)) return;
    const cls = this.tiles.classAt(...at);
    // Where tiles are coarser than leaves this is the maximum there; the leaf's own class follows in a moment.
    if (cls !== null && this.leaf === null) this.show(cls, '…');
    void this.ask();
  }

  /** The map changed: what was read may be old. */
  changed(): void {
    this.leaf = null;
    if (this.at !== null) void this.ask();
  }

  /** Reads at a point and says it aloud. */
  async speak(at: [number, number]): Promise<void> {
    this.leaf = null;
    this.move(at);
    while (this.asking) await new Promise((go) => setTimeout(go, 20));
    const parts = ['at', 'class', 'node'].map((id) => get(id).textContent);
    tell(get('spoken'), parts.join(', '));
  }

  dispose(): void {
    this.ended = true;
    this.at = null;
    this.clear();
  }

  private clear(): void {
    this.leaf = null;
    this.mark.setGeometry(undefined);
    for (const id of ['at', 'class', 'node']) tell(get(id), '–');
    this.onClass(null);
  }

  private async ask(): Promise<void> {
    if (this.asking) return;
    this.asking = true;
    // One request at a time; it ends at the latest place.
    for (;;) {
      const at = this.at;
      if (at === null || this.ended || !this.grid.holds(...at)) break;
      const leaf = await this.leafAt(at);
      if (this.ended) break;
      const same = this.at !== null && this.at[0] === at[0] && this.at[1] === at[1];
      if (leaf !== null && this.at !== null && this.within(leaf, this.at)) {
        this.leaf = leaf;
        this.showLeaf(leaf);
        break;
      }
      if (same) break;
    }
    this.asking = false;
  }

  private async leafAt([x, y]: [number, number]): Promise<Leaf | null> {
    const { config, name } = this.grid.map;
    const bit = config.resolution / 1000;
    const box = this.grid.clip({ min_x: x, min_y: y, max_x: x + bit, max_y: y + bit });
    if (box === null) return null;
    try {
      const leaves = await getRegion(name, this.grid.at, box, config.depth);
      return leaves.find((leaf) => this.within(leaf, [x, y])) ?? null;
    } catch {
      return null;
    }
  }

  private within(leaf: Leaf, [x, y]: [number, number]): boolean {
    const box = this.grid.node(leaf.depth, leaf.x, leaf.y);
    return x >= box.min_x && y >= box.min_y && x < box.max_x && y < box.max_y;
  }

  private showLeaf(leaf: Leaf): void {
    const box = this.grid.node(leaf.depth, leaf.x, leaf.y);
    this.mark.setGeometry(fromExtent([box.min_x, box.min_y, box.max_x, box.max_y]));
    const size = `${short(this.grid.size(leaf.depth))} m`;
    this.show(leaf.class, `node ${leaf.depth}/${leaf.x}/${leaf.y} · ${size}`);
  }

  private show(cls: number, node: string): void {
    const { unknown_class: unknown } = this.grid.map;
    const kind = word(cls, unknown);
    const spare = unknown - 1 - cls;
    const margin = kind === 'free' && isSound(this.grid.map) ? ` · ${stands(spare)}` : '';
    tell(get('class'), `class ${cls} ${kind}${margin}`);
    tell(get('node'), node);
    this.onClass(cls);
  }
}
