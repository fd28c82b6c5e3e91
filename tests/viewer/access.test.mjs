// The page on a server with tokens: it asks for one, uses it for everything, and says what the role may not do.

import assert from 'node:assert/strict';
import { after, before, test } from 'node:test';
import { SENSOR, drive } from './room.mjs';
import { Server } from './server.mjs';
import { DESK, Site, launch } from './site.mjs';

const ROOM = '#map=room&x=4&y=3&r=0.011';

let browser;
let server;
let admin;
let reader;

before(async () => {
  server = new Server();
  admin = server.token('boss', 'admin');
  reader = server.token('reader', 'read', '--maps', 'room');
  await server.start();
  server.shown = admin;
  for (const map of ['attic', 'room']) {
    await server.create(map, { resolution: 0.05, min_obstacle_width: 0.05, sensors: { default: SENSOR } });
  }
  await server.insert('room', drive(4));
  browser = await launch();
});

after(async () => {
  await browser?.close();
  await server?.stop();
  server?.remove();
});

const give = async (site, token) => {
  await site.page.locator('#token-value').fill(token);
  await site.page.locator('#token-form button').click();
};

const open = async (token) => {
  const site = await Site.open(browser, server, DESK, { hash: ROOM, live: false });
  await site.page.locator('#token[open]').waitFor();
  await give(site, token);
  await site.live();
  return site;
};

test('the page asks for a token, says why one is not taken, and goes on with one that is', async () => {
  const site = await Site.open(browser, server, DESK, { hash: ROOM, live: false });
  await site.says('token-why', 'This server asks for a token.');
  // There is nothing to see without one.
  await site.page.keyboard.press('Escape');
  assert.ok(await site.page.locator('#token[open]').isVisible());
  await give(site, 'ubbmap_of-another-server');
  await site.says('token-why', /^Not taken: .*not known/);
  await give(site, admin);
  await site.live();
  await site.says('token-role', 'admin');
  assert.equal(await site.page.locator('#token[open]').count(), 0);
  // Tiles and the stream of changes come by the token: no address shows it.
  await site.page.waitForFunction(() => document.querySelector('.ol-layer canvas') !== null);
  const revision = await server.insert('room', drive(5).slice(drive(4).length));
  await site.at(revision);
  assert.ok(site.tiles().length > 0);
  assert.ok(site.requests.every((url) => !url.includes(admin)));
  // It is kept over a reload of the tab, and for no other tab.
  await site.page.reload();
  await site.live();
  const other = await Site.open(browser, server, DESK, { hash: ROOM, live: false });
  await other.says('token-why', 'This server asks for a token.');
  await other.close();
  // Pressed, its mark forgets it.
  await site.page.locator('#token-role').click();
  await site.says('token-why', 'This server asks for a token.');
  await site.close();
});

test('what the role may not do is disabled, with the reason', async () => {
  await server.ask('POST', '/v1/maps/room/snapshots', { name: 'then' });
  const site = await open(reader);
  await site.says('token-role', 'read');
  await site.says('snapshot-role', /role admin here; yours is read/);
  await site.page.locator('#snapshot-list li').first().waitFor();
  for (const button of await site.page.locator('#snapshot-change button').all()) assert.ok(await button.isDisabled());
  // Only its maps are there.
  assert.deepEqual(await site.page.locator('#maps option').allTextContents(), ['room']);
  await site.close();

  const boss = await open(admin);
  assert.ok(await boss.page.locator('#snapshot-take button').isEnabled());
  assert.ok(await boss.page.locator('#snapshot-role').isHidden());
  await boss.close();
});

test('a token that is revoked is asked for again, and the page goes on where it was', async () => {
  const guest = server.token('guest', 'read');
  const site = await Site.open(browser, server, DESK, { hash: ROOM, live: false });
  await site.page.locator('#token[open]').waitFor();
  server.reload();
  const known = async () => (await fetch(`${server.url}/v1/maps`, { headers: { authorization: `Bearer ${guest}` } })).ok;
  while (!(await known())) await site.page.waitForTimeout(50);
  await give(site, guest);
  await site.live();
  server.revoke('guest');
  server.reload();
  await site.says('token-why', /^Not taken: /);
  await give(site, reader);
  await site.live();
  await site.says('token-role', 'read');
  await site.close();
});
