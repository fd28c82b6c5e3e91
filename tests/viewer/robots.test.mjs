// Robots stand where their last scans say, move as scans are applied without being asked for, and can be followed.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { SENSOR, drive, scan } from './room.mjs';
import { Server } from './server.mjs';
import { NIGHT, PHONE, Site, launch } from './site.mjs';

const ROOM = '#map=room&x=4&y=3&r=0.011';
const LAYER = 'robots-layer';

let browser;
let server;
let sequence = 1000;

before(async () => {
  server = await new Server().start();
  await server.create('room', { resolution: 0.05, min_obstacle_width: 0.05, sensors: { default: SENSOR } });
  await server.insert('room', drive(4).map((one) => ({ ...one, robot: 'first' })));
  browser = await launch();
});

after(async () => {
  await browser?.close();
  await server?.stop();
  server?.remove();
});

/** A scan of a robot whose pose is known to so much. */
function seen(robot, x, y, theta, error = 0.02, turn = 0.005) {
  const one = scan(x, y, theta);
  const about = (value, by) => ({ min: value - by, max: value + by });
  return { ...one, robot, sequence: String(++sequence), pose: { x: about(x, error), y: about(y, error), theta: about(theta, turn) } };
}

const open = (options, more = {}) => Site.open(browser, server, options, { hash: ROOM, ...more });

const button = (site, robot) => site.page.locator('#robot-list button', { hasText: robot });

test('a robot is drawn where its last scan was, with its box and the headings that it may have', async () => {
  await server.insert('room', [seen('wide', 2, 4, Math.PI / 2, 0.4, 0.5), seen('keen', 6, 1.5, 0)]);
  const site = await open();
  await site.says('robot-list', /first.*keen.*wide/);
  await site.page.waitForTimeout(600);
  // The box: its edge 0.4 m from the middle, nothing beyond; the wedge up, 0.5 to both sides, and not down.
  const r = 0.011;
  const edge = 0.4 / r;
  const [inside, right, beyond] = await site.strength(LAYER, 2, 4, [[edge / 2, -edge / 2], [edge, -edge / 2], [edge + 8, -edge / 2]]);
  assert.ok(inside > 20 && right > 200 && beyond === 0, `${inside} ${right} ${beyond}`);
  const at = (angle, far) => [far * Math.cos(angle), far * Math.sin(angle)];
  // A narrow wedge is a line along the heading.
  const [ahead, aside, behind] = await site.strength(LAYER, 6, 1.5, [at(0, 20), at(0.5, 20), at(Math.PI, 20)]);
  assert.ok(ahead > 200 && aside === 0 && behind === 0, `${ahead} ${aside} ${behind}`);
  const [dot] = await site.strength(LAYER, 6, 1.5, [[0, 0]]);
  assert.equal(dot, 255);
  assert.match(await site.text('robot-list'), /keennow · ±0\.02 m ±0\.3°.*widenow · ±0\.4 m ±28\.6°/);
  // Its numbers are those of the interface.
  const { robots } = await server.get('/v1/maps/room/robots');
  assert.deepEqual(robots.map(({ robot }) => robot), ['first', 'keen', 'wide']);
  await site.close();
});

test('robots move as their scans are applied, without being asked for', async () => {
  const site = await open();
  await server.insert('room', [seen('keen', 6, 4, 0)]);
  await site.page.waitForTimeout(600);
  assert.deepEqual(await site.strength(LAYER, 6, 1.5, [[0, 0]]), [0]);
  assert.deepEqual(await site.strength(LAYER, 6, 4, [[0, 0]]), [255]);
  // One that comes later is there with its first scan.
  await server.insert('room', [seen('new', 1, 1, 0)]);
  await site.says('robot-list', /new/);
  assert.deepEqual(await site.strength(LAYER, 1, 1, [[0, 0]]), [255]);
  assert.equal(site.requests.filter((url) => url.endsWith('/robots')).length, 0);
  // Not shown, they are not drawn; the key does it too.
  await site.page.locator('#robots-shown').uncheck();
  await site.page.waitForTimeout(400);
  assert.deepEqual(await site.strength(LAYER, 1, 1, [[0, 0]]), [0]);
  await site.page.locator('#map').focus();
  await site.page.keyboard.press('r');
  await site.page.waitForTimeout(400);
  assert.deepEqual(await site.strength(LAYER, 1, 1, [[0, 0]]), [255]);
  await site.close();
});

test('a robot is followed until the map is moved by hand', async () => {
  const site = await open();
  await server.insert('room', [seen('keen', 6, 2, 0)]);
  await button(site, 'keen').click();
  assert.equal(await button(site, 'keen').getAttribute('aria-pressed'), 'true');
  const centre = async () => {
    const { x, y } = await site.place();
    return [x, y].map((value) => Math.round(value * 100) / 100);
  };
  assert.deepEqual(await centre(), [6, 2]);
  await server.insert('room', [seen('keen', 6, 2.5, 0)]);
  await site.page.waitForTimeout(400);
  assert.deepEqual(await centre(), [6, 2.5]);
  const [x, y] = await site.pixel(6, 2.5);
  await site.page.mouse.move(x + 60, y + 60);
  await site.page.mouse.down();
  await site.page.mouse.move(x + 160, y + 60, { steps: 4 });
  await site.page.mouse.up();
  await site.page.waitForTimeout(600);
  const dragged = await centre();
  assert.notDeepEqual(dragged, [6, 2.5]);
  await server.insert('room', [seen('keen', 6, 3, 0)]);
  await site.page.waitForTimeout(700);
  assert.deepEqual(await centre(), dragged);
  assert.equal(await button(site, 'keen').getAttribute('aria-pressed'), 'false');
  // The key goes through all of them, then to nobody.
  await site.page.locator('#map').focus();
  const pressed = [];
  for (let press = 0; press < 5; press++) {
    await site.page.keyboard.press('n');
    pressed.push(await site.page.locator('#robot-list button[aria-pressed=true]').allTextContents());
  }
  assert.deepEqual(pressed, [['first'], ['keen'], ['new'], ['wide'], []]);
  await site.close();
});

test('a trail leads to where a robot came from', async () => {
  const site = await open(NIGHT);
  const way = [[5, 4.5], [5.5, 4.5], [6, 4.5], [6, 5]];
  for (const [x, y] of way) {
    await server.insert('room', [seen('trailer', x, y, 0)]);
    await site.page.waitForTimeout(150);
  }
  await site.says('robot-list', /trailer/);
  const between = () => site.strength(LAYER, 5.25, 4.5, [[0, 0]]);
  assert.deepEqual(await between(), [0]);
  await site.page.locator('#trails').check();
  await site.page.waitForTimeout(400);
  assert.ok((await between())[0] > 200);
  await site.close();
});

test('a robot that is silent is hollow, and the list says for how long', async () => {
  const site = await open();
  await server.insert('room', [seen('silent', 3, 5, 0)]);
  await site.says('robot-list', /silentnow/);
  const [full] = await site.colours([{ x: 3, y: 5 }], LAYER);
  await site.says('robot-list', /silent1[1-9] s ago/);
  await site.page.waitForTimeout(500);
  const [hollow] = await site.colours([{ x: 3, y: 5 }], LAYER);
  assert.notEqual(hollow, full);
  await site.close();
});

test('a map without robots says so, and on a phone robots are on the map too', async () => {
  await server.create('empty', { resolution: 0.1, depth: 8, sensors: { default: SENSOR } });
  const empty = await Site.open(browser, server, undefined, { hash: '#map=empty' });
  await empty.says('robots-note', 'No robot has sent a scan since the server started.');
  await empty.close();
  const site = await open(PHONE);
  await site.page.waitForTimeout(600);
  assert.deepEqual(await site.strength(LAYER, 6, 3, [[0, 0]]), [255]);
  await site.page.locator('#fold').tap();
  await button(site, 'keen').tap();
  assert.equal(await button(site, 'keen').getAttribute('aria-pressed'), 'true');
  await site.close();
});
