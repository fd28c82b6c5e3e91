// How regions, witnesses and nodes are drawn, in the page's own colours.

import type { FeatureLike } from 'ol/Feature';
import Circle from 'ol/style/Circle';
import Fill from 'ol/style/Fill';
import Stroke from 'ol/style/Stroke';
import Style from 'ol/style/Style';
import type { StyleFunction } from 'ol/style/Style';
import { getCenter } from 'ol/extent';
import Point from 'ol/geom/Point';

let sheet: CSSStyleDeclaration | null = null;

/** A colour of the style sheet. */
export function colour(name: string): string {
  sheet ??= getComputedStyle(document.documentElement);
  return sheet.getPropertyValue(`--${name}`).trim();
}

/** Free is a whole line, not free a broken one, not known yet a thin one: colour is not needed to tell them apart. */
function line(free: boolean | null, width = 2.5): Stroke {
  const name = free === null ? 'sketch' : free ? 'answer-free' : 'answer-taken';
  return new Stroke({ color: colour(name), width: free === null ? 1.5 : width, lineDash: free === false ? [8, 5] : undefined });
}

const halo = () => new Stroke({ color: colour('halo'), width: 5 });

export const shapeStyle = (free: () => boolean | null): StyleFunction => () => [
  new Style({ stroke: halo() }),
  new Style({ stroke: line(free()), fill: new Fill({ color: colour(free() === false ? 'fill-taken' : 'fill-free') }) }),
];

export const sketchStyle: StyleFunction = () => [
  new Style({ stroke: halo() }),
  new Style({
    stroke: line(null),
    fill: new Fill({ color: colour('fill-free') }),
    image: new Circle({ radius: 4, fill: new Fill({ color: colour('sketch') }), stroke: new Stroke({ color: colour('halo'), width: 2 }) }),
  }),
];

/** A path is all points within its radius: a band with round ends. */
export function pathStyle(radius: () => number, free: (() => boolean | null) | null): StyleFunction {
  return (_feature: FeatureLike, resolution: number) => {
    const answer = free === null ? null : free();
    const band = new Stroke({
      color: colour(answer === false ? 'fill-taken' : 'fill-free'),
      width: Math.max(1, (2 * radius()) / resolution),
      lineCap: 'round',
      lineJoin: 'round',
    });
    const point = new Circle({ radius: 4, fill: new Fill({ color: colour('sketch') }), stroke: new Stroke({ color: colour('halo'), width: 2 }) });
    const styles = [new Style({ stroke: band }), new Style({ stroke: halo() }), new Style({ stroke: line(answer), image: point })];
    return styles;
  };
}

/** The leaf itself, and a ring about it for when it is small. */
export const witnessStyle: StyleFunction = (feature) => {
  const geometry = feature.getGeometry();
  if (geometry === undefined) return [];
  const centre = new Point(getCenter(geometry.getExtent()));
  const ring = (name: string, width: number) =>
    new Style({ geometry: centre, image: new Circle({ radius: 11, stroke: new Stroke({ color: colour(name), width }) }), zIndex: 2 });
  return [
    ring('halo', 5),
    ring('answer-taken', 2.5),
    new Style({ stroke: new Stroke({ color: colour('answer-taken'), width: 2 }), zIndex: 3 }),
  ];
};

export const nodeStyle: StyleFunction = () => [
  new Style({ stroke: new Stroke({ color: colour('halo'), width: 3 }) }),
  new Style({ stroke: new Stroke({ color: colour('node'), width: 1.25 }) }),
];
