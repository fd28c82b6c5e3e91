// Snapshots through the page, on the server's own: taken, restored, deleted, looked at, and compared; what is drawn is held to what the
// server says of both times.

import assert from 'node:assert/strict';
import { mkdirSync } from 'node:fs';
import { fileURLToPath } from 'node:url';
import { after, before, test } from 'node:test';
import { CRATE, SENSOR, WALLS, drive, scan } from './room.mjs';
import { Server } from './server.mjs';
import { DESK, NIGHT, PHONE, Site, launch } from './site.mjs';

const ROOM = '#map=room&x=4&y=3&r=0.011';
const PICTURES = fileURLToPath(new URL('../../target/viewer/', import.meta.url));
const UNKNOWN = 5;

let browser;
let server;

/** The left half of the room, with or without a crate. */
const left = (walls, from) =>
  Array.from({ length: 12 }, (_, at) => ({ ...scan(1.2 + 0.1 * at, 1.5 + 0.1 * at, 0.3, walls), sequence: String(from + at) }));

before(async () => {
  mkdirSync(PICTURES, { recursive: true });
  server = await new Server().start();
  await server.create('room', { resolution: 0.05, depth: 12, min_obstacle_width: 0.05, sensors: { default: SENSOR } });
  await server.insert('room', left([...WALLS, ...CRATE], 1));
  await server.ask('POST', '/v1/maps/room/snapshots', { name: 'crate' });
  // The crate goes, another comes, and the other half is seen.
  const other = CRATE.map(([x1, y1, x2, y2]) => [x1 + 1.4, y1 - 3, x2 + 1.4, y2 - 3]);
  await server.insert('room', drive(6).map((one, at) => ({ ...one, sequence: String(100 + at) })));
  await server.insert('room', left([...WALLS, ...other], 1000));
  await server.insert('room', left([...WALLS, ...other], 2000));
  browser = await launch();
});

after(async () => {
  await browser?.close();
  await server?.stop();
  server?.remove();
});

const open = (options = DESK, more = {}) => Site.open(browser, server, options, { hash: ROOM, ...more });

/** Centres of leaves all over the room; at this scale a leaf is a drawn cell. */
function centres() {
  const points = [];
  for (let x = -0.225; x < 8.3; x += 0.15) for (let y = -0.225; y < 6.3; y += 0.15) points.push({ x, y });
  return points;
}

/** The kind of a change, by its two classes: as docs/viewer.md says it. */
function kind(from, to) {
  const word = (cls) => (cls < UNKNOWN ? 'free' : cls === UNKNOWN ? 'unknown' : 'occupied');
  if (word(from) === word(to)) return 'same';
  if (word(to) === 'unknown') return 'forgotten, now unknown';
  return `${word(to)}, was ${word(from)}`;
}

/** The colour of each kind by the legend. */
const legend = (site) =>
  site.page.evaluate(() =>
    Object.fromEntries(
      [...document.querySelectorAll('#difference [data-kind]')].map((row) => [
        row.textContent,
        getComputedStyle(row.querySelector('.swatch')).backgroundColor,
      ]),
    ),
  );

/** Depth of the cells that are drawn; the page is at one scale throughout. */
async function depth(site) {
  const { config } = await server.get('/v1/maps/room');
  const { r } = await site.place();
  const level = Math.floor(Math.log2((config.resolution * 2 ** config.depth) / 256 / r) + 1e-9);
  return Math.min(level, config.depth - 8) + 8;
}

async function holdDifference(site, from, to = '') {
  const [points, at] = [centres(), await depth(site)];
  const [before, after] = [await server.classes('room', points, at, from), await server.classes('room', points, at, to)];
  const [colours, drawn] = [await legend(site), await site.colours(points, 'difference-layer')];
  const kinds = points.map((_, i) => kind(before[i], after[i]));
  const wrong = points.map((point, i) => [point, kinds[i], drawn[i]]).filter(([, kind, is]) => is !== (colours[kind] ?? ''));
  assert.deepEqual(wrong.slice(0, 3), [], `${wrong.length} of ${points.length} points`);
  return new Set(kinds);
}

test('a snapshot is taken, restored and deleted, each asked for twice where it destroys', async () => {
  const site = await open();
  const { page } = site;
  const row = (name) => page.locator('#snapshot-list li', { hasText: name });
  const { revision } = await server.get('/v1/maps/room');
  await page.locator('#snapshot-name').fill('Before.works');
  await page.locator('#snapshot-name').press('Enter');
  await site.says('snapshot-note', `Before.works taken at revision ${revision}`);
  const kept = async () => (await server.get('/v1/maps/room/snapshots')).snapshots.map(({ name }) => name);
  assert.deepEqual(await kept(), ['Before.works', 'crate']);
  // A name that is taken is refused in the server's words.
  await page.locator('#snapshot-name').fill('crate');
  await page.locator('#snapshot-take button').click();
  await site.says('snapshot-note', 'map "room" has a snapshot "crate" already');

  // Restored, the map is as it was, under a new revision; pressed once it is not.
  const point = [{ x: 1.425, y: 4.025 }];
  const then = await server.classes('room', point, 12, 'crate');
  assert.notDeepEqual(await server.classes('room', point, 12), then);
  await row('crate').locator('button', { hasText: 'Restore' }).click();
  await site.says('snapshot-note', 'Restore: the map becomes crate. Press again to do it.');
  assert.equal((await server.get('/v1/maps/room')).revision, revision);
  await row('crate').locator('button', { hasText: 'Sure?' }).click();
  const restored = String(Number(revision) + 1);
  await site.says('snapshot-note', `crate restored as revision ${restored}`);
  assert.deepEqual(await server.classes('room', point, 12), then);
  await site.at(restored);
  await row('Before.works').locator('button', { hasText: 'Restore' }).click();
  await row('Before.works').locator('button', { hasText: 'Sure?' }).click();
  await site.at(Number(restored) + 1);

  // Asked once and left, it does nothing.
  await row('Before.works').locator('button', { hasText: 'Delete' }).click();
  await page.locator('#snapshot-name').focus();
  assert.equal(await page.locator('#snapshot-list button', { hasText: 'Sure?' }).count(), 0);
  await page.waitForTimeout(300);
  assert.deepEqual(await kept(), ['Before.works', 'crate']);
  await row('Before.works').locator('button', { hasText: 'Delete' }).click();
  await row('Before.works').locator('button', { hasText: 'Sure?' }).click();
  await site.says('snapshot-note', 'Before.works deleted');
  await site.says('snapshot-list', /^crate/);
  assert.deepEqual(await kept(), ['crate']);
  await site.close();
});

test('what changed since a snapshot is drawn as the server says it, over a map that is faint', async () => {
  const site = await open();
  assert.equal(await site.page.locator('#looking').isVisible(), false);
  await site.page.locator('#look-since').selectOption('crate');
  await site.says('looking-at', /^Changes from crate \(rev \d+\) to the map as it is now$/);
  await site.page.waitForTimeout(1200);
  const kinds = await holdDifference(site, 'crate');
  for (const one of ['same', 'occupied, was free', 'occupied, was unknown', 'free, was occupied', 'free, was unknown']) {
    assert.ok(kinds.has(one), `no cell is "${one}": ${[...kinds]}`);
  }
  await site.page.screenshot({ path: `${PICTURES}difference-light.png` });

  // It follows the map.
  await server.insert('room', left([...WALLS, ...CRATE], 3000));
  await server.insert('room', left([...WALLS, ...CRATE], 3100));
  await site.at((await server.get('/v1/maps/room')).revision);
  await site.page.waitForTimeout(1500);
  await holdDifference(site, 'crate');

  // And back: the map is as strong as before, and nothing lies over it.
  await site.page.locator('#look-back').click();
  assert.equal(await site.page.locator('#looking').isVisible(), false);
  await site.page.waitForTimeout(400);
  assert.equal(await site.page.locator('.difference-layer').count(), 0);
  assert.equal(await site.page.locator('#look-since').inputValue(), '');
  await site.close();
});

test('two snapshots are compared, also backwards, where what was known is forgotten', async () => {
  await server.ask('POST', '/v1/maps/room/snapshots', { name: 'later' });
  const site = await open(NIGHT);
  await site.page.locator('#look-at').selectOption('crate');
  await site.page.locator('#look-since').selectOption('later');
  await site.says('looking-at', /^Changes from later \(rev \d+\) to crate \(rev \d+\)$/);
  await site.page.waitForTimeout(1200);
  const kinds = await holdDifference(site, 'later', 'crate');
  assert.ok(kinds.has('forgotten, now unknown'), [...kinds]);
  await site.page.screenshot({ path: `${PICTURES}difference-dark.png` });
  await site.close();
});

test('a snapshot that is looked at answers for itself: classes, nodes and what was guaranteed free', async () => {
  const site = await open();
  const { page } = site;
  await page.locator('#look-at').selectOption('crate');
  await site.says('looking-at', /^Shown: crate \(rev (\d+)\)$/);
  const [, revision] = /rev (\d+)/.exec(await site.text('looking-at'));
  await page.waitForTimeout(1200);
  const [points, at, colours] = [centres(), await depth(site), await site.legend()];
  const classes = await server.classes('room', points, at, 'crate');
  const drawn = await site.colours(points);
  assert.deepEqual(points.filter((_, i) => drawn[i] !== colours[classes[i]]), []);
  // The right half was not seen then.
  const unseen = { x: 6.525, y: 4.525 };
  const [then] = await server.classes('room', [unseen], 12, 'crate');
  const [now] = await server.classes('room', [unseen], 12);
  assert.ok(then === UNKNOWN && now < UNKNOWN, `${then} ${now}`);
  await site.point(unseen.x, unseen.y);
  await site.says('class', `class ${then} unknown`);
  await page.keyboard.press('d');
  await site.click(6.5, 4.5);
  await site.click(6.7, 4.5);
  await site.says('answer', new RegExp(`^Not free.*unknown.*revision ${revision}$`));
  // As it is now, by the key.
  await page.locator('#map').focus();
  await page.keyboard.press('h');
  await site.says('answer', /^Guaranteed free/);
  assert.equal(await page.locator('#looking').isVisible(), false);
  await site.close();
});

test('a snapshot that another client deletes is looked at no more', async () => {
  const site = await open();
  await site.page.locator('#look-at').selectOption('later');
  await site.page.locator('#look-since').selectOption('crate');
  await site.says('looking-at', /^Changes from crate/);
  await server.ask('DELETE', '/v1/maps/room/snapshots/later');
  await site.says('looking-at', /to the map as it is now$/);
  assert.equal(await site.page.locator('#look-since').inputValue(), 'crate');
  await site.close();
});

test('on a phone the comparison says over the map what its colours mean', async () => {
  const site = await open(PHONE);
  const { page } = site;
  await page.locator('#fold').tap();
  await page.locator('#look-since').selectOption('crate');
  await page.locator('#fold').tap();
  assert.equal(await page.locator('#looking').isVisible(), true);
  assert.equal(await page.locator('#difference .class').count(), 5);
  assert.equal(await page.evaluate(() => document.documentElement.scrollWidth - window.innerWidth), 0);
  const small = await page.locator('#look-back').boundingBox();
  assert.ok(small.height >= 30, `${small.height}`);
  await page.waitForTimeout(1200);
  await page.screenshot({ path: `${PICTURES}difference-phone.png` });
  await site.close();
});

// Colour vision (Machado, Oliveira, Fernandes 2009, severity 1), on linear light.
const VISION = {
  full: [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
  protan: [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
  deutan: [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
  tritan: [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]],
};

/** Lightness and colour as far apart as they look (CIE L*a*b*, D65). */
function lab(colour, matrix) {
  const light = colour.match(/\d+/g).map(Number).map((part) => part / 255).map((part) => (part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4));
  const [r, g, b] = matrix.map((row) => Math.min(1, Math.max(0, row[0] * light[0] + row[1] * light[1] + row[2] * light[2])));
  const bend = (value) => (value > 0.008856 ? Math.cbrt(value) : 7.787 * value + 16 / 116);
  const x = bend((0.4124 * r + 0.3576 * g + 0.1805 * b) / 0.9505);
  const y = bend(0.2126 * r + 0.7152 * g + 0.0722 * b);
  const z = bend((0.0193 * r + 0.1192 * g + 0.9505 * b) / 1.089);
  return [116 * y - 16, 500 * (x - y), 200 * (y - z)];
}

test('kinds of change are told apart with every common kind of colour vision', async () => {
  for (const options of [DESK, NIGHT]) {
    const site = await open(options);
    await site.page.locator('#look-since').selectOption('crate');
    const colours = Object.entries(await legend(site));
    assert.equal(colours.length, 5);
    for (const [vision, matrix] of Object.entries(VISION)) {
      for (const [one, a] of colours) {
        for (const [other, b] of colours.filter(([name]) => name > one)) {
          const [p, q] = [lab(a, matrix), lab(b, matrix)];
          const apart = Math.hypot(p[0] - q[0], p[1] - q[1], p[2] - q[2]);
          assert.ok(apart > 20, `${one} and ${other} by ${vision} vision in the ${options.colorScheme}: ${apart.toFixed(1)}`);
        }
      }
    }
    await site.close();
  }
});
