// The page of the interface's description in Chromium: whole, from the server alone, and its operations can be tried.

import assert from 'node:assert/strict';
import { mkdirSync } from 'node:fs';
import { fileURLToPath } from 'node:url';
import { after, before, test } from 'node:test';
import { Server } from './server.mjs';
import { DESK, NIGHT, launch } from './site.mjs';

const PICTURES = fileURLToPath(new URL('../../target/viewer/', import.meta.url));

let browser;
let server;

before(async () => {
  mkdirSync(PICTURES, { recursive: true });
  server = await new Server().start();
  await server.create('hall', {});
  browser = await launch();
});

after(async () => {
  await browser?.close();
  await server?.stop();
  server?.remove();
});

/** The page, with what it complained of and whom it asked. */
async function open(options = DESK) {
  const context = await browser.newContext(options);
  const page = await context.newPage();
  const faults = [];
  page.on('console', (message) => message.type() === 'error' && faults.push(message.text()));
  page.on('pageerror', (error) => faults.push(String(error)));
  page.on('request', (request) => {
    if (!request.url().startsWith(`${server.url}/`) && !request.url().startsWith('data:')) faults.push(`asked ${request.url()}`);
  });
  await page.goto(`${server.url}/docs`);
  await page.waitForSelector('.opblock', { timeout: 20000 });
  return { page, faults };
}

test('the description is shown whole, and nobody but the server is asked', async () => {
  const { page, faults } = await open();
  const described = (await server.ask('GET', '/openapi.json')).json;
  const operations = Object.values(described.paths).flatMap((methods) => Object.values(methods)).length;
  assert.equal(await page.locator('.opblock').count(), operations);
  assert.equal((await page.locator('h1.title, h2.title').first().innerText()).split(/\s/)[0], 'ubbmap');
  await page.screenshot({ path: `${PICTURES}docs.png` });
  assert.deepEqual(faults, []);
  await page.context().close();
});

test('an operation is tried on the server, and its answer shown', async () => {
  const { page, faults } = await open();
  const block = page.locator('#operations-maps-GetMap');
  await block.locator('.opblock-summary-control').click();
  await block.locator('input[placeholder="map"]').fill('hall');
  await block.locator('button.execute').click();
  const answer = block.locator('.live-responses-table .response-col_status');
  await answer.first().waitFor({ timeout: 10000 });
  await page.waitForFunction(() => /\b200\b/.test(document.querySelector('#operations-maps-GetMap .live-responses-table tbody .response-col_status')?.textContent ?? ''), null, { timeout: 10000 });
  const body = await block.locator('.live-responses-table .highlight-code, .live-responses-table pre').first().innerText();
  assert.match(body, /"name": "hall"/);
  await page.screenshot({ path: `${PICTURES}docs-tried.png` });
  // A body is the example that stands there first, one scan, and is taken as it is.
  const scans = page.locator('#operations-scans-InsertScans');
  await scans.locator('.opblock-summary-control').click();
  await scans.locator('input[placeholder="map"]').fill('hall');
  await scans.locator('button.execute').click();
  await page.waitForFunction(() => /\b200\b/.test(document.querySelector('#operations-scans-InsertScans .live-responses-table tbody .response-col_status')?.textContent ?? ''), null, { timeout: 10000 });
  const map = (await server.ask('GET', '/v1/maps/hall')).json;
  assert.equal(map.robots[0].applied, '1');
  assert.deepEqual(faults, []);
  await page.context().close();
});

test('it can be read at night', async () => {
  const { page, faults } = await open(NIGHT);
  const ground = await page.evaluate(() => getComputedStyle(document.documentElement).backgroundColor);
  assert.ok(ground.match(/\d+/g).slice(0, 3).every((part) => Number(part) < 80), ground);
  await page.screenshot({ path: `${PICTURES}docs-night.png` });
  assert.deepEqual(faults, []);
  await page.context().close();
});
