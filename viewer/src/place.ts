// Where the page looks, in its address, so that a view can be kept and passed on.

export interface Place {
  map: string;
  x: number;
  y: number;
  /** Metres a pixel. */
  resolution: number;
}

export function read(hash: string): { map: string | null; place: Place | null } {
  const values = new URLSearchParams(hash.replace(/^#/, ''));
  const map = values.get('map');
  const [x, y, resolution] = ['x', 'y', 'r'].map((name) => Number.parseFloat(values.get(name) ?? '')) as [number, number, number];
  const whole = map !== null && [x, y, resolution].every(Number.isFinite) && resolution > 0;
  return { map, place: whole ? { map, x, y, resolution } : null };
}

export function write({ map, x, y, resolution }: Place): string {
  const digits = Math.max(0, Math.ceil(-Math.log10(resolution)) + 1);
  return `#map=${map}&x=${x.toFixed(digits)}&y=${y.toFixed(digits)}&r=${Number(resolution.toPrecision(6))}`;
}
