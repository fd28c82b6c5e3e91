// Where nodes lie, and how lengths and classes are written.

import type { Bounds, MapSummary } from './api';

/** Levels from a tile to its cells: 256 x 256. */
export const TILE_LEVELS = 8;

/** The map's root and its nodes, metres. */
export class Grid {
  readonly side: number;
  /** The snapshot that is looked at; null: the map as it is now. */
  at: string | null = null;

  constructor(readonly map: MapSummary) {
    this.side = map.bounds.max_x - map.bounds.min_x;
  }

  /** Side of a node of this depth. */
  size(depth: number): number {
    return this.side / 2 ** depth;
  }

  /** The square of a node. */
  node(depth: number, x: number, y: number): Bounds {
    const size = this.size(depth);
    const { min_x, min_y } = this.map.bounds;
    return { min_x: min_x + x * size, min_y: min_y + y * size, max_x: min_x + (x + 1) * size, max_y: min_y + (y + 1) * size };
  }

  holds(x: number, y: number): boolean {
    const { min_x, min_y, max_x, max_y } = this.map.bounds;
    return x >= min_x && y >= min_y && x < max_x && y < max_y;
  }

  /** The part of a box within the root; null where there is none. */
  clip(box: Bounds): Bounds | null {
    const root = this.map.bounds;
    const cut = {
      min_x: Math.max(box.min_x, root.min_x),
      min_y: Math.max(box.min_y, root.min_y),
      max_x: Math.min(box.max_x, root.max_x),
      max_y: Math.min(box.max_y, root.max_y),
    };
    return cut.min_x < cut.max_x && cut.min_y < cut.max_y ? cut : null;
  }

  /** Digits behind the point that tell leaves apart, and one more. */
  get digits(): number {
    return Math.min(6, Math.max(2, Math.ceil(-Math.log10(this.map.config.resolution)) + 1));
  }

  metres(value: number): string {
    const text = value.toFixed(this.digits);
    return Number(text) === 0 ? text.replace('-', '') : text;
  }
}

/** A size without digits that say nothing: 0.05, 12.8, 3276.8. */
export function short(value: number): string {
  return String(Number(value.toPrecision(6)));
}

export function word(cls: number, unknown: number): 'free' | 'unknown' | 'occupied' {
  if (cls < unknown) return 'free';
  return cls === unknown ? 'unknown' : 'occupied';
}

export const plural = (count: number, one: string, many = `${one}s`) =>
  `${count.toLocaleString('en')} ${count === 1 ? one : many}`;

/** Is the map's rule the one whose answers are guaranteed? */
export const isSound = (map: MapSummary) => map.config.evidence === 'EVIDENCE_GUARANTEED';

/** What a free class still allows: so many of the scans applied there may have broken an assumption. */
export const stands = (spare: number) => (spare > 0 ? `stands ${plural(spare, 'broken scan')}` : 'stands no broken scan');
