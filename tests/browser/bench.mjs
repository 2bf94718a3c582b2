/**
 * Measures the browser's load with 400 objects at 60 Hz and 16 cameras, from Chromium's trace: `npm run bench`.
 *
 *     npm run bench                  # 10 s of each view, and two minutes with changing views
 *     MINUTES=10 ROBOTS=400 CAMERAS=16 npm run bench
 *     ROUNDEL_URL=http://127.0.0.1:7670 npm run bench   # another server
 *     TRACE_FILE=/tmp/trace npm run bench               # keeps the traces
 *
 * The server is the real one with simulated objects (`cargo build --release -p roundel-tests`; ROUNDEL_TESTS
 * names another binary), or the mock server if that has not been built.
 *
 * The time of a frame is that of all tasks of the page's main thread between two animation frames, by the thread's CPU
 * clock and by the wall clock; on a busy machine only the first belongs to the page. The page itself requests few
 * animation frames, since it draws in a worker; the benchmark requests every one. It also prints the worker's frame rate
 * and CPU time.
 */

import { fork, spawn } from "node:child_process";
import { existsSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { fileURLToPath } from "node:url";

import { countDraws, launch, openDashboard } from "./harness.mjs";
import { startMock } from "./mock.mjs";
import { World } from "./world.mjs";

const ROBOTS = Number(process.env.ROBOTS ?? 400);
const CAMERAS = Number(process.env.CAMERAS ?? 16);
const MINUTES = Number(process.env.MINUTES ?? 2);
const TRACE_MS = 10_000;
/** Traced part of each minute of the long run. */
const SAMPLE_MS = 5000;
/** Time for trails to grow. */
const WARM_UP_MS = 8000;
/** Snapshots for which an object's cameras are cached, since visibility in sixteen cameras is slow to compute. */
const KEPT = 30;

class Busy extends World {
  /** Encoded once, since only the cost of displaying it is measured. */
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
  const binary = process.env.ROUNDEL_TESTS ?? join(target, "release/roundel-tests");
  if (!process.env.ROUNDEL_TESTS && !existsSync(binary)) {
    const mock = fork(fileURLToPath(import.meta.url), ["serve"]);
    return { url: await new Promise((resolve) => mock.once("message", resolve)), what: "the mock", stop: () => mock.kill() };
  }
  // The server stops when its standard input closes.
  const server = spawn(binary, ["dashboard-load", String(ROBOTS), String(CAMERAS)], { stdio: ["pipe", "pipe", "inherit"] });
  const url = await new Promise((resolve, reject) => {
    server.stdout.once("data", (chunk) => resolve(String(chunk).trim()));
    server.once("error", reject);
    server.once("exit", (code) => reject(new Error(`${binary} ended with ${code}`)));
  });
  return { url, what: "the real server", stop: () => server.kill() };
}

async function measureFrames(browser, url, mode) {
  const { page, context } = await openBusy(browser, url);
  await page.locator(`input[name=mode][value=${mode}]`).check();
  const draws = await countDraws(page);
  await page.waitForTimeout(WARM_UP_MS);
  console.log(`${mode}: ${await frameText(browser, page, mode, draws, TRACE_MS)}`);
  await context.close();
}

/** Opens the page with an object selected, and requests every animation frame. */
async function openBusy(browser, url) {
  const opened = await openDashboard(browser, url);
  await opened.page.locator("#object-rows button").nth(6).click();
  await opened.page.evaluate(() => {
    const beat = () => requestAnimationFrame(beat);
    beat();
  });
  return opened;
}

async function frameText(browser, page, mode, draws, lengthMs) {
  const events = await traced(browser, () => page.waitForTimeout(lengthMs));
  if (process.env.TRACE_FILE) writeFileSync(`${process.env.TRACE_FILE}-${mode}.json`, JSON.stringify(events));
  const [frames, drawn] = ["CrRendererMain", "DedicatedWorker thread"].map((name) => framesOf(events, name));
  const rate = await page.locator("#rate").textContent();
  const most = mode === "space" ? `, at most ${await draws()} draws` : "";
  const line = (all, key) => [0.5, 0.95, 0.99].map((part) => quantile(all.map((frame) => frame[key]), part).toFixed(1)).join(" / ");
  const perSecond = (all) => (all.length / (lengthMs / 1000)).toFixed(0);
  return (
    `${perSecond(frames)} frames and ${rate} snapshots a second; main thread p50 / p95 / p99: ${line(frames, "threadMs")} ms of its own, ` +
    `${line(frames, "wallMs")} ms by the wall; drawn ${perSecond(drawn)} times a second, ${line(drawn, "threadMs")} ms of the worker's own${most}`
  );
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

/** Times between consecutive animation frames of the busiest thread of this name. */
function framesOf(events, wanted) {
  const thread = ({ pid, tid }) => `${pid} ${tid}`;
  const named = new Set(events.filter(({ name, args }) => name === "thread_name" && args.name === wanted).map(thread));
  const starts = events.filter((event) => event.name === "FireAnimationFrame" && named.has(thread(event)));
  const counts = new Map();
  for (const event of starts) counts.set(thread(event), (counts.get(thread(event)) ?? 0) + 1);
  const [main] = [...counts].sort((a, b) => b[1] - a[1])[0] ?? [];
  if (!main) return [];
  const isTask = ({ name, ph }) => ph === "X" && (name === "RunTask" || name === "ThreadControllerImpl::RunTask");
  let tasks = events.filter((event) => isTask(event) && thread(event) === main);
  // Both names are used for the same tasks.
  if (tasks.some(({ name }) => name === "RunTask")) tasks = tasks.filter(({ name }) => name === "RunTask");
  // Each callback is an event; those in one task belong to one frame.
  tasks.sort((a, b) => a.ts - b.ts);
  const taskAt = (ts) => tasks.findLast((task) => task.ts <= ts);
  const bounds = [...new Set(starts.filter((event) => thread(event) === main).map(({ ts }) => taskAt(ts)?.ts ?? ts))].sort((a, b) => a - b);
  const frames = bounds.slice(1).map(() => ({ threadMs: 0, wallMs: 0 }));
  for (const { ts, dur, tdur } of tasks) {
    // The task with the animation frame is the first of its frame.
    const at = bounds.findLastIndex((bound) => bound <= ts);
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

/** Memory of page and worker and frame times, once a minute; the view changes every minute. */
async function measureMinutes(browser, url) {
  const { page, context } = await openBusy(browser, url);
  const session = await context.newCDPSession(page);
  const inWorker = await workerSession(session);
  await session.send("Performance.enable");
  const draws = await countDraws(page);
  await page.waitForTimeout(WARM_UP_MS);
  for (let minute = 0; minute <= MINUTES; minute += 1) {
    const mode = minute % 2 ? "space" : "top";
    await page.locator(`input[name=mode][value=${mode}]`).check();
    if (minute > 0) await page.waitForTimeout(60_000 - SAMPLE_MS);
    const frames = await frameText(browser, page, mode, draws, SAMPLE_MS);
    const { metrics } = await session.send("Performance.getMetrics");
    const { value: nodes } = metrics.find(({ name }) => name === "Nodes");
    const of = await heapText((method) => session.send(method));
    console.log(`after ${minute} min, ${mode}: page ${of}, worker ${await heapText(inWorker)}, ${nodes} nodes; ${frames}`);
  }
  await context.close();
}

/** Memory in use after a garbage collection. */
async function heapText(send) {
  await send("HeapProfiler.collectGarbage");
  const { usedSize, backingStorageSize = 0 } = await send("Runtime.getHeapUsage");
  return `${(usedSize / 1e6).toFixed(1)} MB of objects and ${(backingStorageSize / 1e6).toFixed(1)} MB of arrays`;
}

/** Evaluates in the page's worker with the DevTools protocol. */
async function workerSession(session) {
  const attached = new Promise((resolve) => session.once("Target.attachedToTarget", resolve));
  await session.send("Target.setAutoAttach", { autoAttach: true, waitForDebuggerOnStart: false, flatten: false });
  const { sessionId } = await attached;
  const waiting = new Map();
  session.on("Target.receivedMessageFromTarget", ({ message }) => {
    const { id, result } = JSON.parse(message);
    waiting.get(id)?.(result);
    waiting.delete(id);
  });
  let last = 0;
  return async (method) => {
    last += 1;
    const answer = new Promise((resolve) => waiting.set(last, resolve));
    await session.send("Target.sendMessageToTarget", { sessionId, message: JSON.stringify({ id: last, method }) });
    return answer;
  };
}
