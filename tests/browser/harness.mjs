/** Starts server, browser and page for the tests, and records console messages and requests of the page. */

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { createServer, connect } from "node:net";

import { chromium } from "playwright-core";

import { startMock } from "./mock.mjs";

/** Timeout of waits, ms. */
export const PATIENCE_MS = 30_000;

const EXECUTABLE = process.env.CHROMIUM ?? "/usr/bin/chromium";
const FLAGS = [
  "--headless",
  "--no-sandbox",
  "--disable-quic",
  "--no-first-run",
  "--disable-background-networking",
  "--disable-component-update",
  "--disable-sync",
];

/** The server under test: that at ROUNDEL_URL, or a mock server, which has a `world`. */
export async function target() {
  const url = process.env.ROUNDEL_URL;
  if (!url) return startMock();
  return { url: new URL("/", url).href, world: null, close: async () => {} };
}

/** WebGL is either off, or rendered in software, as on machines without a GPU. */
const PLAIN = ["--disable-gpu"];
const SPACE = ["--use-angle=swiftshader-webgl", "--enable-unsafe-swiftshader"];

/** @param {{space?: boolean, flags?: string[]}} [options] whether there is WebGL; further flags of Chromium */
export function launch({ space = false, flags = [] } = {}) {
  return chromium.launch({ executablePath: EXECUTABLE, args: [...FLAGS, ...(space ? SPACE : PLAIN), ...flags] });
}

/**
 * Opens the page and waits until it is connected.
 * @param {import("playwright-core").Browser} browser
 * @param {string} url
 * @param {import("playwright-core").BrowserContextOptions} [options]
 */
export async function openDashboard(browser, url, options = {}) {
  const context = await browser.newContext({ viewport: { width: 1440, height: 900 }, ...options });
  const page = await context.newPage();
  /** @type {string[]} */
  const complaints = [];
  /** @type {string[]} */
  const foreign = [];
  page.on("console", (message) => {
    if (message.type() === "error" || message.type() === "warning") complaints.push(message.text());
  });
  page.on("pageerror", (error) => complaints.push(String(error)));
  page.on("request", (request) => {
    const { protocol, host } = new URL(request.url());
    const inside = protocol === "blob:" || protocol === "data:" || host === new URL(url).host;
    if (!inside) foreign.push(request.url());
  });
  await page.goto(url);
  await page.locator('body[data-phase="live"]').waitFor();
  return { context, page, complaints, foreign };
}

/**
 * Opens the page, runs `body`, and closes the page.
 * @param {import("playwright-core").Browser} browser
 * @param {string} url
 * @param {import("playwright-core").BrowserContextOptions} options
 * @param {(page: import("playwright-core").Page, opened: Awaited<ReturnType<typeof openDashboard>>) => Promise<unknown>} body
 */
export async function visit(browser, url, options, body) {
  const opened = await openDashboard(browser, url, options);
  opened.page.setDefaultTimeout(PATIENCE_MS);
  try {
    return await body(opened.page, opened);
  } finally {
    await opened.context.close();
  }
}

/** Like `visit`, and waits until objects are listed. @type {typeof visit} */
export function visitObjects(browser, url, options, body) {
  return visit(browser, url, options, async (page, opened) => {
    await page.locator("#object-rows tr").first().waitFor();
    return body(page, opened);
  });
}

/** Checksum of a canvas. */
export function canvasSum(page, id) {
  return page.evaluate((name) => {
    const canvas = document.getElementById(name);
    const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d", { willReadFrequently: true });
    copy.drawImage(canvas, 0, 0);
    const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
    let sum = 0;
    for (let i = 0; i < data.length; i += 4) {
      sum = (sum * 31 + data[i] + 7 * data[i + 1] + 13 * data[i + 2] + 17 * data[i + 3]) % 4294967291;
    }
    return sum;
  }, id);
}

/** Waits until a canvas's checksum meets a condition. */
export async function assertPicture(page, id, wanted, complaint) {
  const until = Date.now() + PATIENCE_MS;
  while (!wanted(await canvasSum(page, id))) {
    assert.ok(Date.now() < until, `${id} ${complaint} for ${PATIENCE_MS} ms`);
    await page.waitForTimeout(100);
  }
}

export const assertChanges = (page, id, before) =>
  assertPicture(page, id, (sum) => sum !== before, "shows the same picture");
export const assertReturns = (page, id, before) =>
  assertPicture(page, id, (sum) => sum === before, "does not return to its picture");

/** Asserts that axe finds no serious violations. @param {import("playwright-core").Page} page @param {string} [part] selector */
export async function assertAccessible(page, part = "html") {
  const axe = await readFile(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
  await page.evaluate(axe);
  const { violations, passes } = await page.evaluate((selector) => globalThis.axe.run(selector), part);
  assert.ok(passes.length > 0, `${part} exists`);
  const grave = violations.filter(({ impact }) => impact === "serious" || impact === "critical");
  assert.deepEqual(grave.map(({ help, nodes }) => [help, nodes.map((node) => node.html)]), []);
}

/** The worker that draws. @param {import("playwright-core").Page} page */
export async function drawingWorker(page) {
  return page.workers()[0] ?? page.waitForEvent("worker");
}

/**
 * Counts WebGL draw calls in the worker.
 * @param {import("playwright-core").Page} page
 * @returns {Promise<() => Promise<number>>} returns the largest number in one of the next frames
 */
export async function countDraws(page) {
  const worker = await drawingWorker(page);
  await worker.evaluate(() => {
    globalThis.draws = 0;
    for (const name of ["drawArrays", "drawElements", "drawArraysInstanced", "drawElementsInstanced"]) {
      const plain = WebGL2RenderingContext.prototype[name];
      WebGL2RenderingContext.prototype[name] = function (...all) {
        globalThis.draws += 1;
        return plain.apply(this, all);
      };
    }
  });
  return () =>
    worker.evaluate(async (patience) => {
      const until = Date.now() + patience;
      let [most, drawn] = [0, 0];
      // Frames without changes are not drawn.
      for (let frame = 0; frame < 30 || (drawn < 3 && Date.now() < until); frame += 1) {
        globalThis.draws = 0;
        await new Promise(requestAnimationFrame);
        if (globalThis.draws > 0) drawn += 1;
        most = Math.max(most, globalThis.draws);
      }
      return most;
    }, PATIENCE_MS);
}

/**
 * Reads the table of objects as numbers, by id.
 * @param {import("playwright-core").Page} page
 * @returns {Promise<Map<number, {stage: string, x: number, y: number, z: number}>>}
 */
export async function readObjects(page) {
  const rows = await page.locator("#object-rows tr").evaluateAll((all) =>
    all.map((row) => [
      row.dataset.objectId,
      row.dataset.stage,
      ...[...row.querySelectorAll("td")].slice(0, 3).map((cell) => cell.textContent),
    ]),
  );
  const number = (text) => Number(text.replace("\u2212", "-"));
  return new Map(
    rows.map(([id, stage, x, y, z]) => [Number(id), { stage, x: number(x), y: number(y), z: number(z) }]),
  );
}

/**
 * A TCP proxy between browser and server that can be cut, frozen and mended.
 * @param {string} url
 */
export async function startLine(url) {
  let end = new URL(url);
  const sockets = new Set();
  /** @type {"whole" | "cut" | "frozen"} */
  let state = "whole";
  const keep = (socket, others) => {
    sockets.add(socket);
    socket.on("error", () => {});
    socket.on("close", () => {
      sockets.delete(socket);
      for (const other of others) other.destroy();
    });
  };
  const server = createServer((near) => {
    if (state === "cut") return near.destroy();
    if (state === "frozen") return keep(near, []);
    const far = connect(Number(end.port), end.hostname);
    keep(near, [far]);
    keep(far, [near]);
    near.pipe(far).pipe(near);
  });
  const destroyAll = () => {
    for (const socket of sockets) socket.destroy();
  };
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  return {
    url: `http://127.0.0.1:${server.address().port}/`,
    cut() {
      state = "cut";
      destroyAll();
    },
    /** Connections stay open and new ones are accepted, but no data passes, as with a broken network. */
    freeze() {
      state = "frozen";
      for (const socket of sockets) socket.unpipe().pause();
    },
    /** New connections pass again, to another server if one is given; frozen ones stay dead. */
    mend(other = end.href) {
      end = new URL(other);
      state = "whole";
    },
    async close() {
      state = "cut";
      destroyAll();
      await new Promise((resolve) => server.close(resolve));
    },
  };
}
