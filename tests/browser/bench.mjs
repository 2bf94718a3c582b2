/**
 * What the page takes of a browser with 400 objects at 60 Hz and 16 cameras: `npm run bench`, by Chromium's own trace.
 *
 *     npm run bench                  # 10 s of each view, and two minutes in which views change
 *     MINUTES=10 ROBOTS=400 CAMERAS=16 npm run bench
 *     ROUNDEL_URL=http://127.0.0.1:7670 npm run bench   # whatever this server has
 *
 * The server is the real one with an invented crowd (`cargo build --release -p roundel-tests --bin crowd`; ROUNDEL_CROWD
 * names another file of it), and where that has not been built, the mock.
 *
 * A frame is what lies between two animation frames; its time is that of all tasks of the page's main thread in it, by
 * the thread's own clock and by the wall's. Where the machine does other work, only the first is the page's.
 */

import { fork, spawn } from "node:child_process";
import { existsSync } from "node:fs";
import { join } from "node:path";
import { fileURLToPath } from "node:url";

import { countDraws, launch, openDashboard } from "./harness.mjs";
import { startMock } from "./mock.mjs";
import { World } from "./world.mjs";

const ROBOTS = Number(process.env.ROBOTS ?? 400);
const CAMERAS = Number(process.env.CAMERAS ?? 16);
const MINUTES = Number(process.env.MINUTES ?? 2);
const TRACE_MS = 10_000;
/** Of each minute of the long run so much is traced. */
const SAMPLE_MS = 5000;
/** Trails have to grow first. */
const WARM_UP_MS = 8000;
/** How many snapshots cameras of an object are kept for: whom sixteen cameras see is dear to work out sixty times a second. */
const KEPT = 30;

class Busy extends World {
  /** Made once: a picture is as dear to show as ever, but not to make. */
  picture(name) {
    this.pictures ??= new Map();
    if (!this.pictures.has(name)) this.pictures.set(name, super.picture(name));
    return this.pictures.get(name);
  }

  state(robot, t) {
    const { mounts } = this;
    const isDue = !robot.seenBy || (this.sequence + robot.id) % KEPT === 0;
    if (!isDue) this.mounts = [];
    const state = super.state(robot, t);
    this.mounts = mounts;
    if (isDue) robot.seenBy = state.cameras;
    return { ...state, cameras: robot.seenBy };
  }
}

if (process.argv[2] === "serve") {
  const { url } = await startMock({ world: new Busy({ robots: ROBOTS, cameras: CAMERAS }) });
  process.send(url);
} else {
  const { url, what, stop } = await startServer();
  const browser = await launch({ space: true });
  try {
    console.log(`${what} at ${url}: ${ROBOTS} objects, ${CAMERAS} cameras; ${browser.version()}`);
    for (const mode of ["top", "space", "health"]) await measureFrames(browser, url, mode);
    if (MINUTES > 0) await measureMinutes(browser, url);
  } finally {
    await browser.close();
    stop();
  }
}

async function startServer() {
  const given = process.env.ROUNDEL_URL;
  if (given) return { url: given, what: "what is", stop: () => {} };
  const target = process.env.CARGO_TARGET_DIR ?? fileURLToPath(new URL("../../target", import.meta.url));
  const binary = process.env.ROUNDEL_CROWD ?? join(target, "release/crowd");
  if (!process.env.ROUNDEL_CROWD && !existsSync(binary)) {
    const mock = fork(fileURLToPath(import.meta.url), ["serve"]);
    return { url: await new Promise((resolve) => mock.once("message", resolve)), what: "the mock", stop: () => mock.kill() };
  }
  // It ends with its standard input.
  const server = spawn(binary, [String(ROBOTS), String(CAMERAS)], { stdio: ["pipe", "pipe", "inherit"] });
  const url = await new Promise((resolve, reject) => {
    server.stdout.once("data", (chunk) => resolve(String(chunk).trim()));
    server.once("error", reject);
    server.once("exit", (code) => reject(new Error(`${binary} ended with ${code}`)));
  });
  return { url, what: "the real server's crowd", stop: () => server.kill() };
}

async function measureFrames(browser, url, mode) {
  const { page, context } = await openDashboard(browser, url);
  await page.locator("#object-rows button").nth(6).click();
  await page.locator(`input[name=mode][value=${mode}]`).check();
  const draws = await countDraws(page);
  await page.waitForTimeout(WARM_UP_MS);
  console.log(`${mode}: ${await frameWords(browser, page, mode, draws, TRACE_MS)}`);
  await context.close();
}

async function frameWords(browser, page, mode, draws, lengthMs) {
  const events = await traced(browser, () => page.waitForTimeout(lengthMs));
  const frames = framesOf(events);
  const rate = await page.locator("#rate").textContent();
  const most = mode === "space" ? `, at most ${await draws()} draws` : "";
  const line = (key) => [0.5, 0.95, 0.99].map((part) => quantile(frames.map((frame) => frame[key]), part).toFixed(1)).join(" / ");
  return `${frames.length} frames in ${lengthMs / 1000} s at ${rate} snapshots a second; main thread p50 / p95 / p99: ${line("threadMs")} ms of its own, ${line("wallMs")} ms by the wall${most}`;
}

async function traced(browser, body) {
  const session = await browser.newBrowserCDPSession();
  const events = [];
  session.on("Tracing.dataCollected", ({ value }) => events.push(...value));
  await session.send("Tracing.start", {
    transferMode: "ReportEvents",
    traceConfig: { includedCategories: ["devtools.timeline", "disabled-by-default-devtools.timeline", "toplevel", "__metadata"] },
  });
  await body();
  const done = new Promise((resolve) => session.once("Tracing.tracingComplete", resolve));
  await session.send("Tracing.end");
  await done;
  await session.detach();
  return events;
}

/** Time of the main thread between one animation frame and the next. */
function framesOf(events) {
  const thread = ({ pid, tid }) => `${pid} ${tid}`;
  const starts = events.filter(({ name }) => name === "FireAnimationFrame");
  const counts = new Map();
  for (const event of starts) counts.set(thread(event), (counts.get(thread(event)) ?? 0) + 1);
  const [main] = [...counts].sort((a, b) => b[1] - a[1])[0] ?? [];
  if (!main) throw new Error("the trace has no animation frames");
  const bounds = starts.filter((event) => thread(event) === main).map(({ ts }) => ts).sort((a, b) => a - b);
  const isTask = ({ name, ph }) => ph === "X" && (name === "RunTask" || name === "ThreadControllerImpl::RunTask");
  let tasks = events.filter((event) => isTask(event) && thread(event) === main);
  // Both names tell of the same tasks.
  if (tasks.some(({ name }) => name === "RunTask")) tasks = tasks.filter(({ name }) => name === "RunTask");
  const frames = bounds.slice(1).map(() => ({ threadMs: 0, wallMs: 0 }));
  for (const { ts, dur, tdur } of tasks) {
    // A task counts for the frame in which it ends: the one of an animation frame begins before that.
    const at = bounds.findIndex((bound, i) => ts + dur > bound && ts + dur <= (bounds[i + 1] ?? Infinity));
    if (at < 0 || at >= frames.length) continue;
    frames[at].threadMs += (tdur ?? dur) / 1000;
    frames[at].wallMs += dur / 1000;
  }
  return frames;
}

function quantile(values, part) {
  const sorted = [...values].sort((a, b) => a - b);
  return sorted[Math.min(sorted.length - 1, Math.floor(part * sorted.length))] ?? 0;
}

/** Memory each minute, with what a frame takes then; the view is another each minute. */
async function measureMinutes(browser, url) {
  const { page, context } = await openDashboard(browser, url);
  const session = await context.newCDPSession(page);
  await session.send("Performance.enable");
  await page.locator("#object-rows button").nth(6).click();
  const draws = await countDraws(page);
  await page.waitForTimeout(WARM_UP_MS);
  for (let minute = 0; minute <= MINUTES; minute += 1) {
    const mode = minute % 2 ? "space" : "top";
    await page.locator(`input[name=mode][value=${mode}]`).check();
    if (minute > 0) await page.waitForTimeout(60_000 - SAMPLE_MS);
    const frames = await frameWords(browser, page, mode, draws, SAMPLE_MS);
    await session.send("HeapProfiler.collectGarbage");
    const { metrics } = await session.send("Performance.getMetrics");
    const held = (name) => metrics.find((metric) => metric.name === name).value;
    const { backingStorageSize = 0 } = await session.send("Runtime.getHeapUsage");
    console.log(`after ${minute} min, ${mode}: ${(held("JSHeapUsedSize") / 1e6).toFixed(1)} MB of objects, ${(backingStorageSize / 1e6).toFixed(1)} MB of arrays, ${held("Nodes")} nodes; ${frames}`);
  }
  await context.close();
}
