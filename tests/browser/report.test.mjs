// The report of one pair, used as its readers use it: with mouse, keys, a phone, in the dark, on paper.

import assert from "node:assert/strict";
import {statSync} from "node:fs";
import path from "node:path";
import {after, before, test} from "node:test";
import {BUILD, EVIL, open, overflows, shot, start, stop, structure, weakTexts} from "./browser.mjs";

const REPORT = "run/report.html";
before(start);
after(stop);

async function opened(options, work) {
  const {page, trouble, close} = await open(options.file || REPORT, options);
  try {
    await work(page);
    assert.deepEqual(trouble, []);
  } finally {
    await close();
  }
}

test("it opens with three sentences, all pictures, and no error or request", () => opened({}, async page => {
  assert.equal(await page.locator(".verdict p").count(), 3);
  assert.match(await page.locator(".verdict").innerText(), /^Wrong with the pair: .*\n\nThe pair was reconstructed to terrain/);
  const broken = await page.$$eval("img", images => images.filter(image => !image.complete || !image.naturalWidth).map(image => image.alt));
  assert.deepEqual(broken, []);
  assert.equal(await page.locator(".map").count(), 6);
  await shot(page, "report-1200x1600");
  await shot(page, "report-whole", true);
}));

for (const dark of [false, true]) {
  for (const [width, height] of [[1200, 1600], [390, 844]]) {
    test(`texts stand out, headings descend and nothing is wider than the page: ${width} px, ${dark ? "dark" : "light"}`, () =>
      opened({dark, width, height}, async page => {
        await page.$$eval("details", all => all.forEach(one => { one.open = true; }));
        await page.locator(".node.choice").first().click();
        assert.deepEqual(await weakTexts(page), []);
        assert.deepEqual(await structure(page), []);
        assert.ok(await overflows(page) <= 0, "the page scrolls sideways");
        assert.ok(await page.locator("#measured .scroll").evaluate(box => box.scrollWidth <= box.clientWidth), "facts are cut off");
        await page.keyboard.press("Escape");
        await page.$$eval("details", all => all.forEach(one => { one.open = false; }));
        await page.evaluate(() => scrollTo(0, 0));
        await shot(page, `report-${width}x${height}${dark ? "-dark" : ""}`, width < 500);
      }));
  }
}

test("the slider wipes between before and after, with mouse and keys, and blinks", () => opened({}, async page => {
  const wipe = page.locator(".wipe").first(), slider = wipe.locator("input[type=range]"), stack = wipe.locator(".stack");
  const at = () => stack.evaluate(element => element.style.getPropertyValue("--at"));
  await slider.fill("20");
  assert.equal(await at(), "20%");
  await slider.press("ArrowRight");
  assert.equal(await at(), "21%");
  await slider.click({position: {x: 3, y: 10}});
  assert.ok(parseFloat(await at()) < 5);
  await wipe.getByRole("button", {name: "Blink"}).click();
  assert.equal(await at(), "100%");
  await wipe.getByRole("button", {name: "Blink"}).click();
  assert.equal(await at(), "0%");
  assert.match(await slider.getAttribute("aria-valuetext"), /^0 percent/);
}));

test("a click on a choice leaves what led to it, tells about it, and Escape brings all back", () => opened({}, async page => {
  const visible = () => page.$$eval(".node", nodes => nodes.filter(node => getComputedStyle(node).display !== "none").length);
  const all = await visible();
  const matcher = page.locator('.node.choice[aria-label*="matching.matcher"]');
  await matcher.click();
  assert.ok(await visible() < all / 2);
  assert.equal(await matcher.getAttribute("aria-pressed"), "true");
  const about = await page.locator("#graph-about").innerText();
  assert.match(about, /Because MAT\d+/);
  assert.match(about, /From\n/);
  assert.ok(await page.locator(".edge.near").count() >= 1);
  await page.locator("#graph").screenshot({path: path.join(BUILD, "graph-chosen.png")});
  await page.keyboard.press("Escape");
  assert.equal(await visible(), all);
  await page.getByLabel("draw only what belongs").uncheck();
  await matcher.click();
  assert.equal(await visible(), all);
  assert.ok(await page.locator(".filtered .node:not(.near)").count() > 0);
  await page.getByRole("button", {name: "Show all"}).click();
  assert.equal(await page.locator(".filtered").count(), 0);
}));

test("the graph is used by keys alone: along the arrows, up and down, and chosen", () => opened({}, async page => {
  assert.equal(await page.locator('.node[tabindex="0"]').count(), 1);
  await page.locator("#graph-all").focus();
  await page.keyboard.press("Tab");
  const label = () => page.evaluate(() => document.activeElement.getAttribute("aria-label") || "");
  for (let k = 0; k < 3 && !/^(Fact|Rule)/.test(await label()); k++) await page.keyboard.press("Tab");
  const first = await label();
  await page.keyboard.press("ArrowRight");
  const second = await label();
  assert.notEqual(second, first);
  await page.keyboard.press("ArrowDown");
  assert.notEqual(await label(), second);
  await page.keyboard.press("ArrowUp");
  assert.equal(await label(), second);
  await page.keyboard.press("Enter");
  assert.equal(await page.locator(".node.chosen").getAttribute("aria-label"), second);
  assert.equal(await page.locator("#graph-about h3").innerText(), second);
}));

test("every box of the graph tells something", () => opened({}, async page => {
  const silent = await page.$$eval(".node", nodes => nodes.filter(node => {
    node.dispatchEvent(new MouseEvent("click"));
    return document.getElementById("graph-about").innerText.trim() === node.getAttribute("aria-label");
  }).map(node => node.getAttribute("aria-label")));
  assert.deepEqual(silent, []);
}));

test("beaten candidates are in the graph, and say what beat them", () => opened({}, async page => {
  const beaten = page.locator(".node.lost").first();
  await beaten.click();
  assert.match(await page.locator("#graph-about").innerText(), /From\n[\s\S]*beat it/);
}));

test("facts are filtered by words and by whether they mattered, and sorted by a click or a key", () => opened({}, async page => {
  const rows = page.locator("#facts tbody tr:visible"), all = await rows.count();
  await page.getByLabel("only those that rules fired on").check();
  const mattered = await rows.count();
  assert.ok(mattered > 0 && mattered < all);
  await page.locator("#fact-words").fill("noise");
  assert.ok(await rows.count() < mattered);
  assert.match(await page.locator("#facts-shown").innerText(), new RegExp(`^\\d+ of ${all}$`));
  await page.locator("#fact-words").fill("");
  await page.getByLabel("only those that rules fired on").uncheck();
  const names = () => page.$$eval("#facts tbody th", cells => cells.map(cell => cell.textContent));
  const head = page.locator("#facts thead button").first();
  await head.click();
  const up = await names();
  await head.press("Enter");
  assert.deepEqual(await names(), [...up].reverse());
  assert.equal(await page.locator("#facts th[aria-sort]").getAttribute("aria-sort"), "descending");
}));

test("why-not questions open by mouse and by key", () => opened({}, async page => {
  const question = page.locator("#why-not details").first();
  await question.locator("summary").click();
  assert.ok((await question.locator("p").innerText()).length > 20);
  await question.locator("summary").press("Enter");
  assert.equal(await question.getAttribute("open"), null);
}));

test("the terrain in three dimensions draws, turns under the mouse and answers keys", () => opened({}, async page => {
  await page.getByRole("button", {name: "Show the terrain in three dimensions"}).click();
  const frame = page.frameLocator("#view-3d iframe"), canvas = frame.locator("#view");
  await canvas.waitFor();
  const picture = async () => {
    await page.waitForTimeout(600);
    return (await canvas.screenshot()).toString("base64");
  };
  const colours = await canvas.evaluate(element => new Promise(done => requestAnimationFrame(() => {
    const gl = element.getContext("webgl2"), seen = new Set(), pixel = new Uint8Array(4);
    if (!gl) { done(-1); return; }
    dispatchEvent(new Event("resize"));
    requestAnimationFrame(() => {
      for (let k = 0; k < 400; k++) {
        gl.readPixels(element.width * (k % 20) / 20, element.height * Math.floor(k / 20) / 20, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
        seen.add(pixel.slice(0, 3).join());
      }
      done(seen.size);
    });
  })));
  assert.ok(colours >= 20, `WebGL drew ${colours} colours`);
  const first = await picture();
  await page.locator("#view-3d").screenshot({path: path.join(BUILD, "view-3d.png")});
  const box = await canvas.boundingBox();
  await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
  await page.mouse.down();
  await page.mouse.move(box.x + box.width / 2 + 120, box.y + box.height / 2 + 30, {steps: 4});
  await page.mouse.up();
  const turned = await picture();
  assert.notEqual(turned, first);
  await canvas.focus();
  await page.keyboard.press("2");
  const coloured = await picture();
  assert.notEqual(coloured, turned);
  assert.equal(await frame.locator("#colour").inputValue(), "height");
  await page.keyboard.press("ArrowLeft");
  assert.notEqual(await picture(), coloured);
}));

test("the page of the terrain alone opens without error or request", () => opened({file: "run/terrain.html"}, async page => {
  await page.waitForTimeout(500);
  await shot(page, "terrain");
}));

test("links lead to their sections, and the first Tab leads past them", () => opened({}, async page => {
  const dead = await page.$$eval('a[href^="#"]', links => links.filter(link => !document.querySelector(link.getAttribute("href"))).map(link => link.href));
  assert.deepEqual(dead, []);
  await page.keyboard.press("Tab");
  assert.equal(await page.evaluate(() => document.activeElement.textContent), "Skip to the verdict");
}));

test("on paper what decided is open and nothing is a control", () => opened({width: 794, height: 1123}, async page => {
  await page.emulateMedia({media: "print"});
  await page.evaluate(() => dispatchEvent(new Event("beforeprint")));
  await page.emulateMedia({media: "screen"});
  await page.locator("#why-not summary").nth(1).click();
  await page.emulateMedia({media: "print"});
  assert.equal(await page.locator("details:visible:not([open])").count(), 0);
  assert.equal(await page.locator("#why-not details:visible").count(), 1);
  assert.equal(await page.locator("#rules details:visible").count(), await page.locator("#rules details").count());
  assert.equal(await page.locator("#facts tbody tr:visible").count(), await page.locator("#facts tr.mattered").count());
  assert.ok(await overflows(page) <= 0, "the page is wider than the paper");
  for (const name of ["nav", ".control", ".view-3d button"]) assert.equal(await page.locator(`${name}:visible`).count(), 0, name);
  assert.equal(await page.locator(".wipe img:visible").count(), 2 * await page.locator(".wipe").count());
  await page.pdf({path: path.join(BUILD, "report.pdf"), format: "A4"});
  assert.ok(statSync(path.join(BUILD, "report.pdf")).size > 50_000);
}));

test("markup in names, rules, facts and findings appears as text", () => opened({file: "hostile/report.html"}, async page => {
  assert.equal(await page.locator("h1").innerText(), EVIL);
  assert.ok((await page.locator("#rules summary").first().innerText()).includes(EVIL));
  assert.ok((await page.locator("#facts").innerText()).includes(EVIL));
  assert.ok((await page.locator("#verdict").innerText()).includes(EVIL));
  assert.equal(await page.locator("script").count(), 2);
  await page.$$eval(".node", nodes => nodes.forEach(node => node.dispatchEvent(new MouseEvent("click"))));
  assert.ok((await page.locator("#graph-about").innerText()).includes(EVIL));
  assert.equal(await page.locator("script").count(), 2);
  await page.locator("#open-3d").click();
  const inside = page.frameLocator("#view-3d iframe");
  assert.equal(await inside.locator("h1").innerText(), EVIL);
  await page.waitForTimeout(500);
  await shot(page, "hostile");
}));
