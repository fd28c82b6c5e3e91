// What changed from one time of the map to another: each cell by what it was called and what it is called.

import { type TileClasses, getTile } from './api';
import type { Theme } from './palette';

/** No change of the word: nothing is drawn. */
const SAME = 0;

/** Most tiles of the earlier time that are kept: it does not change. */
const KEPT = 320;

export interface Kind {
  code: number;
  /** What is in the legend. */
  words: string;
  colours: Record<Theme, readonly [number, number, number]>;
}

// Orange against blue, as Okabe and Ito chose them, and no colour at all for what is unknown: told apart with all common kinds of
// colour vision. What was known before is the stronger of its hue.
export const KINDS: readonly Kind[] = [
  { code: 1, words: 'occupied, was free', colours: { light: [178, 58, 0], dark: [255, 122, 51] } },
  { code: 2, words: 'occupied, was unknown', colours: { light: [236, 160, 20], dark: [255, 214, 128] } },
  { code: 3, words: 'free, was occupied', colours: { light: [0, 74, 128], dark: [30, 118, 214] } },
  { code: 4, words: 'free, was unknown', colours: { light: [98, 184, 236], dark: [130, 200, 250] } },
  { code: 5, words: 'forgotten, now unknown', colours: { light: [44, 46, 50], dark: [242, 243, 245] } },
];

/** The code of a cell that had one class and has another. */
export function kind(from: number, to: number, unknown: number): number {
  const [before, after] = [Math.sign(from - unknown), Math.sign(to - unknown)];
  if (before === after) return SAME;
  if (after === 0) return 5;
  if (after > 0) return before < 0 ? 1 : 2;
  return before > 0 ? 3 : 4;
}

/** One word of pixels a code, as a canvas lies in memory. */
export function pixels(theme: Theme): Uint32Array {
  const words = new Uint32Array(256);
  const bytes = new Uint8ClampedArray(words.buffer);
  for (const { code, colours } of KINDS) bytes.set([...colours[theme], 255], code * 4);
  return words;
}

/** Tiles of codes. */
export class Difference {
  private readonly earlier = new Map<string, Promise<TileClasses>>();

  constructor(
    private readonly map: string,
    private readonly unknown: number,
    private readonly from: string,
    /** null: as the map is now. */
    private readonly to: string | null,
  ) {}

  async fetch(z: number, x: number, y: number, tag: string | null): Promise<TileClasses> {
    const later = await getTile(this.map, z, x, y, tag, this.to);
    if (later.classes === null) return later;
    const before = (await this.before(z, x, y)).classes!;
    const { classes: after } = later;
    const codes = new Uint8Array(after.length);
    for (let at = 0; at < codes.length; at++) codes[at] = kind(before[at]!, after[at]!, this.unknown);
    return { tag: later.tag, classes: codes };
  }

  private before(z: number, x: number, y: number): Promise<TileClasses> {
    const name = `${z}/${x}/${y}`;
    let tile = this.earlier.get(name);
    if (tile === undefined) {
      tile = getTile(this.map, z, x, y, null, this.from);
      tile.catch(() => this.earlier.delete(name));
    }
    // A map keeps its order: the last used stands last.
    this.earlier.delete(name);
    this.earlier.set(name, tile);
    for (const [oldest] of this.earlier) {
      if (this.earlier.size <= KEPT) break;
      this.earlier.delete(oldest);
    }
    return tile;
  }
}
