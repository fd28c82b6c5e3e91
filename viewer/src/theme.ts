// Light or dark: as the system says, or as was chosen here.

import { get, tell } from './dom';
import type { Theme } from './palette';

type Choice = 'auto' | Theme;

const CHOICES: Choice[] = ['auto', 'light', 'dark'];
const KEY = 'ubbmap-theme';

const system = window.matchMedia('(prefers-color-scheme: dark)');

export class Themes {
  private choice: Choice;

  constructor(private readonly onChange: (theme: Theme) => void) {
    const kept = stored();
    this.choice = CHOICES.find((choice) => choice === kept) ?? 'auto';
    system.addEventListener('change', () => this.apply());
    this.apply();
  }

  get theme(): Theme {
    if (this.choice !== 'auto') return this.choice;
    return system.matches ? 'dark' : 'light';
  }

  next(): void {
    this.choice = CHOICES[(CHOICES.indexOf(this.choice) + 1) % CHOICES.length] ?? 'auto';
    try {
      localStorage.setItem(KEY, this.choice);
    } catch {
      // A browser may keep nothing; the choice holds for this visit.
    }
    this.apply();
  }

  private apply(): void {
    document.documentElement.dataset.theme = this.theme;
    tell(get('theme'), this.choice);
    this.onChange(this.theme);
  }
}

function stored(): string | null {
  try {
    return localStorage.getItem(KEY);
  } catch {
    return null;
  }
}
