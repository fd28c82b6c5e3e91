// Snapshots: take, restore, delete; look at one, or at what changed from one to another.

import { deleteSnapshot, listSnapshots, restoreSnapshot, takeSnapshot, type Snapshot } from './api';
import { KINDS } from './difference';
import { get, make, tell } from './dom';
import type { Theme } from './palette';

/** What is looked at: a snapshot or the map as it is now (null), and from which snapshot on its changes are shown, if from any. */
export interface Look {
  at: string | null;
  since: string | null;
}

export const NOW: Look = { at: null, since: null };

/** Others take and delete snapshots too: how often the list is asked for, milliseconds. */
const POLL = 5000;

/** Values of the two choices that are no names of snapshots. */
const [NEWEST, NOTHING] = ['', ''];

export class Snapshots {
  private ended = false;
  private known: Snapshot[] = [];
  private readonly timer: number;
  private readonly at = get<HTMLSelectElement>('look-at');
  private readonly since = get<HTMLSelectElement>('look-since');

  constructor(
    private readonly map: string,
    private theme: Theme,
    private readonly onLook: (look: Look) => void,
  ) {
    tell(get('snapshot-note'), '');
    get<HTMLFormElement>('snapshot-take').onsubmit = (event) => {
      event.preventDefault();
      const input = get<HTMLInputElement>('snapshot-name');
      void this.work(async () => {
        const made = await takeSnapshot(map, input.value);
        input.value = '';
        return `${made.name} taken at revision ${made.revision}`;
      });
    };
    this.at.onchange = this.since.onchange = () => this.look();
    get('look-back').onclick = () => this.back();
    this.choices();
    get('snapshot-list').replaceChildren();
    void this.list();
    this.timer = window.setInterval(() => {
      if (!document.hidden) void this.list();
    }, POLL);
  }

  dispose(): void {
    this.ended = true;
    clearInterval(this.timer);
    get('looking').hidden = true;
    get('snapshot-list').replaceChildren();
  }

  recolour(theme: Theme): void {
    this.theme = theme;
    this.legend();
  }

  /** The map as it is now. */
  back(): void {
    this.at.value = NEWEST;
    this.since.value = NOTHING;
    this.look();
  }

  private look(): void {
    const look = { at: this.at.value || null, since: this.since.value || null };
    this.onLook(look);
    const box = get('looking');
    box.hidden = look.at === null && look.since === null;
    const shown = look.at === null ? 'the map as it is now' : this.words(look.at);
    const words = look.since === null ? `Shown: ${shown}` : `Changes from ${this.words(look.since)} to ${shown}`;
    tell(get('looking-at'), words);
    this.legend();
  }

  private words(name: string): string {
    const known = this.known.find((one) => one.name === name);
    return known === undefined ? name : `${name} (rev ${known.revision})`;
  }

  private legend(): void {
    const rows = KINDS.map(({ code, words, colours }) => {
      const swatch = make('span', { className: 'swatch' });
      swatch.style.background = `rgb(${colours[this.theme].join(' ')})`;
      const row = make('div', { className: 'class' }, swatch, words);
      row.dataset.kind = String(code);
      return row;
    });
    get('difference').replaceChildren(...rows);
    get('difference').hidden = this.since.value === NOTHING;
  }

  /** `again`: the rows are made anew, also where nothing differs. */
  private async list(again = false): Promise<void> {
    let listed: Snapshot[];
    try {
      listed = await listSnapshots(this.map);
    } catch {
      // Asked again in a moment; that the server is away is told by the mark of the stream.
      return;
    }
    const same = JSON.stringify(listed) === JSON.stringify(this.known);
    if (this.ended || (same && !again)) return;
    this.known = listed;
    get('snapshot-list').replaceChildren(...this.known.map((one) => this.row(one)));
    this.choices();
  }

  /** The choices of what is looked at; one that was deleted is looked at no more. */
  private choices(): void {
    const before = [this.at.value, this.since.value];
    const options = () => this.known.map(({ name, revision }) => make('option', { value: name }, `${name} (rev ${revision})`));
    this.at.replaceChildren(make('option', { value: NEWEST }, 'now'), ...options());
    this.since.replaceChildren(make('option', { value: NOTHING }, 'nothing'), ...options());
    const there = (value: string) => (this.known.some((one) => one.name === value) ? value : '');
    this.at.value = there(before[0]!);
    this.since.value = there(before[1]!);
    if (this.at.value !== before[0] || this.since.value !== before[1]) this.look();
    get('look').hidden = this.known.length === 0;
  }

  private row({ name, revision, created }: Snapshot): HTMLLIElement {
    const when = new Date(created * 1000);
    const text = make('span', { className: 'grow', title: when.toISOString() }, make('b', {}, name), ` rev ${revision}, ${when.toLocaleString()}`);
    const restore = this.sure('Restore', `the map becomes ${name}`, async () => {
      const { revision: now } = await restoreSnapshot(this.map, name);
      return `${name} restored as revision ${now}`;
    });
    const remove = this.sure('Delete', `${name} is deleted`, async () => {
      await deleteSnapshot(this.map, name);
      return `${name} deleted`;
    });
    return make('li', {}, text, restore, remove);
  }

  /** A button that acts when it is pressed twice. */
  private sure(word: string, what: string, act: () => Promise<string>): HTMLButtonElement {
    const button = make('button', { type: 'button', title: what }, word);
    button.onclick = () => {
      if (button.dataset.sure === undefined) {
        button.dataset.sure = '';
        button.textContent = 'Sure?';
        tell(get('snapshot-note'), `${word}: ${what}. Press again to do it.`);
        return;
      }
      button.disabled = true;
      void this.work(act);
    };
    button.onblur = () => {
      if (button.dataset.sure !== undefined && !button.disabled) tell(get('snapshot-note'), '');
      delete button.dataset.sure;
      button.textContent = word;
    };
    return button;
  }

  private async work(act: () => Promise<string>): Promise<void> {
    let note: string;
    try {
      note = await act();
    } catch (error) {
      note = error instanceof Error ? error.message : String(error);
    }
    if (this.ended) return;
    tell(get('snapshot-note'), note);
    await this.list(true);
  }
}
