// The region that is asked about: as drawn, as typed, and as the server takes it.

import Circle from 'ol/geom/Circle';
import type Geometry from 'ol/geom/Geometry';
import LineString from 'ol/geom/LineString';
import { fromExtent } from 'ol/geom/Polygon';
import type { Region } from './api';
import { make } from './dom';

export type Kind = 'disc' | 'box' | 'path';

export type Shape =
  | { kind: 'disc'; x: number; y: number; radius: number }
  | { kind: 'box'; min_x: number; min_y: number; max_x: number; max_y: number }
  | { kind: 'path'; points: [number, number][]; radius: number };

export function geometry(shape: Shape): Geometry {
  switch (shape.kind) {
    case 'disc':
      return new Circle([shape.x, shape.y], shape.radius);
    case 'box':
      return fromExtent([shape.min_x, shape.min_y, shape.max_x, shape.max_y]);
    case 'path':
      return new LineString(shape.points);
  }
}

export function region(shape: Shape): Region {
  switch (shape.kind) {
    case 'disc':
      return { disc: { center: { x: shape.x, y: shape.y }, radius: shape.radius } };
    case 'box': {
      const { min_x, min_y, max_x, max_y } = shape;
      return { box: { min_x, min_y, max_x, max_y } };
    }
    case 'path':
      return { path: { points: shape.points.map(([x, y]) => ({ x, y })), radius: shape.radius } };
  }
}

/** What was drawn, rounded to what the fields show, so that what is asked is what is read. */
export function drawn(kind: Kind, drawn: Geometry, radius: number, digits: number): Shape {
  const round = (value: number) => Number(value.toFixed(digits));
  if (drawn instanceof Circle) {
    const [x, y] = drawn.getCenter() as [number, number];
    return { kind: 'disc', x: round(x), y: round(y), radius: round(drawn.getRadius()) };
  }
  if (kind === 'path' && drawn instanceof LineString) {
    const points = drawn.getCoordinates().map(([x, y]) => [round(x!), round(y!)] as [number, number]);
    return { kind: 'path', points, radius };
  }
  const [min_x, min_y, max_x, max_y] = drawn.getExtent().map(round) as [number, number, number, number];
  return { kind: 'box', min_x, min_y, max_x, max_y };
}

const LABELS: Record<string, string> = {
  x: 'x', y: 'y', radius: 'radius', min_x: 'min x', min_y: 'min y', max_x: 'max x', max_y: 'max y', points: 'points',
};

/** Fields of a shape, metres; `onEdit` gets what they say when all of it is valid. */
export function fields(form: HTMLFormElement, shape: Shape, onEdit: (shape: Shape) => void): void {
  const number = (name: string, value: number) =>
    make('label', {}, `${LABELS[name]} `, make('input', {
      name, type: 'number', step: 'any', value: String(value), required: true, min: name === 'radius' ? '0' : '',
    }), ' m');
  const { kind, ...values } = shape;
  const rows = Object.entries(values).map(([name, value]) => {
    if (typeof value === 'number') return number(name, value);
    const text = value.map((point) => point.join(',')).join(' ');
    const input = make('input', { name, type: 'text', value: text, required: true, spellcheck: false, autocomplete: 'off' });
    input.placeholder = 'x,y x,y ..';
    return make('label', { className: 'wide' }, `${LABELS[name]} `, input);
  });
  form.replaceChildren(...rows);
  form.dataset.kind = kind;
  form.onsubmit = (event) => event.preventDefault();
  form.onchange = () => {
    const typed = read(form, kind);
    if (typed !== null) onEdit(typed);
  };
}

function read(form: HTMLFormElement, kind: Kind): Shape | null {
  const input = (name: string) => form.elements.namedItem(name) as HTMLInputElement;
  const value = (name: string) => input(name).valueAsNumber;
  if (kind === 'path') {
    const field = input('points');
    const points = field.value.trim().split(/[\s;]+/).map((pair) => pair.split(',').map(Number) as [number, number]);
    const fine = points.every((point) => point.length === 2 && point.every(Number.isFinite));
    field.setCustomValidity(fine ? '' : 'pairs x,y apart by spaces, metres');
    return form.reportValidity() ? { kind, points, radius: value('radius') } : null;
  }
  if (!form.reportValidity()) return null;
  if (kind === 'disc') return { kind, x: value('x'), y: value('y'), radius: value('radius') };
  const [x1, y1, x2, y2] = [value('min_x'), value('min_y'), value('max_x'), value('max_y')];
  return { kind, min_x: Math.min(x1, x2), min_y: Math.min(y1, y2), max_x: Math.max(x1, x2), max_y: Math.max(y1, y2) };
}
