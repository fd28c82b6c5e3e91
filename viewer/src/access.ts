// Who the page asks as: the token, where the server wants one, and what its role may do. Every request goes through here. The token is
// kept for this tab alone, and sent in a header: an address would show it to every log on the way.

import { get, tell } from './dom';

const KEY = 'ubbmap-token';

/** What a token may do, as the server tells it with its answers. */
type Role = 'read' | 'write' | 'admin';

let token: string | null = kept();
let asking: Promise<void> | null = null;

function kept(): string | null {
  try {
    return sessionStorage.getItem(KEY);
  } catch {
    // A browser that keeps nothing for pages: the token lasts as long as the page.
    return null;
  }
}

function keep(value: string | null): void {
  token = value;
  try {
    if (value === null) sessionStorage.removeItem(KEY);
    else sessionStorage.setItem(KEY, value);
  } catch {
    // As above.
  }
}

/** `fetch` with the token. Where the server does not take it, the page asks for another and the request is sent again. */
export async function request(path: string, init: RequestInit = {}): Promise<Response> {
  for (;;) {
    const shown = token;
    const headers = new Headers(init.headers);
    if (shown !== null) headers.set('authorization', `Bearer ${shown}`);
    const response = await fetch(path, { ...init, headers });
    if (response.status !== 401) {
      show(response.headers.get('ubbmap-role') as Role | null);
      return response;
    }
    // Another request may have got a new one meanwhile.
    if (shown === token) await ask(await reason(response));
  }
}

async function reason(response: Response): Promise<string> {
  try {
    const { detail } = (await response.json()) as { detail?: string };
    return token === null ? 'This server asks for a token.' : `Not taken: ${detail ?? response.statusText}`;
  } catch {
    return `The server answered ${response.status} ${response.statusText}`;
  }
}

/** Asks for a token, once for all requests that wait for it. */
function ask(why: string): Promise<void> {
  asking ??= new Promise((done) => {
    const dialog = get<HTMLDialogElement>('token');
    const input = get<HTMLInputElement>('token-value');
    tell(get('token-why'), why);
    input.value = '';
    // Without one there is nothing to see, so it does not close without one.
    dialog.oncancel = (event) => event.preventDefault();
    get<HTMLFormElement>('token-form').onsubmit = (event) => {
      event.preventDefault();
      keep(input.value.trim());
      input.value = '';
      asking = null;
      dialog.close();
      done();
    };
    if (!dialog.open) dialog.showModal();
  });
  return asking;
}

/** Says what the role may not do where that is on the page. */
function show(role: Role | null): void {
  if (role === null) return;
  const mark = get<HTMLButtonElement>('token-role');
  mark.hidden = token === null;
  tell(mark, role);
  mark.onclick = () => {
    keep(null);
    location.reload();
  };
  const missing = role !== 'admin';
  get<HTMLFieldSetElement>('snapshot-change').disabled = missing;
  const note = get('snapshot-role');
  note.hidden = !missing;
  tell(note, missing ? `Taking, restoring and deleting takes the role admin here; yours is ${role}.` : '');
}
