/**
 * Pages of other origins against the real server: requests with and without preflight, forms, beacons, WebSockets, and DNS
 * rebinding. A server that allows every origin and host shows that the same attempts would have effects.
 */

import assert from "node:assert/strict";
import { execFile } from "node:child_process";
import { readFile } from "node:fs/promises";
import { join } from "node:path";
import { after, before, describe, test } from "node:test";
import { promisify } from "node:util";

import { PAGE, startAttacker, startLoggingProxy } from "./attacker.mjs";
import { openSockets, readPaths, sendCalls } from "./attacks.mjs";
import { launch, PATIENCE_MS } from "./harness.mjs";
import { BINARY, call, CONFIG, lacking, startLab } from "./lab.mjs";

const LAB = `${CONFIG}
[[camera]]
name = "simulated"
source = "sim:?robots=1"

[[object]]
name = "cart"
roundel = "coded"
code = 3
`;
const PERMISSIVE = LAB.replace("[server]", '[server]\nallow_origins = ["*"]\nallow_hosts = ["*"]');
const ENDLESS = LAB.replace('"camera.yaml"', '"/dev/zero"');
const POSE = { pose: { position: { x: 0, y: 0, z: 3 }, orientation: { x: 1, y: 0, z: 0, w: 0 } } };
const SOURCE = "images:door/*.pgm?fps=5&loop=true";
const VELOCITY = { x: 0.5, y: 0, z: 0 };
const PICTURE = "/api/v1/cameras/door/frame.jpg";
const READABLE = ["/api/v1/snapshot", "/api/v1/info", "/api/v1/configuration", "/api/v1/configuration.toml", "/metrics", "/"];

/** Number of the first calls that succeed in this installation. */
const SUCCEEDING = 12;
/** Every call that is no GET. Those that undo or stop something come after those that need it. @param {number} robot object_id */
const callsOn = (robot) => [
  ["POST", "/api/v1/configuration/check", { toml: ENDLESS }],
  ["POST", "/api/v1/sources/test", { source: SOURCE }],
  ["POST", "/api/v1/recording", { name: "stolen" }],
  ["DELETE", "/api/v1/recording"],
  ["POST", "/api/v1/simulation/drive", { robots: [{ object_id: robot, velocity: VELOCITY }] }],
  ["POST", "/api/v1/simulation/push", { object_id: robot, velocity: VELOCITY, duration_ms: 100 }],
  ["POST", "/api/v1/configuration/objects", { name: "intruder", roundel: "coded", code: 5 }],
  ["PATCH", "/api/v1/configuration/objects/cart", { code: 4 }],
  ["DELETE", "/api/v1/configuration/objects/cart"],
  ["POST", "/api/v1/cameras", { name: "intruder", source: SOURCE, calibration: "camera.yaml", pose: POSE }],
  ["PATCH", "/api/v1/cameras/door", { mode: "fast" }],
  ["DELETE", "/api/v1/cameras/door"],
  // These need an object with a code, a board, a calibration, a replay, or credentials.
  ["PUT", `/api/v1/objects/${robot}/name`, { name: "owned" }],
  ["POST", "/api/v1/lens", { camera: "intruder", board: "7x5" }],
  ["PUT", "/api/v1/lens/finished"],
  ["PUT", "/api/v1/lens/applied"],
  ["DELETE", "/api/v1/lens"],
  ["POST", "/api/v1/calibration", { seconds: 60 }],
  ["PUT", "/api/v1/calibration/applied"],
  ["DELETE", "/api/v1/calibration"],
  ["PATCH", "/api/v1/replay", { paused: true }],
  ["POST", "/api/v1/session", { token: "guessed" }],
  ["DELETE", "/api/v1/session"],
  ["PUT", "/api/v1/configuration", { toml: "" }],
].map(([method, path, body]) => ({ method, path, body }));

let browser;
let attacker;
before(async () => {
  if (lacking) return;
  attacker = await startAttacker();
  browser = await launch({ flags: ["--host-resolver-rules=MAP *.example 127.0.0.1"] });
});
after(async () => {
  await browser?.close();
  await attacker?.close();
});

/** What the attempts would change. @param {Awaited<ReturnType<typeof startLab>>} lab */
async function stateOf(lab) {
  const get = async (path) => (await call(lab, "GET", path)).answer;
  const [recording, recordings, calibration, lens] = await Promise.all(["recording", "recordings", "calibration", "lens"].map(get));
  const { cameras } = await get("cameras");
  const { objects } = await get("objects");
  return {
    file: await lab.config(),
    configuration: (await get("configuration")).toml,
    recording: recording.state,
    recordings: recordings.files.map(({ name }) => name),
    calibration: calibration.stage,
    lens: lens.stage,
    cameras: cameras.map(({ name }) => name),
    names: objects.map(({ name }) => name).filter(Boolean),
  };
}

/** Largest resident memory of the server until now, MB. */
async function peakMemoryMb({ pid }) {
  const status = await readFile(`/proc/${pid}/status`, "utf8");
  return Number(/VmHWM:\s+(\d+) kB/.exec(status)[1]) / 1024;
}

/** Waits until the camera has a picture and the simulated robot can be driven, and returns its object_id. */
async function readyRobot(lab) {
  const until = Date.now() + PATIENCE_MS;
  for (;;) {
    const picture = await fetch(new URL(PICTURE, lab.url));
    for (const { object_id } of (await call(lab, "GET", "objects")).answer.objects) {
      const stop = { robots: [{ object_id: Number(object_id), velocity: { x: 0, y: 0, z: 0 } }] };
      const { status } = await call(lab, "POST", "simulation/drive", stop);
      if (picture.ok && status === 200) return Number(object_id);
    }
    assert.ok(Date.now() < until, "no robot or no picture");
    await new Promise((resolve) => setTimeout(resolve, 100));
  }
}

/**
 * Starts a server behind the logging proxy.
 * @param {string} config
 * @param {(setting: {lab: Awaited<ReturnType<typeof startLab>>, proxy: Awaited<ReturnType<typeof startLoggingProxy>>}) => Promise<unknown>} body
 * @param {object} [more]
 */
async function withLab(config, body, more = {}) {
  const lab = await startLab(config, more);
  const proxy = await startLoggingProxy(lab.url);
  try {
    await body({ lab, proxy });
  } finally {
    await proxy.close();
    await lab.close();
  }
}

/**
 * Opens a page and makes every attempt in it.
 * @param {{url: string, base: string, log: import("./attacker.mjs").Logged[], calls: import("./attacks.mjs").Call[], context?: import("playwright-core").BrowserContext, isSandboxed?: boolean,
 * credentials?: RequestCredentials}} options
 */
async function attack({ url, base, log, calls, context, isSandboxed = false, credentials = "same-origin" }) {
  const own = context ?? (await browser.newContext());
  const page = await own.newPage();
  try {
    await page.goto(url);
    let frame = page.mainFrame();
    if (isSandboxed) {
      await page.evaluate(() => {
        const one = document.createElement("iframe");
        one.sandbox = "allow-scripts allow-forms";
        one.srcdoc = "<body></body>";
        const loaded = new Promise((resolve) => one.addEventListener("load", resolve));
        document.body.append(one);
        return loaded.then(() => {});
      });
      frame = page.frames()[1];
    }
    const read = await frame.evaluate(readPaths, { base, paths: READABLE, picture: PICTURE, credentials });
    const messages = await frame.evaluate(openSockets, { base });
    const sent = await frame.evaluate(sendCalls, { base, calls, credentials });
    await answered(log, calls);
    return { read, messages, sent };
  } finally {
    await page.close();
    if (!context) await own.close();
  }
}

/** Requests that would change something. @param {import("./attacker.mjs").Logged[]} log */
const changes = (log) => log.filter(({ method }) => method !== "GET" && method !== "OPTIONS");
const learned = (attempts) => attempts.filter(({ read }) => read !== null);
const describeRequest = ({ method, path, contentType, status }) => `${method} ${path} ${contentType} ${status}`;

/**
 * Which attempts that need no preflight have not reached the server yet, with each kind of body that a page can send.
 * @param {import("./attacker.mjs").Logged[]} log
 * @param {import("./attacks.mjs").Call[]} calls
 */
function missing(log, calls) {
  // no-cors text and json, readable text, XHR, beacon, form.
  const expected = Object.entries({ "text/plain": 6, "application/x-www-form-urlencoded": 2, "multipart/form-data": 1 });
  return calls.filter(({ method }) => method === "POST").flatMap(({ path }) => {
    const answered = changes(log).filter((one) => one.path === path && one.status !== 0);
    const number = (kind) => answered.filter(({ contentType }) => contentType?.startsWith(kind)).length;
    return expected.filter(([kind, least]) => number(kind) < least).map(([kind]) => `${kind} to ${path}`);
  });
}

/** Waits until all attempts have been answered: beacons have no response that a page could wait for. */
async function answered(log, calls) {
  const until = Date.now() + PATIENCE_MS;
  while (missing(log, calls).length > 0 || log.some(({ status }) => status === 0)) {
    assert.ok(Date.now() < until, `not answered: ${missing(log, calls)}`);
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
}

test("the attempts cover every call that changes something", { skip: lacking }, async () => {
  await withLab(LAB, async ({ lab }) => {
    const { paths } = await (await fetch(new URL("/openapi.json", lab.url))).json();
    const described = Object.entries(paths).flatMap(([path, methods]) =>
      Object.keys(methods).filter((method) => method !== "get").map((method) => `${method.toUpperCase()} ${path}`),
    );
    const general = (path) => path.replace(/\/(cart|door)$/, "/{name}").replace("/objects/1/", "/objects/{id}/");
    assert.deepEqual(callsOn(1).map(({ method, path }) => `${method} ${general(path)}`).sort(), described.sort());
  });
});

describe("a page of another origin", { skip: lacking }, () => {
  const origins = {
    "of another site": { page: (port) => `http://attacker.example:${port}/`, origin: (port) => `http://attacker.example:${port}` },
    "of another port of the same computer": { page: (port) => `http://127.0.0.1:${port}/`, origin: (port) => `http://127.0.0.1:${port}` },
    "in a sandbox, without an origin": { page: (port) => `http://attacker.example:${port}/`, origin: () => "null", isSandboxed: true },
  };
  for (const [where, { page, origin, isSandboxed }] of Object.entries(origins)) {
    test(`${where}, reads and changes nothing`, async () => {
      await withLab(LAB, async ({ lab, proxy }) => {
        const calls = callsOn(await readyRobot(lab));
        const [state, memory] = [await stateOf(lab), await peakMemoryMb(lab)];
        const { read, messages, sent } = await attack({ url: page(attacker.port), base: proxy.url, log: proxy.log, calls, isSandboxed });
        assert.deepEqual(learned(read), []);
        assert.deepEqual(learned(sent), []);
        assert.equal(messages, 0);
        assert.deepEqual(changes(proxy.log).filter(({ status }) => status !== 403).map(describeRequest), []);
        const sockets = proxy.log.filter(({ isUpgrade }) => isUpgrade);
        assert.deepEqual(sockets.map(({ status, origin: sent }) => [status, sent]), Array(2).fill([403, origin(attacker.port)]));
        assert.ok(changes(proxy.log).every((one) => one.origin === origin(attacker.port)));
        assert.deepEqual(await stateOf(lab), state);
        const grown = (await peakMemoryMb(lab)) - memory;
        assert.ok(grown < 64, `the server's memory grew by ${grown} MB`);
      });
    });
  }

  test("shows no frame of the dashboard", async () => {
    await withLab(LAB, async ({ lab }) => {
      const context = await browser.newContext();
      const page = await context.newPage();
      await page.goto(`http://attacker.example:${attacker.port}/`);
      const refused = page.waitForEvent("console", (message) => /frame-ancestors/.test(message.text()));
      await page.evaluate((src) => document.body.append(Object.assign(document.createElement("iframe"), { src })), lab.url);
      await refused;
      assert.equal(await page.frames()[1].locator("#arena-stage").count(), 0);
      await context.close();
    });
  });

  test("would read and change everything if its origin were allowed", async () => {
    await withLab(PERMISSIVE, async ({ lab, proxy }) => {
      const calls = callsOn(await readyRobot(lab));
      const state = await stateOf(lab);
      const url = `http://attacker.example:${attacker.port}/`;
      assertEffects(calls, await attack({ url, base: proxy.url, log: proxy.log, calls }), proxy.log);
      assertChanged(state, await stateOf(lab));
    });
  });
});

/**
 * Everything was read, every call had an answer that the page could read, and those that need no other state succeeded.
 * @param {import("./attacks.mjs").Call[]} calls
 * @param {Awaited<ReturnType<typeof attack>>} attempts
 * @param {import("./attacker.mjs").Logged[]} log
 */
function assertEffects(calls, { read, messages, sent }, log) {
  const known = learned(read).filter(({ way }) => way === "cors").map(({ call: name }) => name.slice(4));
  assert.deepEqual(known, READABLE);
  assert.equal(messages, 2);
  const described = sent.filter(({ way, read: text }) => way === "described" && text !== null);
  assert.equal(described.length, calls.length);
  const done = new Set(changes(log).filter(({ status }) => status === 200).map(({ method, path }) => `${method} ${path}`));
  for (const { method, path } of calls.slice(0, SUCCEEDING)) assert.ok(done.has(`${method} ${path}`), `${method} ${path} had no effect`);
}

function assertChanged(before, after) {
  assert.deepEqual([before.recordings, before.recording, before.calibration, before.lens], [[], "idle", "idle", "idle"]);
  assert.ok(after.recordings.some((name) => name.startsWith("stolen")));
  assert.deepEqual([before.cameras, after.cameras], [["door", "simulated"], ["simulated", "intruder"]]);
  assert.equal(after.file.match(/name = "intruder"/g).length, 2);
  assert.doesNotMatch(after.file, /cart/);
}

describe("DNS rebinding", { skip: lacking }, () => {
  const HOST = "rebind.example";
  const run = async (config, body) =>
    withLab(config, async ({ lab, proxy }) => {
      const calls = callsOn(await readyRobot(lab));
      const before = [await stateOf(lab), await peakMemoryMb(lab)];
      const base = `http://${HOST}:${proxy.port}`;
      await body({ lab, proxy, before, calls, attempts: await attack({ url: base + PAGE, base, log: proxy.log, calls }) });
    });

  test("reads and changes nothing: the host is not a name of the server", async () => {
    await run(LAB, async ({ lab, proxy, before: [state, memory], calls, attempts }) => {
      const { read, messages, sent } = attempts;
      // For the browser, page and server have the same origin: no request needs a preflight, and all are readable.
      const arrived = new Set(changes(proxy.log).map(({ method, path }) => `${method} ${path}`));
      assert.deepEqual([...arrived].sort(), calls.map(({ method, path }) => `${method} ${path}`).sort());
      assert.ok(proxy.log.every(({ host }) => host === `${HOST}:${proxy.port}`));
      assert.deepEqual(proxy.log.filter(({ status }) => status !== 421).map(describeRequest), []);
      for (const { call: name, read: text } of learned([...read, ...sent])) assert.match(text, /misdirected/, name);
      assert.equal(messages, 0);
      assert.deepEqual(await stateOf(lab), state);
      const grown = (await peakMemoryMb(lab)) - memory;
      assert.ok(grown < 64, `the server's memory grew by ${grown} MB`);
    });
  });

  test("would read and change everything if every name were allowed", async () => {
    await run(PERMISSIVE.replace('allow_origins = ["*"]', ""), async ({ lab, proxy, before: [state], calls, attempts }) => {
      assertEffects(calls, attempts, proxy.log);
      assertChanged(state, await stateOf(lab));
    });
  });
});

describe("a page beside a signed-in dashboard", { skip: lacking }, () => {
  const sites = {
    "of another site gets no session": { name: "attacker.example", hasCookie: false },
    "of the same site, another port, changes nothing with the session": { name: "127.0.0.1", hasCookie: true },
  };
  for (const [what, { name, hasCookie }] of Object.entries(sites)) {
    test(what, async () => {
      let token = "";
      const prepare = async (folder) => {
        const words = ["token", "add", "alice", "--role", "setup", "--config", join(folder, "lab.toml")];
        token = (await promisify(execFile)(BINARY, words)).stdout.trim();
      };
      const body = async ({ lab, proxy }) => {
        const context = await browser.newContext();
        const signedIn = await context.request.post(`${proxy.url}/api/v1/session`, { data: { token } });
        assert.equal(signedIn.status(), 200);
        const own = await context.request.get(`${proxy.url}/api/v1/configuration`);
        assert.equal(own.status(), 200);
        const [file, calls] = [await lab.config(), callsOn(1)];
        proxy.log.length = 0;
        const url = `http://${name}:${attacker.port}/`;
        const { read, messages, sent } = await attack({ url, base: proxy.url, log: proxy.log, calls, context, credentials: "include" });
        assert.deepEqual([learned(read), learned(sent), messages], [[], [], 0]);
        assert.deepEqual(changes(proxy.log).filter(({ status }) => status !== 403).map(describeRequest), []);
        assert.equal(await lab.config(), file);
        assert.equal(changes(proxy.log).some((one) => one.hasCookie), hasCookie);
        // A request for a picture has no origin.
        const statuses = proxy.log.filter(({ path, origin }) => path === PICTURE && !origin).map(({ status }) => status);
        assert.deepEqual(statuses, [403]);
        await context.close();
      };
      await withLab(LAB, body, { prepare });
    });
  }
});
