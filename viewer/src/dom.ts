// The page's elements by id, and small ones made on the way.

export function get<T extends HTMLElement>(id: string): T {
  const element = document.getElementById(id);
  if (element === null) throw new Error(`the page has no #${id}`);
  return element as T;
}

type Child = Node | string;

export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  props: Partial<HTMLElementTagNameMap[K]> = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = Object.assign(document.createElement(tag), props);
  element.append(...children);
  return element;
}

/** Sets text only where it changed: a status is read aloud when it does. */
export function tell(element: HTMLElement, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

/** Calls at most so often; the last call is never lost. */
export function paced(milliseconds: number, work: () => void): () => void {
  let waiting = false;
  let asked = false;
  const run = () => {
    waiting = true;
    asked = false;
    work();
    setTimeout(() => {
      waiting = false;
      if (asked) run();
    }, milliseconds);
  };
  return () => {
    asked = true;
    if (!waiting) run();
  };
}
