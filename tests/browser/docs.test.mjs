// The documentation opens from its folder, without a server or a network, and its links lead somewhere.

import assert from "node:assert/strict";
import {existsSync, readFileSync, readdirSync} from "node:fs";
import path from "node:path";
import {after, before, test} from "node:test";
import {BUILD, open, overflows, shot, start, stop} from "./browser.mjs";

const HOME = "../../site", SITE = path.resolve(BUILD, HOME);
const PAGES = ["index.html", "tutorial.html", "how-to/batch.html", "methods.html", "generated/rules/index.html", "reference/python.html"];
before(start);
after(stop);

for (const file of PAGES) {
  test(`${file} opens without error or request, on a screen and a phone`, async () => {
    for (const width of [1200, 390]) {
      const {page, trouble, close} = await open(path.join(HOME, file), {home: HOME, width});
      assert.ok((await page.locator("h1").first().innerText()).length > 2);
      assert.ok(await overflows(page) <= 0, "the page scrolls sideways");
      await shot(page, `docs-${path.basename(file, ".html")}-${width}`);
      assert.deepEqual(trouble, []);
      await close();
    }
  });
}

test("links between pages, and to places in them, lead somewhere", () => {
  const files = readdirSync(SITE, {recursive: true}).filter(name => name.endsWith(".html") && name !== "404.html");
  const ids = new Map(), dead = [];
  const known = file => {
    if (!ids.has(file)) ids.set(file, new Set([...readFileSync(file, "utf8").matchAll(/ (?:id|name)="([^"]+)"/g)].map(found => found[1])));
    return ids.get(file);
  };
  for (const name of files) {
    const file = path.join(SITE, name);
    for (const [, link] of readFileSync(file, "utf8").matchAll(/<a [^>]*href="([^"]+)"/g)) {
      if (/^[a-z]+:/.test(link)) continue;
      const [where, place] = link.split("#"), target = where ? path.resolve(path.dirname(file), decodeURIComponent(where)) : file;
      if (!existsSync(target)) dead.push(`${name}: ${link}`);
      else if (place && !place.startsWith("__") && target.endsWith(".html") && !known(target).has(decodeURIComponent(place))) dead.push(`${name}: ${link}`);
    }
  }
  assert.ok(files.length > 10);
  assert.deepEqual([...new Set(dead)].slice(0, 20), []);
});
