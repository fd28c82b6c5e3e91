// The classes of the map with their colours and words.

import { get, make } from './dom';
import { type Grid, stands, word } from './grid';
import type { Palette } from './palette';

/** Most rows; of more classes only some are named. */
const ROWS = 20;

export class Legend {
  private readonly rows = new Map<number, HTMLElement>();
  private shown: number[] = [];

  constructor(private readonly grid: Grid) {
    const { unknown_class: unknown } = grid.map;
    const k = grid.map.config.classes;
    this.shown = Array.from({ length: k }, (_, at) => at + 1);
    if (k > ROWS) {
      const step = Math.ceil(k / ROWS);
      const named = new Set([1, unknown - 1, unknown, unknown + 1, k]);
      this.shown = this.shown.filter((cls) => named.has(cls) || cls % step === 0);
    }
  }

  draw(palette: Palette): void {
    const { unknown_class: unknown } = this.grid.map;
    this.rows.clear();
    const rows = this.shown.map((cls) => {
      const swatch = make('span', { className: 'swatch' });
      swatch.style.background = palette.css(cls);
      const row = make('div', { className: 'class' }, swatch, make('span', { className: 'number' }, String(cls)), this.words(cls, unknown));
      row.dataset.class = String(cls);
      this.rows.set(cls, row);
      return row;
    });
    get('legend').replaceChildren(...rows);
  }

  mark(cls: number | null): void {
    const nearest = cls === null ? null : this.shown.reduce((best, one) => (Math.abs(one - cls) < Math.abs(best - cls) ? one : best));
    for (const [one, row] of this.rows) row.classList.toggle('here', one === nearest);
  }

  private words(cls: number, unknown: number): string {
    const kind = word(cls, unknown);
    if (kind === 'free') return `free, ${stands(unknown - 1 - cls)}`;
    if (kind === 'unknown') return 'unknown';
    return cls === this.grid.map.config.classes ? 'occupied, most often seen' : 'occupied';
  }
}
