// Regions drawn and typed, and the answers in words: each is held to the server's own.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { CRATE, SENSOR, WALLS, drive, scan } from './room.mjs';
import { Server } from './server.mjs';
import { Site, launch } from './site.mjs';

const ROOM = '#map=room&x=4&y=3&r=0.011';
const CONFIG = { resolution: 0.05, min_obstacle_width: 0.05, sensors: { default: SENSOR } };

let browser;
let server;

before(async () => {
  server = await new Server().start();
  for (const [map, evidence] of [['room', 'EVIDENCE_GUARANTEED'], ['outer', 'EVIDENCE_OUTER']]) {
    await server.create(map, { ...CONFIG, evidence });
    await server.insert(map, drive(4));
  }
  browser = await launch();
});

after(async () => {
  await browser?.close();
  await server?.stop();
  server?.remove();
});

const open = (hash = ROOM) => Site.open(browser, server, undefined, { hash });

const value = async (site, name) => Number(await site.page.locator(`#shape [name=${name}]`).inputValue());

/** What the fields say, as the server takes it. */
async function typed(site) {
  const form = site.page.locator('#shape');
  const kind = await form.getAttribute('data-kind');
  if (kind === 'disc') {
    return { disc: { center: { x: await value(site, 'x'), y: await value(site, 'y') }, radius: await value(site, 'radius') } };
  }
  if (kind === 'box') {
    const [min_x, min_y, max_x, max_y] = await Promise.all(['min_x', 'min_y', 'max_x', 'max_y'].map((name) => value(site, name)));
    return { box: { min_x, min_y, max_x, max_y } };
  }
  const points = (await form.locator('[name=points]').inputValue()).split(' ').map((pair) => pair.split(',').map(Number));
  return { path: { points: points.map(([x, y]) => ({ x, y })), radius: await value(site, 'radius') } };
}

/** Holds the page's answer to the server's, and gives the latter. */
async function holdAnswer(site, map = 'room', tolerance = 0) {
  const truth = await server.free(map, await typed(site), tolerance);
  const { witness } = truth;
  const head = truth.free ? (truth.sound ? 'Guaranteed free' : 'Free') : 'Not free';
  let body = `worst leaf class ${truth.max_class}, stands `;
  if (!truth.free) {
    const place = `leaf at ${witness.min_x.toFixed(3)}, ${witness.min_y.toFixed(3)} \\(${Number(witness.size.toPrecision(6))} m\\)`;
    const word = { REASON_OCCUPIED: 'occupied ', REASON_UNKNOWN: 'unknown ', REASON_TOLERANCE: '' }[truth.reason];
    body = `${word}${place}, class ${witness.class}`.replaceAll('-0.000', '-?0.000');
  }
  await site.says('answer', new RegExp(`^${head}${body}`));
  assert.equal(await site.page.locator('#answer').getAttribute('data-state'), truth.free ? 'free' : 'taken');
  return truth;
}

test('a disc is drawn, answered, moved by its fields, and cleared', async () => {
  const site = await open();
  await site.page.keyboard.press('d');
  await site.says('hint', /centre/);
  await site.click(2.0, 2.5);
  await site.point(2.4, 2.5);
  await site.click(2.4, 2.5);
  const disc = (await typed(site)).disc;
  assert.ok(Math.abs(disc.center.x - 2) < 0.02 && Math.abs(disc.radius - 0.4) < 0.03, JSON.stringify(disc));
  assert.equal((await holdAnswer(site)).free, true);
  assert.match(await site.text('answer'), /^Guaranteed free/);
  // The tool is put away when the disc is drawn.
  assert.equal(await site.page.locator('[data-tool=pan]').getAttribute('aria-pressed'), 'true');

  await site.page.locator('#shape [name=x]').fill('0.3');
  await site.page.locator('#shape [name=x]').press('Tab');
  const wall = await holdAnswer(site);
  assert.equal(wall.reason, 'REASON_OCCUPIED');
  await site.page.locator('#shape [name=radius]').fill('0.05');
  await site.page.locator('#shape [name=radius]').press('Tab');
  assert.equal((await holdAnswer(site)).free, true);
  await site.page.locator('#shape [name=radius]').fill('0.4');
  await site.page.locator('#shape [name=radius]').press('Tab');
  assert.equal((await holdAnswer(site)).free, false);
  await site.page.locator('#shape [name=x]').fill('-3');
  await site.page.locator('#shape [name=x]').press('Enter');
  assert.equal((await holdAnswer(site)).reason, 'REASON_UNKNOWN');
  await site.page.locator('#shape [name=x]').fill('99999');
  await site.page.locator('#shape [name=x]').press('Tab');
  await site.says('answer', /outside the map/);

  await site.page.locator('#clear').click();
  assert.equal(await site.page.locator('#answer').isVisible(), false);
  assert.equal(await site.page.locator('#shape').isVisible(), false);
  await site.close();
});

test('a box and a path are drawn and answered', async () => {
  const site = await open();
  await site.page.locator('[data-tool=box]').click();
  await site.click(1.5, 2.0);
  await site.point(2.5, 3.0);
  await site.click(2.5, 3.0);
  const { box } = await typed(site);
  assert.ok(Math.abs(box.min_x - 1.5) < 0.02 && Math.abs(box.max_y - 3) < 0.02, JSON.stringify(box));
  assert.equal((await holdAnswer(site)).free, true);

  // Through the door it is free; the third corner leads into the wall.
  await site.page.keyboard.press('p');
  for (const [x, y] of [[2.6, 2.7], [5.4, 2.7]]) {
    await site.point(x, y);
    await site.click(x, y);
    await site.page.waitForTimeout(350);
  }
  await site.page.keyboard.press('Enter');
  const through = await holdAnswer(site);
  assert.equal((await typed(site)).path.points.length, 2);
  assert.equal(through.free, true);
  await site.page.keyboard.press('p');
  for (const [x, y] of [[2.6, 2.7], [3, 4.5], [5.4, 4.5]]) {
    await site.point(x, y);
    await site.click(x, y);
    await site.page.waitForTimeout(350);
  }
  await site.click(5.4, 4.5);
  const blocked = await holdAnswer(site);
  assert.equal(blocked.free, false);
  await site.says('answer', new RegExp(`${blocked.witness.distance.toFixed(3)} m along the path`));
  // Radius and points may be typed.
  await site.page.locator('#shape [name=points]').fill('2.6,2.7 5.4,2.7');
  await site.page.locator('#shape [name=points]').press('Enter');
  await holdAnswer(site);
  // From outside through a wall: the witness is where it begins, not the worst leaf.
  await site.page.locator('#shape [name=points]').fill('-1,3 2,3');
  await site.page.locator('#shape [name=points]').press('Enter');
  const outside = await holdAnswer(site);
  assert.deepEqual([outside.reason, outside.witness.class, outside.max_class], ['REASON_UNKNOWN', 5, 10]);
  await site.page.locator('#shape [name=points]').fill('2.6,2.7 5.4,2.7');
  await site.page.locator('#shape [name=points]').press('Enter');
  await site.page.locator('#shape [name=radius]').fill('0.9');
  await site.page.locator('#shape [name=radius]').press('Enter');
  assert.equal((await holdAnswer(site)).free, false);
  await site.close();
});

test('a path that is drawn loses its last point by Backspace, and all of it by Escape', async () => {
  const site = await open();
  await site.page.keyboard.press('p');
  for (const [x, y] of [[2, 2], [3, 2], [3, 3]]) {
    await site.point(x, y);
    await site.click(x, y);
    await site.page.waitForTimeout(350);
  }
  await site.page.keyboard.press('Backspace');
  await site.page.keyboard.press('Enter');
  assert.equal((await typed(site)).path.points.length, 2);
  await site.page.keyboard.press('c');
  await site.page.keyboard.press('p');
  await site.point(2, 2);
  await site.click(2, 2);
  await site.page.keyboard.press('Escape');
  await site.page.keyboard.press('Enter');
  assert.equal(await site.page.locator('#shape').isVisible(), false);
  await site.close();
});

test('the tolerance is a slider that goes as far as the map can answer', async () => {
  // Seen free twice, it stands one broken scan.
  await server.create('twice', CONFIG);
  await server.insert('twice', [scan(2.6, 2.7, 0), scan(2.6, 2.7, 0.1)]);
  const site = await open('#map=twice&x=4&y=3&r=0.011');
  const slider = site.page.locator('#tolerance');
  assert.deepEqual([await slider.getAttribute('min'), await slider.getAttribute('max')], ['0', '3']);
  await site.page.keyboard.press('b');
  await site.click(2.0, 2.0);
  await site.point(3.0, 3.0);
  await site.click(3.0, 3.0);
  const free = [];
  for (const tolerance of [0, 1, 2, 3]) {
    await slider.fill(String(tolerance));
    await site.says('tolerance-value', String(tolerance));
    free.push((await holdAnswer(site, 'twice', tolerance)).free);
  }
  assert.deepEqual(free, [true, true, false, false]);
  await site.says('answer', /is not free enough to stand 3 broken scans/);
  await site.page.locator('#map').focus();
  await site.page.keyboard.press(',');
  await site.says('tolerance-value', '2');
  await site.page.keyboard.press('.');
  await site.page.keyboard.press('.');
  await site.says('tolerance-value', '3');
  await site.close();
});

test('the answer and its witness follow the map', async () => {
  await server.create('moving', CONFIG);
  await server.insert('moving', drive(4));
  const site = await open('#map=moving&x=4&y=3&r=0.011');
  await site.page.keyboard.press('d');
  await site.click(1.4, 4.0);
  await site.point(1.7, 4.0);
  await site.click(1.7, 4.0);
  assert.equal((await holdAnswer(site, 'moving')).free, true);
  for (let round = 0; round < 5; round++) await server.insert('moving', [scan(2.6, 2.7, 0.3 * round, [...WALLS, ...CRATE])]);
  const taken = await holdAnswer(site, 'moving');
  assert.equal(taken.reason, 'REASON_OCCUPIED');
  const { revision } = await server.get('/v1/maps/moving');
  await site.says('answer', new RegExp(`revision ${revision}$`));
  await site.close();
});

test('in a map whose rule gives no guarantee the answer does not claim one', async () => {
  const site = await open('#map=outer&x=4&y=3&r=0.011');
  await site.page.keyboard.press('d');
  await site.click(2.0, 2.5);
  await site.point(2.4, 2.5);
  await site.click(2.4, 2.5);
  assert.equal((await holdAnswer(site, 'outer')).free, true);
  const text = await site.text('answer');
  assert.ok(text.startsWith('Free') && text.includes('no guarantee'), text);
  await site.close();
});

test('what the server refuses is said in its words', async () => {
  const site = await open();
  await site.page.keyboard.press('d');
  await site.click(2.0, 2.5);
  await site.click(2.4, 2.5);
  await site.page.locator('#shape [name=radius]').fill('1e300');
  await site.page.locator('#shape [name=radius]').press('Enter');
  const { status, json } = await server.ask('POST', '/v1/maps/room/guaranteed-free', { regions: [await typed(site)], tolerance: 0 });
  if (status === 200) await holdAnswer(site);
  else await site.says('answer', `No answer${json.detail}`);
  await site.close();
});
