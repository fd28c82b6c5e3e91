// One map on the page: its layers, panels and streams, from choosing it to choosing another.

import Feature from 'ol/Feature';
import OlMap from 'ol/Map';
import View from 'ol/View';
import { defaults as controls } from 'ol/control/defaults';
import { defaults as interactions } from 'ol/interaction/defaults';
import KeyboardPan from 'ol/interaction/KeyboardPan';
import KeyboardZoom from 'ol/interaction/KeyboardZoom';
import VectorLayer from 'ol/layer/Vector';
import Projection from 'ol/proj/Projection';
import VectorSource from 'ol/source/Vector';
import { type Change, type MapDetails, getMap, getTile } from './api';
import { Check, type Tool } from './check';
import { Difference, pixels } from './difference';
import { get, make, paced, tell } from './dom';
import { mapped } from './extent';
import { Grid, plural, short } from './grid';
import { Legend } from './legend';
import { Live, type LiveState } from './live';
import { Outlines } from './outlines';
import { Palette, type Theme } from './palette';
import type { Place } from './place';
import { Readout } from './readout';
import { Robots } from './robots';
import { Scale } from './scale';
import { type Look, NOW, Snapshots } from './snapshots';
import { colour, nodeStyle } from './styles';
import { type Fetch, Tiles } from './tiles';

/** Steps of two from the farthest look, the root in 256 pixels, to the closest: a leaf is then 64 pixels wide. */
const closest = (depth: number) => Math.max(1, depth - 8 + 6);

const LIVE_WORDS: Record<LiveState, string> = { live: 'live', reconnecting: 'reconnecting', gone: 'map is gone' };

const RULES: Record<string, string> = {
  EVIDENCE_GUARANTEED: 'guaranteed',
  EVIDENCE_OUTER: 'outer: no guarantee',
  EVIDENCE_INNER: 'inner: no guarantee',
};

export class Session {
  readonly check: Check;
  readonly robots: Robots;
  private readonly grid: Grid;
  private readonly map: OlMap;
  private readonly view: View;
  private readonly projection: Projection;
  private readonly size: () => [number, number];
  private readonly tiles: Tiles;
  /** What changed, where that is looked at. */
  private difference: Tiles | null = null;
  private seen: Look = NOW;
  private readonly outlines: Outlines;
  private readonly readout: Readout;
  private readonly mark: VectorLayer;
  private readonly legend: Legend;
  private readonly snapshots: Snapshots;
  private readonly live: Live;
  private ended = false;
  /** Nobody has moved the map yet: it shows all that is mapped, as that grows. */
  private untouched: boolean;
  private readonly hands = new AbortController();
  private readonly factsSoon = paced(2000, () => void this.facts());

  constructor(
    private details: MapDetails,
    private theme: Theme,
    place: Place | null,
    onPlace: (place: Place) => void,
    onTool: (tool: Tool) => void,
    private readonly onGone: () => void,
  ) {
    const { bounds, config, name, revision } = details;
    this.grid = new Grid(details);
    const extent = [bounds.min_x, bounds.min_y, bounds.max_x, bounds.max_y];
    const projection = (this.projection = new Projection({ code: `ubbmap:${name}`, units: 'm', extent, getPointResolution: (resolution) => resolution }));
    this.view = new View({
      projection,
      center: place ? [place.x, place.y] : [(bounds.min_x + bounds.max_x) / 2, (bounds.min_y + bounds.max_y) / 2],
      resolution: place?.resolution ?? this.grid.side / 1024,
      maxResolution: this.grid.side / 256,
      minZoom: 0,
      maxZoom: closest(config.depth),
      extent,
      constrainOnlyCenter: true,
      // The address says where the page looks: exactly there.
      smoothResolutionConstraint: false,
      enableRotation: false,
    });
    const size = (this.size = () => (this.map.getSize() ?? [1, 1]) as [number, number]);
    this.tiles = new Tiles(this.grid, projection, this.view, this.classes(null), this.palette(), size);
    this.outlines = new Outlines(this.grid, this.view, size, () => colour('outline'), (text) => tell(get('outlines-note'), text));
    const node = new Feature();
    node.setStyle(nodeStyle);
    this.mark = new VectorLayer({ source: new VectorSource({ features: [node] }) });
    this.robots = new Robots(this.grid, this.view, () => (this.untouched = false));
    this.map = new OlMap({
      target: get('map'),
      view: this.view,
      layers: [this.tiles.layer, this.outlines.layer, this.mark, this.robots.layer],
      controls: controls({ attribution: false, rotate: false }).extend([new Scale()]),
      // Keys are the page's: they work wherever the focus is, but where it types or slides.
      keyboardEventTarget: document,
      interactions: interactions({ altShiftDragRotate: false, pinchRotate: false, keyboard: false }),
    });
    const condition = ({ originalEvent }: { originalEvent: Event }) => !takesArrows(originalEvent.target) && !hasModifier(originalEvent);
    this.map.addInteraction(new KeyboardPan({ condition }));
    this.map.addInteraction(new KeyboardZoom({ condition }));
    this.check = new Check(this.grid, this.map, onTool);
    this.map.addLayer(this.check.layer);
    this.legend = new Legend(this.grid);
    this.readout = new Readout(this.grid, this.tiles, node, (cls) => this.legend.mark(cls));
    this.snapshots = new Snapshots(name, theme, (look) => this.look(look));
    this.recolour(theme);
    this.untouched = place === null;
    this.listen(onPlace);
    this.showFacts();
    tell(get('revision'), revision);
    this.live = new Live(name, revision, (change) => this.changed(change), (state) => this.state(state));
    if (place === null) void this.fit(false);
  }

  outline(on: boolean, depth: number): void {
    this.outlines.set(on, depth);
  }

  recolour(theme: Theme): void {
    this.theme = theme;
    const palette = this.palette();
    this.tiles.recolour(palette);
    this.legend.draw(palette);
    get('map').style.background = palette.outside;
    this.difference?.recolour({ pixels: pixels(theme), blank: 0 });
    this.snapshots.recolour(theme);
    this.check.recolour();
    this.robots.recolour();
    this.outlines.layer.changed();
    this.mark.changed();
  }

  /** Shows all that is mapped. */
  async fit(smooth = true): Promise<void> {
    let box = null;
    try {
      box = await mapped(this.grid);
    } catch {
      // The map is shown as a whole then; what fails is told by the mark of the stream.
    }
    if (this.ended) return;
    const { min_x, min_y, max_x, max_y } = box ?? this.grid.map.bounds;
    this.view.fit([min_x, min_y, max_x, max_y], { padding: [24, 24, 40, 24], duration: smooth ? 250 : 0 });
  }

  speak(): void {
    void this.readout.speak(this.view.getCenter() as [number, number]);
  }

  resized(): void {
    this.map.updateSize();
  }

  dispose(): void {
    this.ended = true;
    this.live.close();
    this.hands.abort();
    this.check.dispose();
    this.readout.dispose();
    this.snapshots.dispose();
    this.robots.dispose();
    this.difference?.dispose();
    this.outlines.dispose();
    this.tiles.dispose();
    this.map.setTarget(undefined);
    this.map.dispose();
    tell(get('outlines-note'), '');
  }

  /** The map as it is now. */
  back(): void {
    this.snapshots.back();
  }

  /** Looks at a snapshot, or at what changed. */
  private look(look: Look): void {
    const before = this.seen;
    this.seen = look;
    this.grid.at = look.at;
    if (look.at !== before.at) this.tiles.from(this.classes(look.at));
    if (look.at !== before.at || look.since !== before.since) this.compare(look);
    this.readout.changed();
    this.check.again();
    this.outlines.changed();
  }

  /** Draws what changed over a map that is faint then. */
  private compare({ at, since }: Look): void {
    if (this.difference !== null) {
      this.map.removeLayer(this.difference.layer);
      this.difference.dispose();
      this.difference = null;
    }
    this.tiles.layer.setOpacity(since === null ? 1 : 0.4);
    if (since === null) return;
    const codes = new Difference(this.details.name, this.details.unknown_class, since, at);
    const colours = { pixels: pixels(this.theme), blank: 0 };
    const fetch: Fetch = (z, x, y, tag) => codes.fetch(z, x, y, tag);
    this.difference = new Tiles(this.grid, this.projection, this.view, fetch, colours, this.size, 'difference-layer');
    this.map.getLayers().insertAt(1, this.difference.layer);
  }

  private classes(at: string | null): Fetch {
    return (z, x, y, tag) => getTile(this.details.name, z, x, y, tag, at);
  }

  private palette(): Palette {
    return new Palette(this.details.config.classes, this.details.unknown_class, this.theme);
  }

  private listen(onPlace: (place: Place) => void): void {
    this.map.on('pointermove', (event) => {
      if (!event.dragging) this.readout.move(event.coordinate as [number, number]);
    });
    this.map.on('click', (event) => this.readout.move(event.coordinate as [number, number]));
    get('map').addEventListener('pointerleave', (event) => {
      if (event.pointerType === 'mouse') this.readout.move(null);
    });
    // From the first touch on the map stays where it is put.
    const touched = () => (this.untouched = false);
    for (const event of ['pointerdown', 'wheel']) {
      get('map').addEventListener(event, touched, { signal: this.hands.signal, capture: true, passive: true });
    }
    const moves = (event: KeyboardEvent) => !takesArrows(event.target) && /^(Arrow|[-+=]$)/.test(event.key);
    document.addEventListener('keydown', (event) => moves(event) && touched(), { signal: this.hands.signal, capture: true });
    this.map.on('moveend', () => {
      const [x, y] = this.view.getCenter() as [number, number];
      onPlace({ map: this.details.name, x, y, resolution: this.view.getResolution() ?? 1 });
    });
  }

  private changed(change: Change): void {
    tell(get('revision'), change.revision);
    this.robots.take(change.robots);
    if (!change.everything && change.blocks.length === 0) return;
    this.factsSoon();
    // A snapshot stays as it is.
    if (this.seen.at !== null) return;
    const blocks = change.everything ? null : change.blocks;
    this.tiles.changed(blocks);
    this.difference?.changed(blocks);
    this.readout.changed();
    this.check.again();
    this.outlines.changed();
  }

  private state(state: LiveState): void {
    const live = get('live');
    tell(live, LIVE_WORDS[state]);
    live.dataset.state = state;
    if (state === 'gone') this.onGone();
  }

  private async facts(): Promise<void> {
    let details;
    try {
      details = await getMap(this.details.name);
    } catch {
      return;
    }
    if (this.ended) return;
    // Another map of this name: nothing here is of it.
    if (details.created !== this.details.created) {
      this.onGone();
      return;
    }
    this.details = details;
    this.showFacts();
    if (this.untouched) void this.fit();
  }

  private showFacts(): void {
    const { config, bounds, robots, created } = this.details;
    const scans = robots.reduce((sum, robot) => sum + Number(robot.applied), 0);
    const rows: [string, string][] = [
      ['Leaf', `${short(config.resolution)} m at depth ${config.depth}`],
      ['Root', `${short(this.grid.side)} m from ${short(bounds.min_x)}, ${short(bounds.min_y)}`],
      ['Classes', `${config.classes}, unknown is ${this.details.unknown_class}`],
      ['Evidence', RULES[config.evidence] ?? config.evidence],
      ['Thinnest obstacle', config.min_obstacle_width > 0 ? `${short(config.min_obstacle_width)} m` : 'any'],
      ['Robots', robots.length === 0 ? 'none yet' : `${robots.length}, ${plural(scans, 'numbered scan')}`],
      ['Created', new Date(created * 1000).toLocaleString()],
    ];
    get('facts').replaceChildren(...rows.flatMap(([term, text]) => [make('dt', {}, term), make('dd', {}, text)]));
  }
}

function hasModifier(event: Event): boolean {
  return event instanceof KeyboardEvent && (event.ctrlKey || event.metaKey || event.altKey);
}

const within = (target: EventTarget | null, selector: string) => target instanceof Element && target.closest(selector) !== null;

/** Does an element take letters for itself? */
export const takesLetters = (target: EventTarget | null) =>
  within(target, 'input:not([type=checkbox], [type=range]), select, textarea, dialog[open]');

/** Does an element take arrows for itself? */
const takesArrows = (target: EventTarget | null) => takesLetters(target) || within(target, 'input[type=range]');
