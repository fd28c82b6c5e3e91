// What is drawn is what the server answers, and it follows the map: in place, without a blank in between, over a restart.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { CRATE, SENSOR, WALLS, drive, scan } from './room.mjs';
import { Server } from './server.mjs';
import { NIGHT, Site, launch } from './site.mjs';

const CONFIG = { resolution: 0.05, depth: 12, min_obstacle_width: 0.05, sensors: { default: SENSOR } };
const ROOM = '#map=room&x=4&y=3&r=0.011';

let browser;
let server;

before(async () => {
  server = await new Server().start();
  await server.create('room', CONFIG);
  await server.insert('room', drive(4));
  await server.create('hall', { resolution: 0.1, depth: 6, evidence: 'EVIDENCE_OUTER', classes: 6, sensors: { default: SENSOR } });
  await server.insert('hall', [scan(0, 0, 0, [[-2, -2, 2, -2], [2, -2, 2, 2], [2, 2, -2, 2], [-2, 2, -2, -2]])]);
  browser = await launch();
});

after(async () => {
  await browser?.close();
  await server?.stop();
  server?.remove();
});

/** Depth of the cells that are drawn at a resolution: the coarser of two levels, for its cells are maxima. */
function drawnDepth({ config }, resolution) {
  const root = config.resolution * 2 ** config.depth;
  const level = Math.floor(Math.log2(root / 256 / resolution) + 1e-9);
  return Math.max(0, Math.min(level, Math.max(0, config.depth - 8))) + 8;
}

/** Where the maps of these tests have contents. */
const AREA = { min_x: -2.5, min_y: -2.5, max_x: 8.5, max_y: 6.5 };

/** Centres of drawn cells, spread over what is in view of the area. */
async function centres(site, map, count) {
  const details = await server.get(`/v1/maps/${map}`);
  const { r } = await site.place();
  const depth = Math.min(details.config.depth, drawnDepth(details, r));
  const cell = (details.config.resolution * 2 ** details.config.depth) / 2 ** depth;
  const shown = await site.view();
  const view = {
    min_x: Math.max(shown.min_x, AREA.min_x),
    min_y: Math.max(shown.min_y, AREA.min_y),
    max_x: Math.min(shown.max_x, AREA.max_x),
    max_y: Math.min(shown.max_y, AREA.max_y),
  };
  const points = [];
  for (let i = 0; i < count; i++) {
    for (let j = 0; j < count; j++) {
      const snap = (value, origin) => origin + (Math.floor((value - origin) / cell) + 0.5) * cell;
      const x = snap(view.min_x + ((i + 0.5) / count) * (view.max_x - view.min_x), details.bounds.min_x);
      const y = snap(view.min_y + ((j + 0.5) / count) * (view.max_y - view.min_y), details.bounds.min_y);
      const { min_x, min_y, max_x, max_y } = details.bounds;
      if (x > min_x && x < max_x && y > min_y && y < max_y) points.push({ x, y });
    }
  }
  return { points, depth };
}

async function holdDrawing(site, map, count = 40) {
  const { points, depth } = await centres(site, map, count);
  const [legend, classes] = [await site.legend(), await server.classes(map, points, depth)];
  const drawn = await site.colours(points);
  const wrong = points.map((point, at) => [point, classes[at], drawn[at], legend[classes[at]]]).filter(([, , is, should]) => is !== should);
  assert.deepEqual(wrong.slice(0, 3), [], `${wrong.length} of ${points.length} points`);
  return new Set(classes);
}

test('the page names every map and shows the newest, all that is mapped of it', async () => {
  const site = await Site.open(browser, server);
  const options = await site.page.locator('#maps option').allTextContents();
  const { maps } = await server.get('/v1/maps');
  assert.deepEqual(options, maps.map((map) => map.name));
  const { map, ...place } = await site.place();
  assert.equal(map, 'hall');
  await site.at(maps.find(({ name }) => name === 'hall').revision);
  // Its walls are 4 m apart: they fill the view.
  const view = await site.view();
  assert.ok(view.min_x < -2 && view.max_x > 2 && view.min_y < -2 && view.max_y > 2, JSON.stringify(view));
  assert.ok(view.max_y - view.min_y < 9, JSON.stringify(place));
  await site.close();
});

test('every colour drawn is that of the class that the server gives', async () => {
  const site = await Site.open(browser, server, undefined, { hash: ROOM });
  const seen = await holdDrawing(site, 'room');
  assert.ok(seen.has(1) && seen.has(5) && [...seen].some((cls) => cls > 5), [...seen]);
  // Cells of nearly two pixels, the widest before a finer level takes over: their centres are clear of rounding.
  for (const r of ['0.0263', '0.0527', '0.2106', '0.002']) {
    await site.page.evaluate((r) => (location.hash = `#map=room&x=4&y=3&r=${r}`), r);
    await site.live();
    await site.page.waitForTimeout(600);
    await holdDrawing(site, 'room');
  }
  await site.close();
});

test('colours are right in the dark, and in a map less deep than a tile', async () => {
  const site = await Site.open(browser, server, NIGHT, { hash: '#map=hall&x=0&y=0&r=0.01' });
  await site.page.waitForTimeout(400);
  assert.ok((await holdDrawing(site, 'hall')).size >= 3);
  await site.close();
});

test('another map is chosen from the list', async () => {
  const site = await Site.open(browser, server, undefined, { hash: ROOM });
  await site.page.locator('#maps').selectOption('hall');
  await site.page.waitForFunction(() => location.hash.startsWith('#map=hall'));
  await site.page.waitForTimeout(600);
  await holdDrawing(site, 'hall');
  const facts = await site.text('facts');
  assert.ok(facts.includes('0.1 m at depth 6') && facts.includes('outer: no guarantee'), facts);
  assert.equal(await site.page.locator('#legend .class').count(), 6);
  await site.close();
});

test('a change appears without a blank, and only tiles that it meets are asked for', async () => {
  await server.create('live', CONFIG);
  await server.insert('live', drive(3));
  // At this scale the view has tiles that the scan's blocks do not meet.
  const site = await Site.open(browser, server, undefined, { hash: '#map=live&x=4&y=3&r=0.05' });
  await site.page.waitForTimeout(800);
  await holdDrawing(site, 'live');
  const wall = { x: 8.025, y: 3.025 };
  const [steady] = await site.colours([wall]);
  assert.ok(steady !== '');
  // Every frame from now on: is anything at the wall other than the wall?
  const [left, top] = await site.pixelOf(wall.x, wall.y, (await site.place()).box);
  await site.page.evaluate(([left, top]) => {
    window.frames_ = [];
    const look = () => {
      const canvas = document.querySelector('.ol-layer canvas');
      const data = canvas.getContext('2d').getImageData(Math.floor(left), Math.floor(top), 1, 1).data;
      window.frames_.push(data[3] === 255 ? `rgb(${data[0]}, ${data[1]}, ${data[2]})` : 'blank');
      window.looking_ = requestAnimationFrame(look);
    };
    look();
  }, [left, top]);
  const since = site.requests.length;
  let revision;
  for (let round = 0; round < 6; round++) {
    revision = await server.insert('live', [scan(2.6, 2.7, 0.1 * round, [...WALLS, ...CRATE])]);
    await site.page.waitForTimeout(150);
  }
  await site.at(revision);
  await site.page.waitForTimeout(1200);
  const frames = await site.page.evaluate(() => (cancelAnimationFrame(window.looking_), window.frames_));
  const legend = Object.values(await site.legend());
  assert.ok(frames.length > 20, `${frames.length} frames`);
  // The wall is seen again and again, so its class only goes up: no frame is blank, or back at unknown.
  const occupied = legend.slice(5);
  const strange = frames.filter((colour) => !occupied.includes(colour));
  assert.deepEqual(strange, [], `${strange.length} of ${frames.length} frames`);
  await holdDrawing(site, 'live');
  const [crate] = await server.classes('live', [{ x: 1.775, y: 4.025 }]);
  assert.ok(crate > 5, `the crate is of class ${crate}`);

  const { blocks } = await server.get(`/v1/maps/live/changes?since=1`);
  const asked = new Set(site.tiles(since));
  const meets = (tile) => {
    const [z, x, y] = tile.split('/').map(Number);
    return blocks.some((block) => block.x >> (block.depth - z) === x && block.y >> (block.depth - z) === y);
  };
  assert.ok(asked.size > 0);
  assert.deepEqual([...asked].filter((tile) => !meets(tile)), []);
  const before = new Set(site.tiles(0));
  assert.ok([...before].some((tile) => !meets(tile)), 'every tile in view changed: the test shows nothing');
  await site.close();
});

test('over a restart of the server the page says so, and then has what it missed', async () => {
  await server.create('again', CONFIG);
  await server.insert('again', drive(2));
  const site = await Site.open(browser, server, undefined, { hash: '#map=again&x=4&y=3&r=0.011' });
  await site.page.waitForTimeout(500);
  await server.stop();
  await site.says('live', 'reconnecting');
  // What changed is remembered over restarts, two of them here.
  await site.page.route('**/events**', (route) => route.abort());
  await server.start();
  const revision = await server.insert('again', [scan(2.6, 2.7, 0, [...WALLS, ...CRATE]), scan(2.6, 2.7, 0.2, [...WALLS, ...CRATE])]);
  await server.stop();
  await server.start();
  const changes = await server.get('/v1/maps/again/changes?since=1');
  assert.ok(!changes.everything && changes.blocks.length > 0, JSON.stringify(changes));
  await site.page.unroute('**/events**');
  await site.says('live', 'live');
  await site.at(revision);
  await site.page.waitForTimeout(1000);
  await holdDrawing(site, 'again');
  await site.close();
});

test('a page that nobody sees lets go of the stream, and catches up when it is seen', async () => {
  await server.create('seen', CONFIG);
  await server.insert('seen', drive(2));
  const site = await Site.open(browser, server, undefined, { hash: '#map=seen&x=4&y=3&r=0.011' });
  const look = (hidden) =>
    site.page.evaluate((hidden) => {
      Object.defineProperty(document, 'hidden', { value: hidden, configurable: true });
      document.dispatchEvent(new Event('visibilitychange'));
    }, hidden);
  await site.page.waitForTimeout(500);
  const before = await site.text('revision');
  await look(true);
  const revision = await server.insert('seen', [scan(2.6, 2.7, 0, [...WALLS, ...CRATE]), scan(2.6, 2.7, 0.2, [...WALLS, ...CRATE])]);
  await site.page.waitForTimeout(700);
  assert.equal(await site.text('revision'), before);
  await look(false);
  await site.at(revision);
  await site.page.waitForTimeout(1000);
  await holdDrawing(site, 'seen');
  await site.close();
});

test('a map made anew while the server was away is shown as it is', async () => {
  await server.create('other', CONFIG);
  await server.insert('other', drive(1));
  const site = await Site.open(browser, server, undefined, { hash: '#map=other&x=4&y=3&r=0.011' });
  await site.page.route('**/events**', (route) => route.abort());
  await server.stop();
  await site.says('live', 'reconnecting');
  await server.start();
  await server.ask('DELETE', '/v1/maps/other');
  await server.create('other', { ...CONFIG, resolution: 0.1, classes: 6 });
  await site.page.unroute('**/events**');
  await site.says('live', 'live');
  await site.says('facts', /0\.1 m at depth 12/);
  assert.equal(await site.page.locator('#legend .class').count(), 6);
  await site.close();
});

test('a map that is deleted is said to be gone, and found again when it is made anew', async () => {
  await server.create('brief', CONFIG);
  await server.insert('brief', drive(1));
  const site = await Site.open(browser, server, undefined, { hash: '#map=brief&x=4&y=3&r=0.011' });
  await server.ask('DELETE', '/v1/maps/brief');
  await site.says('live', 'map is gone');
  await server.create('brief', { ...CONFIG, resolution: 0.1 });
  await site.says('live', 'live');
  await site.says('facts', /0\.1 m at depth 12/);
  await site.close();
  await server.ask('DELETE', '/v1/maps/brief');
});

test('until it is touched the page shows all that is mapped, as that grows', async () => {
  await server.create('grows', CONFIG);
  const room = (x) => scan(x, 0, 0, [[x - 2, -2, x + 2, -2], [x + 2, -2, x + 2, 2], [x + 2, 2, x - 2, 2], [x - 2, 2, x - 2, -2]]);
  await server.insert('grows', [room(0)]);
  const site = await Site.open(browser, server);
  const sees = async (x) => {
    const { min_x, max_x } = await site.view();
    return min_x < x && max_x > x;
  };
  assert.ok(!(await sees(20)));
  await server.insert('grows', [room(20)]);
  for (let look = 0; look < 30 && !(await sees(22)); look++) await site.page.waitForTimeout(300);
  assert.ok((await sees(-2)) && (await sees(22)));
  // From then on it stays where it was put.
  await site.point(10, 0);
  await site.page.mouse.wheel(0, -300);
  await site.page.waitForTimeout(600);
  const put = await site.place();
  await server.insert('grows', [room(-20)]);
  await site.at(3);
  await site.page.waitForTimeout(3000);
  const { x, y, r } = await site.place();
  assert.deepEqual([x, y, r], [put.x, put.y, put.r]);
  await site.close();
  await server.ask('DELETE', '/v1/maps/grows');
});

test('a server without a map says so, and shows the first that comes', async () => {
  const bare = await new Server().start();
  const site = await Site.open(browser, bare, undefined, { live: false });
  await site.says('empty', /no map yet/);
  await bare.create('first', CONFIG);
  await bare.insert('first', drive(1));
  await site.says('live', 'live');
  assert.equal(await site.page.locator('#empty').isVisible(), false);
  await site.close();
  await bare.stop();
  bare.remove();
});

test('an address of a map that is not there showed another one', async () => {
  const site = await Site.open(browser, server, undefined, { hash: '#map=nix', live: false });
  await site.says('empty', /no map 'nix' here/);
  assert.equal(new URL(site.page.url()).hash, '#map=nix');
  assert.equal(await site.page.locator('#maps').inputValue(), '');
  await site.page.locator('#maps').selectOption('hall');
  await site.says('live', 'live');
  assert.equal((await site.place()).map, 'hall');
  await site.close();
});

test('an empty map that was made last hid those with something in them', async () => {
  const fresh = await new Server().start();
  await fresh.create('filled', CONFIG);
  await fresh.insert('filled', drive(1));
  await fresh.create('later', CONFIG);
  const site = await Site.open(browser, fresh);
  assert.equal((await site.place()).map, 'filled');
  await site.close();
  await fresh.stop();
  fresh.remove();
});
