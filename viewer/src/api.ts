// The REST interface as the viewer uses it: types of the answers, and errors as sentences.

export interface Point {
  x: number;
  y: number;
}

export interface Bounds {
  min_x: number;
  min_y: number;
  max_x: number;
  max_y: number;
}

export interface MapSummary {
  name: string;
  revision: string;
  config: {
    resolution: number;
    depth: number;
    origin: Point;
    classes: number;
    evidence: string;
    min_obstacle_width: number;
    sensors: Record<string, unknown>;
  };
  created: number;
  bounds: Bounds;
  unknown_class: number;
}

export interface MapDetails extends MapSummary {
  robots: { robot: string; highest_sequence?: string; applied: string }[];
}

/** A node of the quadtree with the maximum class of its leaves. */
export interface Leaf {
  depth: number;
  x: number;
  y: number;
  class: number;
}

export type Region =
  | { disc: { center: Point; radius: number } }
  | { box: Bounds }
  | { path: { points: Point[]; radius: number } };

export interface Witness {
  depth?: number;
  x?: number;
  y?: number;
  class: number;
  min_x: number;
  min_y: number;
  size: number;
  distance?: number;
}

export interface FreeResult {
  free: boolean;
  max_class: number;
  reason?: string;
  witness?: Witness;
}

export interface FreeAnswer {
  revision: string;
  sound: boolean;
  results: FreeResult[];
}

export interface ChangedBlock {
  depth: number;
  x: number;
  y: number;
}

export interface Interval {
  min: number;
  max: number;
}

/** A robot at its last applied scan; `received` by the server's clock, seconds. */
export interface RobotPose {
  robot: string;
  stamp: number;
  sequence?: string;
  sensor: string;
  pose: { x: Interval; y: Interval; theta: Interval };
  revision: string;
  received: number;
}

export interface Change {
  revision: string;
  since: string;
  everything: boolean;
  blocks: ChangedBlock[];
  robots: RobotPose[];
}

export interface Snapshot {
  name: string;
  revision: string;
  created: number;
}

/** A tile's classes, row 0 at min_y; null where the tile still has the tag that was sent. */
export interface TileClasses {
  tag: string | null;
  classes: Uint8Array | null;
}

/** An answer other than a success, in the server's words. */
export class ApiError extends Error {
  constructor(
    readonly status: number,
    readonly code: string,
    detail: string,
  ) {
    super(detail);
  }
}

/** How far the server's clock is ahead of this one, milliseconds. */
let ahead = 0;

/** The time by the server's clock, milliseconds since the Unix epoch, to a second or so. */
export const serverTime = () => Date.now() + ahead;

const HEADER = { accept: 'application/json' };

async function problem(response: Response): Promise<ApiError> {
  try {
    const body = (await response.json()) as { code?: string; detail?: string };
    return new ApiError(response.status, body.code ?? '', body.detail ?? response.statusText);
  } catch {
    return new ApiError(response.status, '', `the server answered ${response.status} ${response.statusText}`);
  }
}

async function json<T>(path: string, init: RequestInit = {}): Promise<T> {
  const response = await fetch(path, { ...init, headers: { ...HEADER, ...init.headers } });
  const time = Date.parse(response.headers.get('date') ?? '');
  if (!Number.isNaN(time)) ahead = time - Date.now();
  if (!response.ok) throw await problem(response);
  return (await response.json()) as T;
}

function post<T>(path: string, body: unknown, signal?: AbortSignal): Promise<T> {
  const headers = { 'content-type': 'application/json' };
  return json<T>(path, { method: 'POST', headers, body: JSON.stringify(body), signal });
}

const of = (map: string) => `/v1/maps/${encodeURIComponent(map)}`;

export const listMaps = async () => (await json<{ maps: MapSummary[] }>('/v1/maps')).maps;

export const getMap = (map: string) => json<MapDetails>(of(map));

/** Leaves of a box, at most to a depth; `at`: of this snapshot, null: as the map is now. */
export async function getRegion(map: string, at: string | null, box: Bounds, depth: number, signal?: AbortSignal): Promise<Leaf[]> {
  const query = new URLSearchParams({
    min_x: String(box.min_x),
    min_y: String(box.min_y),
    max_x: String(box.max_x),
    max_y: String(box.max_y),
    depth: String(depth),
    ...(at === null ? {} : { snapshot: at }),
  });
  return (await json<{ leaves: Leaf[] }>(`${of(map)}/region?${query}`, { signal })).leaves;
}

export function guaranteedFree(map: string, at: string | null, region: Region, tolerance: number, signal: AbortSignal) {
  return post<FreeAnswer>(`${of(map)}/guaranteed-free`, { regions: [region], tolerance, snapshot: at ?? '' }, signal);
}

/** A tile as a NumPy array; `tag` is the one of the classes that are there already. */
export async function getTile(
  map: string,
  z: number,
  x: number,
  y: number,
  tag: string | null,
  at: string | null,
): Promise<TileClasses> {
  const headers: Record<string, string> = tag === null ? {} : { 'if-none-match': tag };
  // The tag is compared here, so the browser need not keep a copy of its own.
  const query = at === null ? '' : `?snapshot=${encodeURIComponent(at)}`;
  const response = await fetch(`${of(map)}/tiles/${z}/${x}/${y}.npy${query}`, { headers, cache: 'no-store' });
  if (response.status === 304) return { tag, classes: null };
  if (!response.ok) throw await problem(response);
  return { tag: response.headers.get('etag'), classes: npy(new Uint8Array(await response.arrayBuffer())) };
}

/** The bytes of a `.npy` file of u8 behind its header. */
export function npy(bytes: Uint8Array): Uint8Array {
  const magic = [0x93, 0x4e, 0x55, 0x4d, 0x50, 0x59];
  if (!magic.every((byte, at) => bytes[at] === byte)) throw new Error('the tile is no NumPy array');
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const start = bytes[6] === 1 ? 10 + view.getUint16(8, true) : 12 + view.getUint32(8, true);
  return bytes.subarray(start);
}

export const eventsPath = (map: string, since: string) => `${of(map)}/events?since=${since}&robots=true`;

export const listSnapshots = async (map: string) =>
  (await json<{ snapshots: Snapshot[] }>(`${of(map)}/snapshots`)).snapshots;

export const takeSnapshot = (map: string, name: string) => post<Snapshot>(`${of(map)}/snapshots`, { name });

export const restoreSnapshot = (map: string, name: string) =>
  post<{ revision: string }>(`${of(map)}/snapshots/${encodeURIComponent(name)}/restore`, {});

export async function deleteSnapshot(map: string, name: string): Promise<void> {
  const response = await fetch(`${of(map)}/snapshots/${encodeURIComponent(name)}`, { method: 'DELETE', headers: HEADER });
  if (!response.ok) throw await problem(response);
}
