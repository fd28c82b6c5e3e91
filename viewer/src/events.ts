// Server-sent events by `fetch`, which sends the token's header. The browser's own EventSource cannot.

import { request } from './access';
import type { Change } from './api';

export class Events {
  private readonly ending = new AbortController();

  /** `onEnd` is called once, unless the stream was closed from here. */
  constructor(
    path: string,
    private readonly onChange: (change: Change) => void,
    private readonly onEnd: () => void,
  ) {
    void this.run(path);
  }

  close(): void {
    this.ending.abort();
  }

  private async run(path: string): Promise<void> {
    const { signal } = this.ending;
    try {
      const response = await request(path, { headers: { accept: 'text/event-stream' }, cache: 'no-store', signal });
      if (response.ok && response.body !== null) await this.read(response.body);
    } catch {
      // A connection that broke ends like any other.
    }
    if (!signal.aborted) this.onEnd();
  }

  private async read(body: ReadableStream<Uint8Array>): Promise<void> {
    const decoder = new TextDecoder();
    const reader = body.getReader();
    let rest = '';
    let event = '';
    let data = '';
    for (;;) {
      const { done, value } = await reader.read();
      if (done) return;
      const lines = (rest + decoder.decode(value, { stream: true })).split('\n');
      rest = lines.pop() ?? '';
      for (const line of lines) {
        if (line.startsWith('event:')) event = line.slice(6).trim();
        else if (line.startsWith('data:')) data += line.slice(5).trim();
        else if (line === '') {
          if (event === 'changes' && !this.ending.signal.aborted) this.onChange(JSON.parse(data) as Change);
          event = data = '';
        }
      }
    }
  }
}
