// The page in Chromium: where it looks, what is drawn at a point of the map, and that it behaves: nothing from elsewhere, no errors.

import assert from 'node:assert/strict';
import { readFileSync } from 'node:fs';
import path from 'node:path';
import { chromium } from 'playwright-core';

const EXECUTABLE = process.env.VIEWER_CHROMIUM ?? '/usr/bin/chromium';

export const DESK = { viewport: { width: 1280, height: 800 }, colorScheme: 'light' };
export const NIGHT = { ...DESK, colorScheme: 'dark' };
export const PHONE = { viewport: { width: 390, height: 780 }, colorScheme: 'light', hasTouch: true, isMobile: true, deviceScaleFactor: 2 };

export async function launch() {
  // As root there is no sandbox; a container's /dev/shm is small.
  return chromium.launch({ executablePath: EXECUTABLE, args: ['--no-sandbox', '--disable-dev-shm-usage', '--disable-gpu'] });
}

/** A folder whose files stand for those in the binary: to try a bundle without building the server. */
const BUNDLE = process.env.VIEWER_BUNDLE;

const TYPES = { '.html': 'text/html', '.js': 'text/javascript', '.css': 'text/css', '.svg': 'image/svg+xml' };

function fromBundle(route) {
  const name = new URL(route.request().url()).pathname.replace(/^\/viewer\//, '').replace(/^\/$/, 'index.html');
  return route.fulfill({ body: readFileSync(path.join(BUNDLE, name)), contentType: TYPES[path.extname(name)] });
}

export class Site {
  /** Opens the page and waits until the map is live. `expected`: console errors that are meant. */
  static async open(browser, server, options = DESK, { hash = '', live = true, prepare = null } = {}) {
    const context = await browser.newContext(options);
    const page = await context.newPage();
    const site = new Site(page, server);
    if (BUNDLE !== undefined) await page.route(/^[^?]*\/(viewer\/.*)?(#.*)?$/, (route) => fromBundle(route));
    if (prepare !== null) await prepare(page);
    await page.goto(`${server.url}/${hash}`);
    if (live) await site.live();
    return site;
  }

  constructor(page, server) {
    this.page = page;
    this.server = server;
    this.faults = [];
    this.requests = [];
    page.on('pageerror', (error) => this.faults.push(error.stack));
    page.on('console', (message) => {
      // The browser itself reports answers that are no success, as where the server has no snapshots or is away.
      if (message.type() === 'error' && !message.text().startsWith('Failed to load resource')) this.faults.push(message.text());
    });
    page.on('request', (request) => this.requests.push(request.url()));
  }

  async close() {
    await this.page.context().close();
    assert.deepEqual(this.faults, []);
    for (const url of this.requests) assert.ok(url.startsWith(`${this.server.url}/`), `the page asked for ${url}`);
  }

  live() {
    return this.page.waitForFunction(() => document.getElementById('live').textContent === 'live');
  }

  text(id) {
    return this.page.locator(`#${id}`).textContent();
  }

  /** Waits until the text of an element is as it should be. */
  async says(id, expected) {
    const pattern = expected instanceof RegExp ? expected : null;
    try {
      await this.page.waitForFunction(
        ([id, text, source]) => {
          const found = document.getElementById(id).textContent;
          return source === null ? found === text : new RegExp(source).test(found);
        },
        [id, pattern ? null : expected, pattern ? pattern.source : null],
        { timeout: 15000 },
      );
    } catch {
      assert.fail(`#${id} says "${await this.text(id)}", expected ${expected}`);
    }
  }

  /** The revision that the page is at. */
  at(revision) {
    return this.says('revision', String(revision));
  }

  /** Centre, metres a pixel, and the map's box on the page, when nothing moves any more. */
  async place() {
    let hash = '';
    for (;;) {
      await this.page.waitForTimeout(150);
      const now = new URL(this.page.url()).hash;
      if (now === hash && now.includes('r=')) break;
      hash = now;
    }
    const values = new URLSearchParams(hash.slice(1));
    const [x, y, r] = ['x', 'y', 'r'].map((name) => Number(values.get(name)));
    const box = await this.page.locator('#map').boundingBox();
    return { map: values.get('map'), x, y, r, box };
  }

  /** The box of the map that is in view. */
  async view() {
    const { x, y, r, box } = await this.place();
    const [w, h] = [(box.width * r) / 2, (box.height * r) / 2];
    return { min_x: x - w, min_y: y - h, max_x: x + w, max_y: y + h };
  }

  /** Where a point of the map is on the page. */
  async pixel(x, y) {
    const at = await this.place();
    return [at.box.x + at.box.width / 2 + (x - at.x) / at.r, at.box.y + at.box.height / 2 - (y - at.y) / at.r];
  }

  async point(x, y) {
    await this.page.mouse.move(...(await this.pixel(x, y)));
  }

  async click(x, y, options) {
    await this.page.mouse.click(...(await this.pixel(x, y)), options);
  }

  /** Colours that are drawn at points of the map, as the legend writes them; "" where nothing is drawn. */
  async colours(points, layer = 'ol-layer') {
    const { box } = await this.place();
    const pixels = [];
    for (const { x, y } of points) {
      const [left, top] = await this.pixelOf(x, y, box);
      pixels.push([left, top]);
    }
    return this.page.evaluate(([pixels, layer]) => {
      const canvas = document.querySelector(`.${layer} canvas`);
      const ratio = canvas.width / canvas.parentElement.clientWidth;
      const context = canvas.getContext('2d');
      return pixels.map(([x, y]) => {
        const [r, g, b, a] = context.getImageData(Math.floor(x * ratio), Math.floor(y * ratio), 1, 1).data;
        return a === 255 ? `rgb(${r}, ${g}, ${b})` : '';
      });
    }, [pixels, layer]);
  }

  /** How strongly a layer draws at pixels from a point of the map: 0 nothing, 255 all. */
  async strength(layer, x, y, offsets) {
    const { box } = await this.place();
    const [left, top] = await this.pixelOf(x, y, box);
    return this.page.evaluate(([layer, left, top, offsets]) => {
      const canvas = document.querySelector(`.${layer} canvas`);
      if (canvas === null) return offsets.map(() => 0);
      const ratio = canvas.width / canvas.parentElement.clientWidth;
      const context = canvas.getContext('2d');
      return offsets.map(([dx, dy]) => context.getImageData(Math.floor((left + dx) * ratio), Math.floor((top - dy) * ratio), 1, 1).data[3]);
    }, [layer, left, top, offsets]);
  }

  /** The same within the map's box. */
  async pixelOf(x, y, box) {
    const values = new URLSearchParams(new URL(this.page.url()).hash.slice(1));
    const [cx, cy, r] = ['x', 'y', 'r'].map((name) => Number(values.get(name)));
    return [box.width / 2 + (x - cx) / r, box.height / 2 - (y - cy) / r];
  }

  /** The colour of each class by the legend. */
  legend() {
    return this.page.evaluate(() =>
      Object.fromEntries(
        [...document.querySelectorAll('#legend [data-class]')].map((row) => [
          row.dataset.class,
          getComputedStyle(row.querySelector('.swatch')).backgroundColor,
        ]),
      ),
    );
  }

  /** Requests for tiles since a place in `requests`. */
  tiles(since = 0) {
    return this.requests.slice(since).filter((url) => url.includes('/tiles/')).map((url) => url.split('/tiles/')[1].replace('.npy', ''));
  }
}
