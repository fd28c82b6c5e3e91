// Colours of classes. Lightness alone tells free from unknown from occupied, for those who see no colours; the hues, blue against
// orange, are told apart by all common kinds of colour blindness.

type Rgb = readonly [number, number, number];

export type Theme = 'light' | 'dark';

interface Stops {
  /** Class 1, and the last one below unknown. */
  free: readonly [Rgb, Rgb];
  unknown: Rgb;
  /** The first class above unknown, and k. */
  occupied: readonly [Rgb, Rgb];
  outside: string;
}

const STOPS: Record<Theme, Stops> = {
  light: {
    free: [[255, 255, 255], [206, 228, 242]],
    unknown: [173, 181, 189],
    occupied: [[196, 120, 40], [58, 24, 6]],
    outside: '#c3c9cf',
  },
  dark: {
    free: [[9, 20, 30], [26, 56, 78]],
    unknown: [84, 92, 101],
    occupied: [[150, 92, 32], [255, 192, 104]],
    outside: '#3b4149',
  },
};

function mix(from: Rgb, to: Rgb, part: number): Rgb {
  return [0, 1, 2].map((at) => Math.round(from[at]! + (to[at]! - from[at]!) * part)) as unknown as Rgb;
}

export class Palette {
  /** One word of pixels a class, as a canvas lies in memory. */
  readonly pixels = new Uint32Array(256);
  /** What is not there yet is drawn unknown. */
  readonly blank: number;
  readonly outside: string;
  private readonly colours: Rgb[] = [];

  constructor(classes: number, unknown: number, theme: Theme) {
    const stops = STOPS[theme];
    this.blank = unknown;
    this.outside = stops.outside;
    const part = (cls: number, from: number, to: number) => (to > from ? (cls - from) / (to - from) : 0);
    const bytes = new Uint8ClampedArray(this.pixels.buffer);
    for (let cls = 0; cls < 256; cls++) {
      let colour = stops.unknown;
      if (cls < unknown) colour = mix(stops.free[0], stops.free[1], part(Math.max(cls, 1), 1, unknown - 1));
      if (cls > unknown) colour = mix(stops.occupied[0], stops.occupied[1], part(Math.min(cls, classes), unknown + 1, classes));
      this.colours.push(colour);
      bytes.set([...colour, 255], cls * 4);
    }
  }

  css(cls: number): string {
    return `rgb(${this.colours[cls]!.join(' ')})`;
  }
}
