// Is a region guaranteed free? Draw it or type it; the answer stands in words and is asked again when the map changes.

import Collection from 'ol/Collection';
import Feature from 'ol/Feature';
import type OlMap from 'ol/Map';
import { fromExtent } from 'ol/geom/Polygon';
import Draw, { createBox } from 'ol/interaction/Draw';
import Modify from 'ol/interaction/Modify';
import VectorLayer from 'ol/layer/Vector';
import VectorSource from 'ol/source/Vector';
import { type FreeAnswer, type FreeResult, guaranteedFree } from './api';
import { get, make, paced } from './dom';
import { type Grid, plural, short, stands, word } from './grid';
import { type Kind, type Shape, drawn, fields, geometry, region } from './shape';
import { pathStyle, shapeStyle, sketchStyle, witnessStyle } from './styles';

export type Tool = 'pan' | Kind;

const HINTS: Record<Tool, string> = {
  pan: '',
  disc: 'Point at the centre, then at the rim.',
  box: 'Point at two corners.',
  path: 'Point at each corner of the way; twice, or Enter, ends it.',
};

/** Half the width of a robot, where nothing else was typed, metres. */
const RADIUS = 0.3;

export class Check {
  readonly layer: VectorLayer;
  private readonly shapes = new Collection<Feature>();
  private readonly witness = new Feature();
  private readonly modify: Modify;
  private draw: Draw | null = null;
  private tool: Tool = 'pan';
  private shape: Shape | null = null;
  private radius = RADIUS;
  private free: boolean | null = null;
  private asked: AbortController | null = null;
  private readonly askSoon = paced(300, () => void this.ask());

  constructor(
    private readonly grid: Grid,
    private readonly map: OlMap,
    private readonly onTool: (tool: Tool) => void,
  ) {
    const source = new VectorSource({ features: this.shapes });
    source.addFeature(this.witness);
    this.witness.setStyle(witnessStyle);
    this.layer = new VectorLayer({ source, updateWhileAnimating: true, updateWhileInteracting: true });
    // A box pulled at a corner would be a box no more: its fields take changes.
    const editable = new Collection<Feature>();
    this.shapes.on('add', ({ element }) => {
      if (element !== this.witness && this.shape?.kind !== 'box') editable.push(element);
    });
    this.shapes.on('remove', ({ element }) => editable.remove(element));
    this.modify = new Modify({ features: editable });
    this.modify.on('modifyend', ({ features }) => {
      const changed = features.item(0)?.getGeometry();
      if (this.shape && changed) this.take(drawn(this.shape.kind, changed, this.radius, grid.digits));
    });
    map.addInteraction(this.modify);
    this.bounds();
  }

  choose(tool: Tool): void {
    if (this.draw !== null) this.map.removeInteraction(this.draw);
    this.draw = null;
    this.tool = tool;
    this.modify.setActive(tool === 'pan');
    if (tool !== 'pan') {
      const type = tool === 'path' ? 'LineString' : 'Circle';
      const draw = new Draw({
        type,
        geometryFunction: tool === 'box' ? createBox() : undefined,
        style: tool === 'path' ? pathStyle(() => this.radius, null) : sketchStyle,
        stopClick: true,
      });
      draw.on('drawend', ({ feature }) => {
        const made = feature.getGeometry();
        if (made !== undefined) this.take(drawn(tool, made, this.radius, this.grid.digits));
        // The click that ends the shape is not to begin the next one, nor to zoom.
        setTimeout(() => this.onTool('pan'), 0);
      });
      this.draw = draw;
      this.map.addInteraction(draw);
    }
    get('hint').textContent = HINTS[tool];
  }

  /** Ends a path that is being drawn. */
  finish(): void {
    if (this.tool === 'path') this.draw?.finishDrawing();
  }

  back(): void {
    if (this.tool === 'path') this.draw?.removeLastPoint();
  }

  /** Takes a region to ask about. */
  take(shape: Shape): void {
    this.shape = shape;
    this.free = null;
    if (shape.kind === 'path') this.radius = shape.radius;
    this.show();
    const form = get<HTMLFormElement>('shape');
    form.hidden = false;
    get('clear').hidden = false;
    fields(form, shape, (typed) => this.take(typed));
    this.askSoon();
  }

  clear(): void {
    this.asked?.abort();
    this.shape = null;
    this.free = null;
    this.witness.setGeometry(undefined);
    this.show();
    for (const id of ['shape', 'clear', 'answer', 'verdict']) get(id).hidden = true;
  }

  /** The map or the tolerance changed. */
  again(): void {
    if (this.shape !== null) this.askSoon();
  }

  recolour(): void {
    this.layer.changed();
  }

  dispose(): void {
    this.clear();
    this.choose('pan');
    this.map.removeInteraction(this.modify);
    this.layer.dispose();
  }

  private bounds(): void {
    const slider = get<HTMLInputElement>('tolerance');
    slider.max = String(Math.max(0, this.grid.map.unknown_class - 2));
  }

  private show(): void {
    for (const feature of this.shapes.getArray().filter((one) => one !== this.witness)) this.shapes.remove(feature);
    if (this.shape === null) return;
    const feature = new Feature(geometry(this.shape));
    const free = () => this.free;
    feature.setStyle(this.shape.kind === 'path' ? pathStyle(() => this.radius, free) : shapeStyle(free));
    this.shapes.push(feature);
  }

  private async ask(): Promise<void> {
    const { shape } = this;
    if (shape === null) return;
    this.asked?.abort();
    const asked = new AbortController();
    this.asked = asked;
    const tolerance = get<HTMLInputElement>('tolerance').valueAsNumber;
    try {
      const answer = await guaranteedFree(this.grid.map.name, this.grid.at, region(shape), tolerance, asked.signal);
      if (!asked.signal.aborted) this.answer(answer, tolerance);
    } catch (error) {
      if (asked.signal.aborted) return;
      this.free = null;
      this.witness.setGeometry(undefined);
      this.say('none', 'No answer', [error instanceof Error ? error.message : String(error)]);
    }
    this.layer.changed();
  }

  private answer(answer: FreeAnswer, tolerance: number): void {
    const result = answer.results[0];
    if (result === undefined) return;
    this.free = result.free;
    const { witness } = result;
    if (witness === undefined) this.witness.setGeometry(undefined);
    else {
      const { min_x, min_y, size } = witness;
      this.witness.setGeometry(fromExtent([min_x, min_y, min_x + size, min_y + size]));
    }
    const lines = result.free ? this.freeWords(result) : this.witnessWords(result, tolerance);
    if (!answer.sound) lines.push('The map’s evidence rule gives no guarantee: this says what was measured.');
    const head = result.free ? (answer.sound ? 'Guaranteed free' : 'Free') : 'Not free';
    this.say(result.free ? 'free' : 'taken', head, [...lines, `revision ${answer.revision}`]);
  }

  private freeWords(result: FreeResult): string[] {
    const spare = this.grid.map.unknown_class - 1 - result.max_class;
    return [`worst leaf class ${result.max_class}, ${stands(spare)}`];
  }

  private witnessWords(result: FreeResult, tolerance: number): string[] {
    const { witness } = result;
    if (witness === undefined) return [];
    const place = `${this.grid.metres(witness.min_x)}, ${this.grid.metres(witness.min_y)}`;
    const leaf = `leaf at ${place} (${short(witness.size)} m)`;
    const kind = word(witness.class, this.grid.map.unknown_class);
    const outside = witness.depth === undefined ? ', outside the map' : '';
    const lines =
      result.reason === 'REASON_TOLERANCE'
        ? [`${leaf}, class ${witness.class}, is not free enough to stand ${plural(tolerance, 'broken scan')}`]
        : [`${kind} ${leaf}, class ${witness.class}${outside}`];
    if (witness.distance !== undefined) lines.push(`${this.grid.metres(witness.distance)} m along the path`);
    return lines;
  }

  private say(state: string, head: string, lines: string[]): void {
    const answer = get('answer');
    const old = answer.textContent;
    const parts = [make('strong', {}, head), ...lines.map((line) => make('p', {}, line))];
    if (old !== parts.map((part) => part.textContent).join('')) answer.replaceChildren(...parts);
    // Where the panels are folded away the answer stands over the map, in one line.
    const verdict = get('verdict');
    verdict.textContent = [head, lines[0]].join(': ');
    for (const element of [answer, verdict]) {
      element.dataset.state = state;
      element.hidden = false;
    }
  }
}
