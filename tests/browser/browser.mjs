// Opens pages in Chromium, offline, and keeps account of what goes wrong in them.

import {existsSync, mkdirSync} from "node:fs";
import path from "node:path";
import {fileURLToPath, pathToFileURL} from "node:url";
import {chromium} from "playwright-core";

export const BUILD = path.resolve(path.dirname(fileURLToPath(import.meta.url)), "../../build/browser");
export const EVIL = `<script>alert('x')</script>"&'`;  // as in tests/expert/made_reports.py
const NAMES = ["chromium", "chromium-browser", "google-chrome", "chrome"];
const ARGUMENTS = ["--enable-unsafe-swiftshader", "--use-angle=swiftshader", "--disable-dev-shm-usage"];

export function chromiumPath() {
  if (process.env.CHROMIUM) return process.env.CHROMIUM;
  const folders = process.env.PATH.split(path.delimiter);
  return folders.flatMap(folder => NAMES.map(name => path.join(folder, name))).find(file => existsSync(file));
}

let browser = null;

export async function start() {
  mkdirSync(BUILD, {recursive: true});
  browser = await chromium.launch({executablePath: chromiumPath(), args: ARGUMENTS, chromiumSandbox: process.getuid() !== 0});
}

export async function stop() {
  await browser.close();
}

// Open a file; `trouble` collects console messages, uncaught errors, dialogs and requests beyond the folder `home`.
export async function open(file, {width = 1200, height = 1600, dark = false, home = path.dirname(file)} = {}) {
  const context = await browser.newContext({viewport: {width, height}, colorScheme: dark ? "dark" : "light", offline: true});
  const page = await context.newPage();
  page.setDefaultTimeout(15000);
  const trouble = [], inside = pathToFileURL(path.join(BUILD, home)).href;
  page.on("console", message => {
    if (["error", "warning"].includes(message.type()) && !known(message.text())) trouble.push(`${message.type()}: ${message.text()}`);
  });
  page.on("pageerror", error => trouble.push(`uncaught: ${error.message}`));
  page.on("dialog", dialog => { trouble.push(`dialog: ${dialog.message()}`); dialog.dismiss(); });
  page.on("request", request => {
    if (!/^(data|about|blob):/.test(request.url()) && !request.url().startsWith(inside)) trouble.push(`request: ${request.url()}`);
  });
  await page.goto(pathToFileURL(path.join(BUILD, file)).href);
  return {page, trouble, close: () => context.close()};
}

// The software renderer says that reading its pixels back is slow, which the tests do and the page does not.
function known(text) {
  return text.includes("GPU stall due to ReadPixels");
}

export async function shot(page, name, fullPage = false) {
  await page.screenshot({path: path.join(BUILD, `${name}.png`), fullPage});
}

// Return every text whose contrast with what is behind it is below WCAG 2.1 AA.
export function weakTexts(page) {
  return page.evaluate(() => {
    const parse = text => {
      const parts = (text.match(/[\d.]+/g) || [0, 0, 0, 0]).map(Number);
      return [parts[0], parts[1], parts[2], parts.length > 3 ? parts[3] : 1];
    };
    const over = (top, below) => top.slice(0, 3).map((value, k) => value * top[3] + below[k] * (1 - top[3]));
    const light = rgb => {
      const [r, g, b] = rgb.map(value => { const v = value / 255; return v <= 0.03928 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4; });
      return 0.2126 * r + 0.7152 * g + 0.0722 * b;
    };
    const behind = element => {
      const layers = [];
      if (element.namespaceURI.endsWith("svg")) {
        const box = element.closest(".node")?.querySelector("rect");
        if (box) return over(parse(getComputedStyle(box).fill), [255, 255, 255]);
      }
      for (let at = element; at; at = at.parentElement) layers.push(parse(getComputedStyle(at).backgroundColor));
      const canvas = getComputedStyle(document.documentElement).colorScheme.includes("dark") && matchMedia("(prefers-color-scheme: dark)").matches ? [18, 18, 18] : [255, 255, 255];
      return layers.reverse().reduce((below, layer) => over(layer, below), canvas);
    };
    const weak = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
    while (walker.nextNode()) {
      const element = walker.currentNode.parentElement;
      if (!walker.currentNode.textContent.trim() || ["SCRIPT", "STYLE"].includes(element.tagName)) continue;
      if (!element.checkVisibility?.({checkOpacity: true, checkVisibilityCSS: true}) || element.closest(".map svg, defs, title, option")) continue;
      const style = getComputedStyle(element), below = behind(element);
      const ink = over(parse(element.namespaceURI.endsWith("svg") ? style.fill : style.color), below);
      const [high, low] = [light(ink), light(below)].sort((a, b) => b - a), ratio = (high + 0.05) / (low + 0.05);
      const size = parseFloat(style.fontSize), large = size >= 24 || (size >= 18.66 && Number(style.fontWeight) >= 700);
      if (ratio < (large ? 3 : 4.5)) weak.push(`${ratio.toFixed(2)} "${walker.currentNode.textContent.trim().slice(0, 40)}" ${element.tagName}.${element.getAttribute("class")}`);
    }
    return weak;
  });
}

// Return whether headings go down by one level at most, pictures have texts, and fields have names.
export function structure(page) {
  return page.evaluate(() => {
    const faults = [], named = element => element.getAttribute("aria-label") || element.labels?.length || element.textContent.trim() || element.title;
    let last = 0;
    document.querySelectorAll("h1, h2, h3, h4, h5").forEach(head => {
      if (!head.checkVisibility()) return;
      const level = Number(head.tagName[1]);
      if (level > last + 1) faults.push(`h${level} after h${last}: ${head.textContent}`);
      last = level;
    });
    document.querySelectorAll("img").forEach(image => { if (!image.alt) faults.push(`no alt: ${image.src.slice(0, 40)}`); });
    document.querySelectorAll("button, input, select, a, [role=button]").forEach(element => { if (!named(element)) faults.push(`no name: ${element.outerHTML.slice(0, 80)}`); });
    const ids = [...document.querySelectorAll("[id]")].map(element => element.id);
    ids.forEach((id, index) => { if (ids.indexOf(id) !== index) faults.push(`id twice: ${id}`); });
    if (!document.documentElement.lang) faults.push("no language");
    return faults;
  });
}

export function overflows(page) {
  return page.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
}
