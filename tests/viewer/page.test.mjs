// The page about the map: light and dark, keys and help, names for those who do not see it, a phone's width.

import assert from 'node:assert/strict';
import { mkdirSync } from 'node:fs';
import { fileURLToPath } from 'node:url';
import { after, before, test } from 'node:test';
import { SENSOR, drive } from './room.mjs';
import { Server } from './server.mjs';
import { DESK, NIGHT, PHONE, Site, launch } from './site.mjs';

const ROOM = '#map=room&x=4&y=3&r=0.011';
const PICTURES = fileURLToPath(new URL('../../target/viewer/', import.meta.url));

let browser;
let server;

before(async () => {
  mkdirSync(PICTURES, { recursive: true });
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

const open = (options = DESK, more = {}) => Site.open(browser, server, options, { hash: ROOM, ...more });

const picture = (site, name) => site.page.screenshot({ path: `${PICTURES}${name}.png` });

/** Relative luminance of a colour (WCAG 2). */
function luminance(colour) {
  const parts = colour.match(/[\d.]+/g).slice(0, 3).map((part) => Number(part) / 255);
  const [r, g, b] = parts.map((part) => (part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}

function contrast(a, b) {
  const [low, high] = [luminance(a), luminance(b)].sort((one, other) => one - other);
  return (high + 0.05) / (low + 0.05);
}

test('light and dark follow the system, or what was chosen, and the map goes with them', async () => {
  const site = await open();
  const is = (theme) => site.page.waitForFunction((theme) => document.documentElement.dataset.theme === theme, theme, { timeout: 5000 });
  await is('light');
  const light = await site.legend();
  const wall = [{ x: 8.025, y: 3.025 }];
  await site.page.waitForTimeout(500);
  const [drawn] = await site.colours(wall);
  await site.page.emulateMedia({ colorScheme: 'dark' });
  await is('dark');
  const dark = await site.legend();
  await site.page.waitForTimeout(300);
  const [redrawn] = await site.colours(wall);
  const cls = Object.keys(light).find((one) => light[one] === drawn);
  assert.ok(Number(cls) > 5);
  assert.equal(redrawn, dark[cls]);
  // The key goes round: as the system, light, dark.
  await site.page.keyboard.press('t');
  await is('light');
  await site.says('theme', 'light');
  await site.page.keyboard.press('t');
  await site.says('theme', 'dark');
  await site.page.emulateMedia({ colorScheme: 'light' });
  await site.page.waitForTimeout(300);
  await is('dark');
  await site.page.reload();
  await site.live();
  await is('dark');
  await site.close();
});

test('classes are in order by lightness alone, and text stands out from its ground', async () => {
  for (const [options, way] of [[DESK, -1], [NIGHT, 1]]) {
    const site = await open(options);
    const legend = await site.legend();
    const shades = Object.keys(legend).map(Number).sort((a, b) => a - b).map((cls) => luminance(legend[cls]));
    for (let at = 1; at < shades.length; at++) {
      assert.ok((shades[at] - shades[at - 1]) * way > 0, `class ${at + 1}: ${shades}`);
    }
    // Free, unknown and occupied are further apart than classes of one word.
    assert.ok(contrast(legend[4], legend[5]) > 1.35, `${contrast(legend[4], legend[5])}`);
    assert.ok(contrast(legend[5], legend[6]) > 1.2, `${contrast(legend[5], legend[6])}`);
    assert.ok(contrast(legend[1], legend[10]) > 7, `${contrast(legend[1], legend[10])}`);
    const faint = await site.page.evaluate(() =>
      [...document.querySelectorAll('h2, label, dt, dd, button, .hint, .class, output, .live')]
        .filter((element) => element.checkVisibility() && element.textContent.trim() !== '')
        .map((element) => {
          let ground = element;
          while (getComputedStyle(ground).backgroundColor === 'rgba(0, 0, 0, 0)' && ground.parentElement) ground = ground.parentElement;
          return [element.textContent.trim().slice(0, 20), getComputedStyle(element).color, getComputedStyle(ground).backgroundColor];
        }),
    );
    assert.ok(faint.length > 30);
    for (const [text, colour, ground] of faint) assert.ok(contrast(colour, ground) >= 4.5, `${text}: ${colour} on ${ground}`);
    await site.close();
  }
});

test('the help lists the keys, and every control has a name and can be reached by Tab', async () => {
  const site = await open();
  await site.page.keyboard.press('?');
  const help = site.page.locator('#help');
  assert.equal(await help.isVisible(), true);
  const keys = (await help.locator('dt kbd').allTextContents()).map((key) => key.toLowerCase());
  for (const key of ['d', 'b', 'p', 'o', 'f', 't', 's', 'm', 'i', '[', ']', ',', '.']) assert.ok(keys.includes(key), key);
  // While it is open keys are its own.
  await site.page.keyboard.press('o');
  assert.equal(await site.page.locator('#outlines').isChecked(), false);
  await site.page.keyboard.press('Escape');
  assert.equal(await help.isVisible(), false);

  const nameless = await site.page.evaluate(() =>
    [...document.querySelectorAll('button, select, input, [role]')]
      .filter((element) => element.checkVisibility())
      .filter((element) => {
        const label = element.labels?.[0]?.textContent ?? element.getAttribute('aria-label') ?? element.textContent;
        return !/status|toolbar/.test(element.getAttribute('role') ?? '') && label.trim() === '';
      })
      .map((element) => element.outerHTML),
  );
  assert.deepEqual(nameless, []);
  const reached = new Set();
  for (let press = 0; press < 24; press++) {
    await site.page.keyboard.press('Tab');
    const [id, ring] = await site.page.evaluate(() => {
      const element = document.activeElement;
      return [element.id || element.dataset.tool || element.className || element.tagName, getComputedStyle(element).outlineStyle];
    });
    reached.add(id);
    if (id !== 'BODY') assert.notEqual(ring, 'none', `no ring about ${id}`);
  }
  for (const id of ['fold', 'maps', 'theme', 'help-open', 'pan', 'disc', 'tolerance', 'outlines', 'depth', 'map']) {
    assert.ok(reached.has(id), `${id} is not reached: ${[...reached]}`);
  }
  // The panels fold away and the map takes their room.
  const before = (await site.place()).box.width;
  await site.page.locator('#map').focus();
  await site.page.keyboard.press('s');
  assert.equal(await site.page.locator('#side').isVisible(), false);
  assert.ok((await site.place()).box.width > before + 200);
  await site.close();
});

test('a map name is chosen by keys', async () => {
  const site = await open();
  await site.page.keyboard.press('m');
  assert.equal(await site.page.evaluate(() => document.activeElement.id), 'maps');
  await site.close();
});

test('on a phone the panels are folded, nothing is wider than the page, and a disc is drawn by touch', async () => {
  const site = await open(PHONE);
  const { page } = site;
  assert.equal(await page.locator('#side').isVisible(), false);
  await page.waitForTimeout(500);
  const wide = () => page.evaluate(() => document.documentElement.scrollWidth - window.innerWidth);
  assert.equal(await wide(), 0);
  await page.locator('#fold').tap();
  assert.equal(await page.locator('#side').isVisible(), true);
  assert.equal(await wide(), 0);
  const small = await page.evaluate(() =>
    [...document.querySelectorAll('button')]
      .filter((button) => button.checkVisibility())
      .map((button) => [button.textContent, button.getBoundingClientRect().height])
      .filter(([, height]) => height < 30),
  );
  assert.deepEqual(small, []);
  await page.locator('[data-tool=disc]').tap();
  assert.equal(await page.locator('#side').isVisible(), false);
  await page.touchscreen.tap(...(await site.pixel(2.6, 2.7)));
  await page.waitForTimeout(400);
  await page.touchscreen.tap(...(await site.pixel(2.9, 2.7)));
  // The answer stands over the map; a tap on it shows the rest.
  const verdict = page.locator('#verdict');
  await verdict.waitFor();
  await picture(site, 'phone-map');
  const line = await verdict.textContent();
  await verdict.tap();
  assert.equal(await verdict.isVisible(), false);
  assert.equal(await page.locator('#side').isVisible(), true);
  const disc = {
    center: { x: Number(await page.locator('#shape [name=x]').inputValue()), y: Number(await page.locator('#shape [name=y]').inputValue()) },
    radius: Number(await page.locator('#shape [name=radius]').inputValue()),
  };
  const { free } = await server.free('room', { disc });
  const word = free ? 'Guaranteed free' : 'Not free';
  await site.says('answer', new RegExp(`^${word}`));
  assert.ok(line.startsWith(`${word}: `), line);
  // Without a cursor a tap reads what is there.
  await page.locator('#fold').tap();
  const leaf = await server.leaf('room', 5.4, 2.7);
  await page.touchscreen.tap(...(await site.pixel(5.4, 2.7)));
  await site.says('node', new RegExp(`^node ${leaf.depth}/${leaf.x}/${leaf.y} `));
  await page.locator('#fold').tap();
  await picture(site, 'phone');
  await site.close();
});

test('pictures are taken for people to look at', async () => {
  for (const [options, name] of [[DESK, 'light'], [NIGHT, 'dark']]) {
    const site = await open(options);
    await site.page.keyboard.press('o');
    await site.page.keyboard.press(name === 'light' ? 'd' : 'p');
    if (name === 'light') {
      await site.click(2.0, 2.5);
      await site.click(2.5, 2.5);
    } else {
      for (const [x, y] of [[2.6, 2.7], [3, 4.5], [5.4, 4.5], [5.4, 4.5]]) {
        await site.click(x, y);
        await site.page.waitForTimeout(350);
      }
    }
    await site.says('answer', name === 'light' ? /^Guaranteed free/ : /^Not free/);
    await site.point(6.4, 3.3);
    await site.says('node', /^node/);
    await site.page.waitForTimeout(600);
    await picture(site, name);
    await site.close();
  }
});
