// The map's raster: tiles of classes, coloured here, drawn again in place when they change. A tile's canvas stays the same one, so
// what was drawn is there until what is new is drawn over it. What changed between two times is such a raster too, of codes.

import TileLayer from 'ol/layer/Tile';
import type Projection from 'ol/proj/Projection';
import ImageTile from 'ol/source/ImageTile';
import TileGrid from 'ol/tilegrid/TileGrid';
import type View from 'ol/View';
import type { Bounds, ChangedBlock, TileClasses } from './api';
import { paced } from './dom';
import { Grid, TILE_LEVELS } from './grid';

const SIDE = 256;

/** Most tiles kept here; OpenLayers keeps fewer, so none that it draws is forgotten. */
const KEPT = 320;
const KEPT_BY_LAYER = 160;

/** Requests at once: a browser has six connections, one of which is the stream of changes. */
const AT_ONCE = 4;

/** Changes are drawn this often at most, milliseconds. */
const PACE = 250;

/** After a request that failed, milliseconds. */
const RETRY = 2000;

/** Where tiles come from; the tag is the one of what is there already. */
export type Fetch = (z: number, x: number, y: number, tag: string | null) => Promise<TileClasses>;

/** How values are drawn. */
export interface Colours {
  /** One word of pixels a value, as a canvas lies in memory. */
  pixels: Uint32Array;
  /** The value that is drawn until there is one. */
  blank: number;
}

interface Cell {
  z: number;
  x: number;
  y: number;
  canvas: HTMLCanvasElement;
  classes: Uint8Array | null;
  tag: string | null;
  /** Counts the changes that concern this tile, and those that `classes` has. */
  wanted: number;
  drawn: number;
  loading: Promise<void> | null;
}

export class Tiles {
  readonly layer: TileLayer;
  private readonly cells = new Map<string, Cell>();
  private readonly tileGrid: TileGrid;
  private readonly deepest: number;
  private readonly refreshSoon = paced(PACE, () => this.refresh());
  private retry = 0;
  private ended = false;
  private readonly queue: (() => void)[] = [];
  private running = 0;

  constructor(
    private readonly grid: Grid,
    projection: Projection,
    private readonly view: View,
    private fetchTile: Fetch,
    private colours: Colours,
    private readonly size: () => [number, number],
    className = 'ol-layer',
  ) {
    const { bounds, config } = grid.map;
    this.deepest = Math.max(0, config.depth - TILE_LEVELS);
    const resolutions = Array.from({ length: this.deepest + 1 }, (_, z) => grid.size(z) / SIDE);
    const extent = [bounds.min_x, bounds.min_y, bounds.max_x, bounds.max_y];
    this.tileGrid = new TileGrid({ extent, origin: [bounds.min_x, bounds.max_y], resolutions, tileSize: SIDE });
    const source = new ImageTile({
      projection,
      tileGrid: this.tileGrid,
      interpolate: false,
      transition: 0,
      wrapX: false,
      // The coarser of two levels: its cells are maxima, so no wall falls between two pixels.
      zDirection: 1,
      loader: (z, x, fromTop) => this.load(z, x, 2 ** z - 1 - fromTop),
    });
    this.layer = new TileLayer({ source, className, cacheSize: KEPT_BY_LAYER, preload: 1 });
    view.on('change', this.refreshSoon);
  }

  /** What changed by the stream; null: everything. */
  changed(blocks: ChangedBlock[] | null): void {
    for (const cell of this.cells.values()) {
      if (blocks === null || blocks.some((block) => meets(cell, block))) cell.wanted++;
    }
    this.refreshSoon();
  }

  /** Takes tiles from elsewhere; what is drawn stays until they are there. A tag is of the contents, wherever they come from. */
  from(fetchTile: Fetch): void {
    this.fetchTile = fetchTile;
    this.changed(null);
  }

  recolour(colours: Colours): void {
    this.colours = colours;
    for (const cell of this.cells.values()) this.paint(cell);
    this.layer.changed();
  }

  /** The class of the cell drawn at a point, where it is there. */
  classAt(x: number, y: number): number | null {
    const { min_x, min_y } = this.grid.map.bounds;
    for (let z = this.level(); z >= 0; z--) {
      const size = this.grid.size(z);
      const [column, row] = [(x - min_x) / size, (y - min_y) / size];
      const cell = this.cells.get(key(z, Math.floor(column), Math.floor(row)));
      if (!cell?.classes) continue;
      const [cx, cy] = [Math.floor((column % 1) * SIDE), Math.floor((row % 1) * SIDE)];
      return cell.classes[cy * SIDE + cx] ?? null;
    }
    return null;
  }

  dispose(): void {
    this.ended = true;
    clearTimeout(this.retry);
    this.view.un('change', this.refreshSoon);
    this.cells.clear();
    this.layer.dispose();
  }

  private async load(z: number, x: number, y: number): Promise<HTMLCanvasElement> {
    const cell = this.cell(z, x, y);
    if (cell.classes === null || cell.drawn < cell.wanted) await this.fetch(cell);
    return cell.canvas;
  }

  private cell(z: number, x: number, y: number): Cell {
    const name = key(z, x, y);
    let cell = this.cells.get(name);
    if (cell === undefined) {
      const canvas = document.createElement('canvas');
      canvas.width = canvas.height = SIDE;
      cell = { z, x, y, canvas, classes: null, tag: null, wanted: 0, drawn: 0, loading: null };
      this.forget();
    } else {
      this.cells.delete(name);
    }
    // A map keeps its order: the last used stands last.
    this.cells.set(name, cell);
    return cell;
  }

  private forget(): void {
    for (const [name, cell] of this.cells) {
      if (this.cells.size < KEPT) return;
      if (cell.loading === null && !this.isVisible(cell)) this.cells.delete(name);
    }
  }

  /** Loads a tile's classes; one that fails stays as it is and is asked for again. */
  private fetch(cell: Cell): Promise<void> {
    cell.loading ??= this.turn(async () => {
      const { wanted } = cell;
      const { fetchTile } = this;
      try {
        const tile = await fetchTile(cell.z, cell.x, cell.y, cell.tag);
        // Of where tiles came from before; what is wanted now is asked for below.
        if (fetchTile !== this.fetchTile) throw new Error('late');
        cell.drawn = wanted;
        if (tile.classes !== null) {
          cell.tag = tile.tag;
          cell.classes = tile.classes;
          this.paint(cell);
          this.layer.changed();
        }
      } catch {
        if (cell.classes === null) this.paint(cell);
        clearTimeout(this.retry);
        this.retry = window.setTimeout(this.refreshSoon, RETRY);
      }
      cell.loading = null;
      if (cell.drawn < cell.wanted) this.refreshSoon();
    });
    return cell.loading;
  }

  private async turn(work: () => Promise<void>): Promise<void> {
    if (this.running >= AT_ONCE) await new Promise<void>((go) => this.queue.push(go));
    this.running++;
    if (!this.ended) await work();
    this.running--;
    this.queue.shift()?.();
  }

  /** Asks for the visible tiles that changed or could not be had. */
  private refresh(): void {
    if (this.ended) return;
    for (const cell of this.cells.values()) {
      const late = cell.classes === null || cell.drawn < cell.wanted;
      if (late && cell.loading === null && this.isVisible(cell)) void this.fetch(cell);
    }
  }

  private level(): number {
    return this.tileGrid.getZForResolution(this.view.getResolution() ?? 1, 1);
  }

  private isVisible(cell: Cell): boolean {
    if (cell.z !== this.level()) return false;
    const [min_x, min_y, max_x, max_y] = this.view.calculateExtent(this.size()) as [number, number, number, number];
    const box = this.grid.node(cell.z, cell.x, cell.y);
    return meet(box, { min_x, min_y, max_x, max_y });
  }

  private paint(cell: Cell): void {
    const context = cell.canvas.getContext('2d');
    if (context === null) return;
    const image = context.createImageData(SIDE, SIDE);
    const pixels = new Uint32Array(image.data.buffer);
    const { pixels: colours, blank } = this.colours;
    const { classes } = cell;
    if (classes === null) {
      pixels.fill(colours[blank]!);
    } else {
      // Row 0 of the classes is at min_y, row 0 of an image at its top.
      for (let row = 0; row < SIDE; row++) {
        const from = (SIDE - 1 - row) * SIDE;
        for (let column = 0; column < SIDE; column++) pixels[row * SIDE + column] = colours[classes[from + column]!]!;
      }
    }
    context.putImageData(image, 0, 0);
  }
}

const key = (z: number, x: number, y: number) => `${z}/${x}/${y}`;

const meet = (a: Bounds, b: Bounds) => a.min_x < b.max_x && b.min_x < a.max_x && a.min_y < b.max_y && b.min_y < a.max_y;

/** Is one of two nodes within the other? */
function meets(cell: Cell, block: ChangedBlock): boolean {
  const depth = Math.min(cell.z, block.depth);
  const shift = (value: number, by: number) => Math.floor(value / 2 ** by);
  return (
    shift(cell.x, cell.z - depth) === shift(block.x, block.depth - depth) &&
    shift(cell.y, cell.z - depth) === shift(block.y, block.depth - depth)
  );
}
