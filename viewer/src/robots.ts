// Robots: the box that holds each one's pose, the headings that it may have, where it came from, and a list to follow one by.

import Feature from 'ol/Feature';
import LineString from 'ol/geom/LineString';
import Point from 'ol/geom/Point';
import VectorLayer from 'ol/layer/Vector';
import VectorSource from 'ol/source/Vector';
import type View from 'ol/View';
import { type RobotPose, serverTime } from './api';
import { get, make, tell } from './dom';
import { type Grid, plural, short } from './grid';
import { robotStyle, trailStyle } from './styles';

/** A robot that was silent for so long is drawn hollow, milliseconds. */
const SILENT = 10_000;

/** Most points of a trail. */
const TRAIL = 400;

/** Most robots that the list names. */
const ROWS = 40;

/** How often the list is written, milliseconds. */
const PACE = 500;

interface Known {
  robot: RobotPose;
  body: Feature<Point>;
  trail: Feature<LineString>;
  row: Row;
}

interface Row {
  line: HTMLLIElement;
  button: HTMLButtonElement;
  seen: HTMLElement;
}

export class Robots {
  readonly layer: VectorLayer;
  private readonly known = new Map<string, Known>();
  private readonly source = new VectorSource<Feature>();
  private followed: string | null = null;
  /** Where the view was put last to follow; elsewhere it was moved by hand. */
  private put: [number, number] | null = null;
  private readonly timer: number;
  private listed = '';

  constructor(
    private readonly grid: Grid,
    private readonly view: View,
    private readonly onFollow: () => void,
  ) {
    // Above the map, below what is asked; names give way to one another.
    this.layer = new VectorLayer({ source: this.source, className: 'robots-layer', declutter: true, updateWhileAnimating: true, updateWhileInteracting: true });
    this.timer = window.setInterval(() => this.write(), PACE);
    const shown = get<HTMLInputElement>('robots-shown');
    const trails = get<HTMLInputElement>('trails');
    shown.onchange = () => this.layer.setVisible(shown.checked);
    trails.onchange = () => this.trails(trails.checked);
    this.layer.setVisible(shown.checked);
    get('robot-list').replaceChildren();
    this.write();
  }

  /** Where robots are now. */
  take(robots: RobotPose[]): void {
    for (const robot of robots) {
      const known = this.known.get(robot.robot) ?? this.add(robot);
      known.robot = robot;
      const centre = middle(robot);
      known.body.getGeometry()?.setCoordinates(centre);
      known.body.set('robot', robot);
      known.body.set('silent', false);
      const line = known.trail.getGeometry();
      const last = line?.getLastCoordinate();
      if (line !== undefined && (last === undefined || last[0] !== centre[0] || last[1] !== centre[1])) {
        if (line.getCoordinates().length >= TRAIL) line.setCoordinates(line.getCoordinates().slice(-TRAIL / 2));
        line.appendCoordinate(centre);
      }
      if (robot.robot === this.followed) this.go(known);
    }
  }

  /** Follows the next robot by name; behind the last one nobody. */
  next(): void {
    const names = this.names();
    const at = this.followed === null ? 0 : names.indexOf(this.followed) + 1;
    this.follow(names[at] ?? null);
  }

  follow(name: string | null): void {
    this.followed = name;
    this.put = null;
    if (name !== null) this.onFollow();
    const known = name === null ? undefined : this.known.get(name);
    if (known !== undefined) this.go(known);
    this.write();
  }

  recolour(): void {
    this.layer.changed();
  }

  dispose(): void {
    clearInterval(this.timer);
    this.layer.dispose();
    get('robot-list').replaceChildren();
    tell(get('robots-note'), '');
  }

  private add(robot: RobotPose): Known {
    const body = new Feature(new Point(middle(robot)));
    body.setStyle(robotStyle);
    const trail = new Feature(new LineString([]));
    trail.setStyle(get<HTMLInputElement>('trails').checked ? trailStyle : []);
    this.source.addFeatures([trail, body]);
    const button = make('button', { type: 'button', className: 'follow', title: `follow ${robot.robot}` }, robot.robot);
    button.onclick = () => this.follow(this.followed === robot.robot ? null : robot.robot);
    const seen = make('span', { className: 'grow seen' });
    const known = { robot, body, trail, row: { line: make('li', {}, button, seen), button, seen } };
    this.known.set(robot.robot, known);
    return known;
  }

  private names(): string[] {
    return [...this.known.keys()].sort();
  }

  private trails(on: boolean): void {
    for (const { trail } of this.known.values()) trail.setStyle(on ? trailStyle : []);
  }

  /** Puts the view on a robot, unless it was moved away by hand: then the robot is let go. */
  private go(known: Known): void {
    const now = this.view.getCenter() as [number, number];
    const by = this.view.getResolution() ?? 1;
    if (this.put !== null && Math.hypot(now[0] - this.put[0], now[1] - this.put[1]) > 2 * by) {
      this.followed = null;
      this.put = null;
      this.write();
      return;
    }
    this.view.setCenter(middle(known.robot));
    this.put = this.view.getCenter() as [number, number];
  }

  private write(): void {
    const now = serverTime();
    const names = this.names();
    const rows = names.slice(0, ROWS);
    const listed = rows.join();
    if (listed !== this.listed) {
      this.listed = listed;
      get('robot-list').replaceChildren(...rows.map((name) => this.known.get(name)!.row.line));
    }
    for (const [name, { robot, body, row }] of this.known) {
      const silent = now - robot.received * 1000;
      row.button.setAttribute('aria-pressed', String(name === this.followed));
      tell(row.seen, `${ago(silent)} · ${this.width(robot)}`);
      body.set('silent', silent > SILENT);
    }
    const more = names.length - rows.length;
    const note = names.length === 0 ? 'No robot has sent a scan since the server started.' : more > 0 ? `and ${plural(more, 'more robot')}` : '';
    tell(get('robots-note'), note);
  }

  /** How wide the box is, as it is given: half of it to both sides. */
  private width({ pose }: RobotPose): string {
    const half = Math.max(pose.x.max - pose.x.min, pose.y.max - pose.y.min) / 2;
    const turn = ((pose.theta.max - pose.theta.min) / 2) * (180 / Math.PI);
    return `±${short(Number(half.toFixed(this.grid.digits)))} m ±${turn.toFixed(1)}°`;
  }
}

function middle({ pose }: RobotPose): [number, number] {
  return [(pose.x.min + pose.x.max) / 2, (pose.y.min + pose.y.max) / 2];
}

/** How long ago, in words that need not change every moment. */
function ago(milliseconds: number): string {
  const seconds = milliseconds / 1000;
  if (seconds < 3) return 'now';
  if (seconds < 60) return `${Math.floor(seconds)} s ago`;
  if (seconds < 3600) return `${Math.floor(seconds / 60)} min ago`;
  return `${Math.floor(seconds / 3600)} h ago`;
}
