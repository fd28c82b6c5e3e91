// How regions, witnesses and nodes are drawn, in the page's own colours.

import type { FeatureLike } from 'ol/Feature';
import Circle from 'ol/style/Circle';
import Fill from 'ol/style/Fill';
import Stroke from 'ol/style/Stroke';
import Style from 'ol/style/Style';
import type { StyleFunction } from 'ol/style/Style';
import { getCenter } from 'ol/extent';
import Point from 'ol/geom/Point';
import Polygon from 'ol/geom/Polygon';
import Text from 'ol/style/Text';
import type { RobotPose } from './api';

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

/** Sizes of a robot's marks, pixels. */
const [DOT, WEDGE] = [5, 26];

/** How finely the end of a wedge is drawn, radians. */
const STEP = 0.1;

/** The box that holds the pose, the headings from its middle, a dot to be found by from afar, and the name. A robot that is silent is hollow. */
export const robotStyle: StyleFunction = (feature, resolution) => {
  const robot = feature.get('robot') as RobotPose | undefined;
  if (robot === undefined) return [];
  const { x, y, theta } = robot.pose;
  const silent = feature.get('silent') === true;
  const [ink, fill, halo] = [colour('robot'), colour('robot-fill'), colour('halo')];
  const middle = [(x.min + x.max) / 2, (y.min + y.max) / 2] as [number, number];
  const steps = Math.max(1, Math.ceil((theta.max - theta.min) / STEP));
  const rim = Array.from({ length: steps + 1 }, (_, at) => {
    const angle = theta.min + ((theta.max - theta.min) * at) / steps;
    return [middle[0] + WEDGE * resolution * Math.cos(angle), middle[1] + WEDGE * resolution * Math.sin(angle)];
  });
  const wedge = new Polygon([[middle, ...rim, middle]]);
  const box = new Polygon([[[x.min, y.min], [x.max, y.min], [x.max, y.max], [x.min, y.max], [x.min, y.min]]]);
  const dot = (width: number, edge: string, inside: string) =>
    new Circle({ radius: DOT, stroke: new Stroke({ color: edge, width }), fill: new Fill({ color: inside }), declutterMode: 'none' });
  return [
    new Style({ geometry: wedge, stroke: new Stroke({ color: halo, width: 5, lineJoin: 'round' }) }),
    new Style({ geometry: wedge, stroke: new Stroke({ color: ink, width: 2.5, lineJoin: 'round' }), fill: new Fill({ color: fill }) }),
    new Style({ geometry: box, stroke: new Stroke({ color: halo, width: 4 }) }),
    new Style({ geometry: box, stroke: new Stroke({ color: ink, width: 1.5 }), fill: new Fill({ color: fill }) }),
    new Style({ image: dot(4, halo, halo), zIndex: 1 }),
    new Style({
      image: dot(2, ink, silent ? colour('panel') : ink),
      text: new Text({
        text: robot.robot,
        font: '600 12px system-ui, "DejaVu Sans", sans-serif',
        offsetY: 18,
        fill: new Fill({ color: colour('text') }),
        stroke: new Stroke({ color: halo, width: 4 }),
      }),
      zIndex: 2,
    }),
  ];
};

export const trailStyle: StyleFunction = () => [
  new Style({ stroke: new Stroke({ color: colour('halo'), width: 3.5 }) }),
  new Style({ stroke: new Stroke({ color: colour('robot'), width: 1.5 }) }),
];
