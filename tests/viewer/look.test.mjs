// Moving, zooming, reading nodes and drawing their outlines, by mouse and by keys.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { SENSOR, drive } from './room.mjs';
import { Server } from './server.mjs';
import { Site, launch } from './site.mjs';

const ROOM = '#map=room&x=4&y=3&r=0.011';

let browser;
let server;

before(async () => {
  server = await new Server().start();
  await server.create('room', { resolution: 0.05, min_obstacle_width: 0.05, sensors: { default: SENSOR } });
  await server.insert('room', drive(4));
  browser = await launch();
});

after(async () => {
  await browser?.close();
  await server?.stop();
  server?.remove();
});

const open = (options = {}) => Site.open(browser, server, undefined, { hash: ROOM, ...options });

const close = (a, b, by) => assert.ok(Math.abs(a - b) <= by, `${a} is not ${b} to ${by}`);

test('the map is pulled, turned closer by the wheel, and keeps its place in the address', async () => {
  const site = await open();
  const before = await site.place();
  const [x, y] = [before.box.x + 400, before.box.y + 300];
  await site.page.mouse.move(x, y);
  await site.page.mouse.down();
  await site.page.mouse.move(x + 100, y + 50, { steps: 50 });
  await site.page.waitForTimeout(300);
  await site.page.mouse.up();
  const pulled = await site.place();
  close(pulled.x, before.x - 100 * before.r, 0.03);
  close(pulled.y, before.y + 50 * before.r, 0.03);
  await site.page.mouse.wheel(0, -400);
  await site.page.waitForTimeout(700);
  const closer = await site.place();
  assert.ok(closer.r < pulled.r * 0.9, `${closer.r} after ${pulled.r}`);
  // The address is enough to see the same again.
  const url = site.page.url();
  await site.close();
  const other = await Site.open(browser, server, undefined, { hash: new URL(url).hash });
  const again = await other.place();
  close(again.x, closer.x, closer.r);
  close(again.r, closer.r, closer.r * 1e-4);
  await other.close();
});

test('keys move and zoom, from the whole building to one leaf', async () => {
  const site = await open();
  let { x, y, r } = await site.place();
  await site.page.keyboard.press('ArrowRight');
  const right = await site.place();
  assert.ok(right.x > x && right.y === y, JSON.stringify(right));
  await site.page.keyboard.press('ArrowUp');
  assert.ok((await site.place()).y > y);
  for (let press = 0; press < 14; press++) {
    await site.page.keyboard.press('+');
    await site.page.waitForTimeout(120);
  }
  // A leaf of 5 cm is then as wide as a thumb.
  const nearest = await site.place();
  close(0.05 / nearest.r, 64, 0.01);
  for (let press = 0; press < 24; press++) {
    await site.page.keyboard.press('-');
    await site.page.waitForTimeout(120);
  }
  const farthest = await site.place();
  close(farthest.r, (0.05 * 65536) / 256, 0.2);
  await site.page.keyboard.press('f');
  await site.page.waitForTimeout(600);
  const view = await site.view();
  assert.ok(view.min_x < 0 && view.max_x > 8 && view.min_y < 0 && view.max_y > 6, JSON.stringify(view));
  assert.ok(view.max_y - view.min_y < 12, JSON.stringify(view));
  ({ r } = await site.place());
  // Keys that a field takes are the field's own.
  await site.page.locator('#depth').focus();
  const still = await site.place();
  await site.page.keyboard.press('ArrowRight');
  assert.deepEqual({ ...(await site.place()), box: 0 }, { ...still, box: 0 });
  await site.close();
});

test('the scale bar is as long as it says, in metres at every scale', async () => {
  for (const [r, metres] of [[0.011, 1], [0.001, 0.1], [0.9, 100]]) {
    const site = await open({ hash: `#map=room&x=4&y=3&r=${r}` });
    const bar = site.page.locator('.scale-bar');
    assert.equal(await bar.textContent(), `${metres} m`);
    close((await bar.boundingBox()).width, metres / r, 1.5);
    await site.close();
  }
});

test('hovering reads place, class and node as the server gives them', async () => {
  const site = await open();
  const words = new Set();
  for (const [x, y] of [[2.01, 2.51], [0.01, 3.01], [6.4, 3.3], [3.99, 1.11], [-1, -0.5], [7.97, 4.4], [2.2, 5.88]]) {
    const at = await site.pixel(x, y);
    await site.page.mouse.move(Math.round(at[0]), Math.round(at[1]));
    await site.says('at', /^x/);
    await site.says('class', /^class/);
    const said = /^x (-?[\d.]+) {2}y (-?[\d.]+) m$/.exec(await site.text('at'));
    const [px, py] = [Number(said[1]), Number(said[2])];
    close(px, x, 0.02);
    close(py, y, 0.02);
    const leaf = await server.leaf('room', px, py);
    const size = (0.05 * 2 ** 16) / 2 ** leaf.depth;
    await site.says('node', `node ${leaf.depth}/${leaf.x}/${leaf.y} · ${Number(size.toPrecision(6))} m`);
    const word = leaf.class < 5 ? 'free' : leaf.class === 5 ? 'unknown' : 'occupied';
    assert.match(await site.text('class'), new RegExp(`^class ${leaf.class} ${word}`));
    if (leaf.class < 4) assert.match(await site.text('class'), new RegExp(`stands ${4 - leaf.class} broken scans?$`));
    assert.equal(await site.page.locator('#legend .here').getAttribute('data-class'), String(leaf.class));
    words.add(word);
  }
  assert.deepEqual([...words].sort(), ['free', 'occupied', 'unknown']);
  await site.page.mouse.move(100, 300);
  await site.says('at', '–');
  // Without a mouse the centre is read, and said aloud.
  const { x, y } = await site.place();
  const leaf = await server.leaf('room', x, y);
  await site.page.keyboard.press('i');
  await site.says('spoken', new RegExp(`class ${leaf.class} .*node ${leaf.depth}/${leaf.x}/${leaf.y}`));
  await site.close();
});

test('what is hovered over follows the map', async () => {
  await server.create('fresh', { resolution: 0.05, min_obstacle_width: 0.05, sensors: { default: SENSOR } });
  const site = await open({ hash: '#map=fresh&x=4&y=3&r=0.011' });
  await site.point(2.01, 2.51);
  await site.says('class', 'class 5 unknown');
  await server.insert('fresh', drive(3));
  const { class: cls } = await server.leaf('fresh', 2.01, 2.51);
  assert.ok(cls < 5);
  await site.says('class', new RegExp(`^class ${cls} free`));
  await site.close();
});

test('outlines are the nodes that the server gives, down to the depth chosen', async () => {
  const site = await open();
  const view = await site.view();
  const query = `min_x=${view.min_x}&min_y=${view.min_y}&max_x=${view.max_x}&max_y=${view.max_y}`;
  const count = async (depth) => (await server.get(`/v1/maps/room/region?${query}&depth=${depth}`)).leaves.length;
  await site.page.keyboard.press('o');
  assert.equal(await site.page.locator('#outlines').isChecked(), true);
  await site.says('outlines-note', `${(await count(16)).toLocaleString('en')} nodes in view`);
  for (const depth of [15, 14, 13]) {
    await site.page.keyboard.press('[');
    const nodes = await count(depth);
    await site.says('outlines-note', `${nodes.toLocaleString('en')} nodes in view`);
    await site.says('depth-value', `${depth} · ${Number(((0.05 * 65536) / 2 ** depth).toPrecision(6))} m`);
  }
  // A line stands at the edge of a node, none in the middle of it.
  const { leaves } = await server.get(`/v1/maps/room/region?${query}&depth=13`);
  const side = 0.05 * 65536;
  const { box } = await site.place();
  const inked = async (x, y) => {
    const [left, top] = await site.pixelOf(x, y, box);
    return site.page.evaluate(([left, top]) => {
      const data = document.querySelector('.outlines canvas').getContext('2d').getImageData(Math.round(left) - 1, Math.round(top) - 1, 3, 3).data;
      return data.some((value, at) => at % 4 === 3 && value > 0);
    }, [left, top]);
  };
  const inner = leaves.filter((leaf) => {
    const size = side / 2 ** leaf.depth;
    const [x, y] = [-side / 2 + leaf.x * size, -side / 2 + leaf.y * size];
    return x > view.min_x && x + size < view.max_x && y > view.min_y && y + size < view.max_y;
  });
  assert.ok(inner.length > 50);
  for (const leaf of inner.slice(0, 40)) {
    const size = side / 2 ** leaf.depth;
    const [x, y] = [-side / 2 + leaf.x * size, -side / 2 + leaf.y * size];
    assert.equal(await inked(x, y + size / 2), true, JSON.stringify(leaf));
    assert.equal(await inked(x + size / 2, y + size / 2), false, JSON.stringify(leaf));
  }
  // From afar leaves are too small to draw; the page says what it draws instead.
  await site.page.locator('#depth').fill('16');
  for (let press = 0; press < 3; press++) {
    await site.page.locator('#map').press('-');
    await site.page.waitForTimeout(300);
  }
  await site.says('outlines-note', /drawn to depth \d+ \([\d.]+ m\): zoom in/);
  await site.page.keyboard.press('o');
  await site.says('outlines-note', '');
  // Drawn with the next frame.
  await site.page.waitForFunction(() => {
    const canvas = document.querySelector('.outlines canvas');
    return !canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.some((value) => value > 0);
  });
  await site.close();
});
