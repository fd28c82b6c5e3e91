// A stranger's first minute: the demo is started, its address opened, and there are robots that move and a map that grows.

import assert from 'node:assert/strict';
import { spawn } from 'node:child_process';
import { mkdirSync } from 'node:fs';
import { fileURLToPath } from 'node:url';
import { after, before, test } from 'node:test';
import { BINARY } from './server.mjs';
import { DESK, Site, launch } from './site.mjs';

const PICTURES = fileURLToPath(new URL('../../target/viewer/', import.meta.url));

let browser;
let demo;

before(async () => {
  mkdirSync(PICTURES, { recursive: true });
  browser = await launch();
  demo = spawn(BINARY, ['demo', '--listen', '127.0.0.1:0']);
  demo.code = new Promise((done) => demo.on('exit', (code) => done(code)));
  demo.line = await new Promise((done) => demo.stdout.once('data', (bytes) => done(String(bytes))));
});

after(async () => {
  await browser?.close();
  demo?.kill('SIGKILL');
});

test('the address that the demo says shows robots that move, and all that they have mapped', async () => {
  const url = /http:\/\/[0-9.:]+/.exec(demo.line)[0];
  const site = await Site.open(browser, { url }, DESK);
  await site.says('robot-list', /^robot-0.*robot-1.*robot-2.*robot-3.*robot-4/);
  const where = async () => {
    const { robots } = await (await fetch(`${url}/v1/maps/demo-1/robots`)).json();
    return robots.map(({ pose }) => [pose.x.min, pose.y.min]);
  };
  const first = await where();
  const area = async () => {
    const { leaves } = await (await fetch(`${url}/v1/maps/demo-1/region?depth=12`)).json();
    return leaves.filter((leaf) => leaf.class < 5).reduce((sum, leaf) => sum + 4 ** (16 - leaf.depth), 0);
  };
  const before = await area();
  const revision = Number(await site.text('revision'));
  // Nobody touches the page: it keeps all that is mapped in view, as that grows.
  await site.page.waitForFunction((than) => Number(document.getElementById('revision').textContent) > than, revision + 300, { timeout: 60_000 });
  assert.ok((await area()) > before);
  const moved = (await where()).filter(([x, y], at) => Math.hypot(x - first[at][0], y - first[at][1]) > 0.05);
  assert.ok(moved.length >= 3, `${moved.length} robots moved`);
  // The building is 25 m by 15 m from the origin on.
  const whole = async () => {
    const { min_x, min_y, max_x, max_y } = await site.view();
    return min_x < 0 && min_y < 0 && max_x > 25 && max_y > 15;
  };
  for (let look = 0; look < 40 && !(await whole()); look++) await site.page.waitForTimeout(1000);
  assert.ok(await whole(), JSON.stringify(await site.view()));
  await site.page.screenshot({ path: `${PICTURES}demo.png` });
  await site.close();
});

test('the demo ends in peace when it is interrupted', async () => {
  demo.kill('SIGINT');
  assert.equal(await demo.code, 0);
});
