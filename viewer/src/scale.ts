// The scale bar, in metres at every scale; OpenLayers' own goes over to millimetres below one.

import Control from 'ol/control/Control';
import type MapEvent from 'ol/MapEvent';
import { make } from './dom';
import { short } from './grid';

/** Shortest bar, pixels. */
const SHORTEST = 80;

export class Scale extends Control {
  private readonly bar = make('div', { className: 'scale-bar' });
  private shown = 0;

  constructor() {
    const element = make('div', { className: 'scale ol-unselectable' });
    super({ element });
    element.append(this.bar);
  }

  override render(event: MapEvent): void {
    const resolution = event.frameState?.viewState.resolution;
    if (resolution === undefined || resolution === this.shown) return;
    this.shown = resolution;
    const least = SHORTEST * resolution;
    const ten = 10 ** Math.floor(Math.log10(least));
    const metres = ten * ([1, 2, 5].find((step) => step * ten >= least) ?? 10);
    this.bar.style.width = `${metres / resolution}px`;
    this.bar.textContent = `${short(metres)} m`;
  }
}
