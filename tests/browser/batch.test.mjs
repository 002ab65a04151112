// The page of a batch: its table is sorted and filtered, its links lead to reports, and its names are text.

import assert from "node:assert/strict";
import {existsSync} from "node:fs";
import path from "node:path";
import {after, before, test} from "node:test";
import {BUILD, open, overflows, shot, start, stop, structure, weakTexts} from "./browser.mjs";

const PAGE = "batch/index.html";
const HOSTILE = "<img src=x onerror=alert(1)>";
before(start);
after(stop);

async function opened(options, work) {
  const {page, trouble, close} = await open(PAGE, options);
  try {
    await work(page);
    assert.deepEqual(trouble, []);
  } finally {
    await close();
  }
}

for (const dark of [false, true]) {
  for (const [width, height] of [[1200, 1600], [390, 844]]) {
    test(`it opens, texts stand out and nothing is wider than the page: ${width} px, ${dark ? "dark" : "light"}`, () =>
      opened({dark, width, height}, async page => {
        assert.deepEqual(await weakTexts(page), []);
        assert.deepEqual(await structure(page), []);
        assert.ok(await overflows(page) <= 0, "the page scrolls sideways");
        assert.ok(await page.locator(".scroll").first().evaluate(box => box.scrollWidth <= box.clientWidth), "pairs are cut off");
        await shot(page, `batch-${width}x${height}${dark ? "-dark" : ""}`, true);
      }));
  }
}

test("pairs are sorted by number and by name", () => opened({}, async page => {
  const scores = () => page.$$eval("#pairs tbody tr", rows => rows.map(row => parseFloat(row.cells[3].textContent)).filter(value => !isNaN(value)));
  await page.getByRole("button", {name: "Score"}).click();
  const up = await scores();
  assert.deepEqual(up, [...up].sort((a, b) => a - b));
  await page.getByRole("button", {name: "Score"}).click();
  assert.deepEqual(await scores(), [...up].sort((a, b) => b - a));
}));

test("pairs are filtered by words, status and rule, and the page says how many are left", () => opened({}, async page => {
  const rows = page.locator("#pairs tbody tr:visible"), all = await rows.count();
  await page.locator("#words").fill("0000");
  assert.ok(await rows.count() < all);
  assert.match(await page.locator("#shown").innerText(), new RegExp(`of ${all}`));
  await page.locator("#words").fill("");
  await page.locator("#status").selectOption("unreadable");
  assert.equal(await rows.count(), 1);
  await page.locator("#status").selectOption("");
  await page.locator("#rules button[data-rule]").last().click();
  const few = await rows.count();
  assert.ok(few > 0 && few < all);
}));

test("every report that is linked is there, and opens", () => opened({}, async page => {
  const links = await page.$$eval("#pairs a", found => found.map(link => link.getAttribute("href")));
  assert.ok(links.length >= 12);
  assert.deepEqual(links.filter(link => !existsSync(path.join(BUILD, "batch", decodeURIComponent(link)))), []);
  for (const link of [links[0], links[links.length - 1]]) {
    const {page: report, trouble, close} = await open(`batch/${decodeURIComponent(link)}`);
    assert.equal(await report.locator(".verdict p").count(), 3);
    assert.deepEqual(trouble, []);
    await close();
  }
}));

test("thumbnails are there", () => opened({}, async page => {
  await page.evaluate(() => document.querySelectorAll("img").forEach(image => { image.loading = "eager"; }));
  await page.waitForLoadState("networkidle");
  const broken = await page.$$eval("img", images => images.filter(image => !image.naturalWidth).map(image => image.src));
  assert.deepEqual(broken, []);
}));

test("a name that is markup appears as text", () => opened({}, async page => {
  assert.ok((await page.locator("#pairs").innerText()).includes(HOSTILE));
  assert.equal(await page.locator('img[src="x"]').count(), 0);
}));
