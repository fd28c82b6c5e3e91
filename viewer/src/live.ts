// The stream of changes. Where it ends it begins anew from the last revision seen.

import { type Change, eventsPath, getMap, ApiError } from './api';
import { Events } from './events';

export type LiveState = 'live' | 'reconnecting' | 'gone';

const RETRY = 2000;

export class Live {
  private events: Events | null = null;
  private timer = 0;
  private ended = false;

  constructor(
    private readonly map: string,
    private revision: string,
    private readonly onChange: (change: Change) => void,
    private readonly onState: (state: LiveState) => void,
  ) {
    document.addEventListener('visibilitychange', this.looked);
    this.looked();
  }

  close(): void {
    this.ended = true;
    document.removeEventListener('visibilitychange', this.looked);
    this.pause();
  }

  /** A page that nobody sees gives its connection back: browsers open six to a server, whatever the number of pages. */
  private readonly looked = () => {
    this.pause();
    if (!document.hidden) this.open();
  };

  private pause(): void {
    clearTimeout(this.timer);
    this.events?.close();
  }

  private open(): void {
    const changed = (change: Change) => {
      this.revision = change.revision;
      this.onState('live');
      this.onChange(change);
    };
    this.events = new Events(eventsPath(this.map, this.revision), changed, () => {
      this.onState('reconnecting');
      clearTimeout(this.timer);
      this.timer = window.setTimeout(() => void this.again(), RETRY);
    });
  }

  /** The stream has ended: is the map still there? */
  private async again(): Promise<void> {
    try {
      await getMap(this.map);
    } catch (error) {
      if (this.ended || document.hidden) return;
      if (error instanceof ApiError && error.status === 404) {
        this.onState('gone');
        return;
      }
      this.timer = window.setTimeout(() => void this.again(), RETRY);
      return;
    }
    if (!this.ended && !document.hidden) this.open();
  }
}
