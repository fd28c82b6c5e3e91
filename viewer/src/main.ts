// The page: choosing a map, the bar, the panels and the keys.

import './style.css';
import { type MapSummary, getMap, listMaps } from './api';
import type { Tool } from './check';
import { get, make, tell } from './dom';
import { short } from './grid';
import { type Place, read, write } from './place';
import { Session, takesLetters } from './session';
import { Themes } from './theme';

/** How often the list of maps is asked for, milliseconds. */
const POLL = 5000;

const NARROW = window.matchMedia('(max-width: 720px)');

let session: Session | null = null;
let chosen: string | null = null;
/** The chosen map was deleted; one of its name may come again. */
let gone = false;
const themes = new Themes((theme) => session?.recolour(theme));

const select = get<HTMLSelectElement>('maps');
const tolerance = get<HTMLInputElement>('tolerance');
const outlines = get<HTMLInputElement>('outlines');
const depth = get<HTMLInputElement>('depth');
const help = get<HTMLDialogElement>('help');
const side = get('side');

// Choosing a map

async function choose(name: string, place: Place | null): Promise<void> {
  chosen = name;
  gone = false;
  let details;
  try {
    details = await getMap(name);
  } catch (error) {
    chosen = null;
    empty(error instanceof Error ? error.message : String(error));
    return;
  }
  if (chosen !== name) return;
  session?.dispose();
  empty(null);
  select.value = name;
  document.title = `${name} · ubbmap`;
  const { config, unknown_class: unknown } = details;
  tolerance.max = String(Math.max(0, unknown - 2));
  depth.max = String(config.depth);
  depth.value = String(config.depth);
  session = new Session(details, themes.theme, place, keep, useTool, () => {
    gone = true;
    void refresh();
  });
  useTool('pan');
  showTolerance();
  showOutlines(config.resolution * 2 ** config.depth);
}

function keep(place: Place): void {
  history.replaceState(null, '', write(place));
}

function empty(text: string | null): void {
  const box = get('empty');
  box.hidden = text === null;
  tell(box, text ?? '');
}

async function refresh(): Promise<void> {
  let maps: MapSummary[];
  try {
    maps = await listMaps();
  } catch {
    if (session === null) empty('The server does not answer.');
    return;
  }
  const names = maps.map((map) => map.name);
  const shown = [...select.options].map((option) => option.value);
  if (names.join() !== shown.join()) {
    select.replaceChildren(...names.map((name) => make('option', { value: name }, name)));
    if (chosen !== null) select.value = chosen;
  }
  if (names.length === 0 && session === null) {
    empty('There is no map yet. PUT /v1/maps/{map} makes one; it appears here.');
    return;
  }
  if (chosen !== null) {
    if (gone && names.includes(chosen)) await choose(chosen, read(location.hash).place);
    return;
  }
  const wanted = read(location.hash);
  if (wanted.map !== null && names.includes(wanted.map)) return choose(wanted.map, wanted.place);
  if (wanted.map !== null) {
    // Who was given the address of a map should not take another one for it.
    select.selectedIndex = -1;
    empty(`There is no map '${wanted.map}' here. Choose one of those that there are.`);
    return;
  }
  // The newest in which there is something.
  const filled = maps.filter((map) => map.revision !== '0');
  const [newest] = (filled.length > 0 ? filled : maps).slice().sort((a, b) => b.created - a.created);
  if (newest !== undefined) await choose(newest.name, null);
}

// Panels

function useTool(tool: Tool): void {
  for (const button of document.querySelectorAll<HTMLElement>('button[data-tool]')) {
    button.setAttribute('aria-pressed', String(button.dataset.tool === tool));
  }
  get('map').classList.toggle('drawing', tool !== 'pan');
  session?.check.choose(tool);
  // On a narrow page the panels would cover what is drawn on.
  if (tool !== 'pan' && NARROW.matches) fold(true);
}

function showTolerance(): void {
  tell(get('tolerance-value'), tolerance.value);
  session?.check.again();
}

let rootSide = 0;

function showOutlines(side = rootSide): void {
  rootSide = side;
  tell(get('depth-value'), `${depth.value} · ${short(side / 2 ** depth.valueAsNumber)} m`);
  session?.outline(outlines.checked, depth.valueAsNumber);
}

function fold(folded: boolean): void {
  side.hidden = folded;
  document.body.classList.toggle('folded', folded);
  get('fold').setAttribute('aria-expanded', String(!folded));
  session?.resized();
}

function slide(slider: HTMLInputElement, by: number): void {
  slider.valueAsNumber += by;
  slider.dispatchEvent(new Event('input'));
}

select.addEventListener('change', () => void choose(select.value, null));
tolerance.addEventListener('input', showTolerance);
depth.addEventListener('input', () => showOutlines());
outlines.addEventListener('change', () => showOutlines());
get('tools').addEventListener('click', (event) => {
  const tool = (event.target as HTMLElement).closest<HTMLElement>('[data-tool]')?.dataset.tool;
  if (tool !== undefined) useTool(tool as Tool);
});
get('clear').addEventListener('click', () => session?.check.clear());
get('fold').addEventListener('click', () => fold(!side.hidden));
get('verdict').addEventListener('click', () => fold(false));
get('theme').addEventListener('click', () => themes.next());
get('help-open').addEventListener('click', () => help.showModal());

// Keys

const KEYS: Record<string, () => void> = {
  v: () => useTool('pan'),
  escape: () => useTool('pan'),
  h: () => session?.back(),
  d: () => useTool('disc'),
  b: () => useTool('box'),
  p: () => useTool('path'),
  c: () => session?.check.clear(),
  enter: () => session?.check.finish(),
  backspace: () => session?.check.back(),
  f: () => void session?.fit(),
  i: () => session?.speak(),
  o: () => outlines.click(),
  r: () => get<HTMLInputElement>('robots-shown').click(),
  n: () => session?.robots.next(),
  '[': () => slide(depth, -1),
  ']': () => slide(depth, 1),
  ',': () => slide(tolerance, -1),
  '.': () => slide(tolerance, 1),
  m: () => select.focus(),
  s: () => fold(!side.hidden),
  t: () => themes.next(),
  '?': () => help.showModal(),
};

document.addEventListener('keydown', (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || takesLetters(event.target)) return;
  const key = event.key.toLowerCase();
  // A button with the focus is pressed by Enter.
  if (key === 'enter' && event.target instanceof HTMLButtonElement) return;
  const act = KEYS[key];
  if (act === undefined) return;
  event.preventDefault();
  act();
});

window.addEventListener('hashchange', () => {
  const { map, place } = read(location.hash);
  if (map !== null) void choose(map, place);
});

fold(NARROW.matches);
setInterval(() => {
  if (!document.hidden) void refresh();
}, POLL);
void refresh();
