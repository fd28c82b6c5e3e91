// Snapshots: take, restore, delete. The panel shows itself only where the server has them.

import { deleteSnapshot, listSnapshots, restoreSnapshot, takeSnapshot, type Snapshot } from './api';
import { get, make, tell } from './dom';

export class Snapshots {
  private ended = false;

  constructor(private readonly map: string) {
    get('snapshots').hidden = true;
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
    void this.list();
  }

  dispose(): void {
    this.ended = true;
    get('snapshots').hidden = true;
  }

  private async list(): Promise<void> {
    let snapshots: Snapshot[];
    try {
      snapshots = await listSnapshots(this.map);
    } catch {
      return;
    }
    if (this.ended) return;
    get('snapshots').hidden = false;
    get('snapshot-list').replaceChildren(...snapshots.map((one) => this.row(one)));
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
        return;
      }
      button.disabled = true;
      void this.work(act);
    };
    button.onblur = () => {
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
    await this.list();
  }
}
