/** Health of all cameras: summary, problems, latency, and a table of figures. */

import { element, find, glyph, throttle, setAttribute, setText } from "../../base/dom.js";
import { fixed, whole } from "../../base/format.js";
import { cameraProblems, groupProblems, healthSummary } from "../../state/camera-health.js";
import { request } from "../../wire/api-client.js";
import { makePrintSizes } from "./print-sizes.js";

const INTERVAL_MS = 500;
/** Interval of requests for what the server does not push: sizes of prints and the calibration's report. */
const REQUEST_INTERVAL_MS = 5000;
/** Bars of the latency histogram. */
const STEPS = 24;

/** @typedef {import("../../wire/messages.js").Camera} Camera */
/** @typedef {import("../../state/camera-health.js").Problem} Problem */
/** @typedef {{camera: Camera, problems: Problem[], shares: import("../../state/camera-health.js").Shares | null}} CameraHealth */

/** @type {{key: string, name: string, title: string, value: (health: CameraHealth, reprojectionPx: Map<string, number>) => string}[]} */
const COLUMNS = [
  {
    key: "rate",
    name: "Rate Hz",
    title: "Frames processed per second, and the promised rate",
    value: ({ camera }) => fixed(camera.rateHz, 1) + (camera.promisedRateHz > 0 ? ` of ${fixed(camera.promisedRateHz, 0)}` : ""),
  },
  { key: "latency", name: "Latency ms", title: "From capture to fusion, median", value: ({ camera }) => fixed(camera.latencyMs, 0) },
  {
    key: "dropped",
    name: "Dropped",
    title: "Frames dropped in the last ten seconds; in brackets since the start",
    value: ({ camera, shares }) => `${percent(shares?.dropped)} (${whole(camera.dropped)})`,
  },
  {
    key: "broken",
    name: "Broken",
    title: "Frames that arrived broken in the last ten seconds; in brackets since the start",
    value: ({ camera, shares }) => `${percent(shares?.broken)} (${whole(camera.broken)})`,
  },
  {
    key: "clock",
    name: "Clock ms",
    title: "Delay of its clock against the other cameras ± standard deviation; capture times are corrected by it",
    value: ({ camera: { clock } }) => (clock ? `${fixed(clock.offsetMs, 1)} ± ${fixed(clock.deviationMs, 2)}` : "in sync"),
  },
  {
    key: "reprojection",
    name: "Reproj. px",
    title: "Rms reprojection error against the other cameras in the last eight seconds; in brackets that of the newest arena calibration",
    value: ({ camera }, reprojectionPx) => {
      const calibrated = reprojectionPx.get(camera.name);
      return fixed(camera.reprojectionPx, 2) + (calibrated === undefined ? "" : ` (${fixed(calibrated, 2)})`);
    },
  },
  {
    key: "off",
    name: "Pose error",
    title: "Pose correction with which it agrees best with the other cameras, over about a minute",
    value: ({ camera: { agreement } }) =>
      agreement && agreement.state !== "alone"
        ? `${fixed(agreement.positionErrorM * 1000, 1)} mm, ${fixed((agreement.rotationErrorRad * 180) / Math.PI, 3)}°`
        : "–",
  },
  { key: "detect", name: "Detect ms", title: "Time to detect the roundels in a frame, median", value: ({ camera }) => fixed(camera.detectMs, 2) },
  {
    key: "budget",
    name: "Budget",
    title: "Share of a frame's time budget that detection takes, median; in brackets roundels that were located without the precise fit since the start",
    value: ({ camera }) => (camera.budgetUsed > 0 ? percent(camera.budgetUsed) : "–") + (camera.deferred > 0 ? ` (${whole(camera.deferred)})` : ""),
  },
  { key: "blur", name: "Blur px", title: "Estimated from the edges of its roundels", value: ({ camera }) => fixed(camera.blurPx, 2) },
];

/** @param {number | undefined} share */
function percent(share) {
  return share === undefined ? "–" : `${fixed(share * 100, 0)} %`;
}

/**
 * Cameras with severe problems first, then those with other problems.
 * @param {import("../../state/store.js").Store} store
 * @returns {CameraHealth[]}
 */
function camerasByHealth(store) {
  const all = store.cameras.map((camera) => {
    const shares = store.frameCounters.shares(camera.name);
    return { camera, shares, problems: cameraProblems(camera, shares) };
  });
  const rank = (/** @type {CameraHealth} */ { problems }) => (problems.length === 0 ? 0 : problems[0].isSevere ? 2 : 1);
  return all.sort((a, b) => rank(b) - rank(a));
}

/**
 * @param {import("../../state/store.js").Store} store
 * @param {{open: () => void, isOpen: () => boolean}} view
 */
export function showHealthPanel(store, { open, isOpen }) {
  const button = find("#verdict");
  const words = find("#verdict-text");
  const list = find("#unwell");
  const rows = find("#health-rows");
  const figures = { rate: find("#health-rate"), late: find("#health-late"), missed: find("#health-missed") };
  const bars = makeBars(find("#health-bars"));
  const loadPrintSizes = makePrintSizes();
  /** @type {Map<string, number>} of the newest calibration, by camera */
  let reprojectionPx = new Map();
  find("#health-head").replaceChildren(
    element("th", { scope: "col" }, ["Camera"]),
    element("th", { scope: "col" }, ["Problem"]),
    ...COLUMNS.map(({ name, title }) => element("th", { scope: "col", title }, [name])),
  );

  const loadCalibration = async () => {
    try {
      const answer = await (await request("calibration")).json();
      /** @type {{camera: string, reprojection_px: number}[]} */
      const cameras = answer.report?.cameras ?? [];
      reprojectionPx = new Map(cameras.map((one) => [one.camera, one.reprojection_px]));
      update();
    } catch {
      // The next request fills the column.
    }
  };
  const load = () => {
    void loadPrintSizes();
    void loadCalibration();
  };
  const loadSoon = throttle(REQUEST_INTERVAL_MS, load, { alone: true });

  const update = () => {
    const all = camerasByHealth(store);
    const ill = all.filter(({ problems }) => problems.length > 0);
    setText(words, store.camerasKnown ? healthSummary(all) : "–");
    setAttribute(button, "data-health", ill.some(({ problems }) => problems[0].isSevere) ? "grave" : ill.length > 0 ? "ill" : "well");
    showUnwell(list, ill);
    if (!isOpen()) return;
    const [p50, p95, p99] = store.latencies.quantiles([0.5, 0.95, 0.99]);
    setText(figures.rate, `${fixed(store.report.rateHz, 1)} of ${fixed(store.info?.snapshotRateHz, 0)} Hz`);
    setText(figures.late, `${fixed(p50, 0)} / ${fixed(p95, 0)} / ${fixed(p99, 0)} ms`);
    setText(figures.missed, whole(store.report.missed));
    bars(store.latencies.histogram(STEPS));
    fillTable(rows, all, reprojectionPx);
    loadSoon();
  };

  button.addEventListener("click", open);
  list.addEventListener("click", (event) => {
    const name = event.target instanceof Element ? event.target.closest("button")?.dataset.camera : undefined;
    const card = [...document.querySelectorAll("[data-camera-card]")].find((one) => one.getAttribute("data-camera-card") === name);
    card?.scrollIntoView({ block: "nearest", behavior: "smooth" });
    /** @type {HTMLElement | null | undefined} */ (card?.querySelector("button"))?.focus();
  });
  const updateSoon = throttle(INTERVAL_MS, update, { alone: true });
  store.on("cameras", updateSoon);
  store.on("connection", updateSoon);
  store.on("events", throttle(2000, () => store.events[0]?.kind.startsWith("calibration_") && void loadCalibration()));
  update();
  return { opened: load };
}

/** Lists the problems; cameras with the same problem share an entry. @param {HTMLElement} list @param {CameraHealth[]} ill */
function showUnwell(list, ill) {
  list.hidden = ill.length === 0;
  const reasons = groupProblems(ill.map(({ camera, problems }) => ({ name: camera.name, problems })));
  while (list.children.length > reasons.length) list.lastElementChild?.remove();
  for (const [i, { names, why, isSevere }] of reasons.entries()) {
    const item = /** @type {HTMLElement | undefined} */ (list.children[i]) ?? list.appendChild(element("li"));
    setAttribute(item, "class", isSevere ? "grave" : "");
    // While the set of cameras is the same, only the text changes, so that a focused button keeps its focus.
    if (item.dataset.names !== names.join()) {
      item.dataset.names = names.join();
      const buttons = names.map((name) => element("button", { type: "button", "data-camera": name }, [name]));
      item.replaceChildren(...buttons.flatMap((button) => [button, " "]), element("span"));
    }
    setText(/** @type {Element} */ (item.lastElementChild), why);
  }
}

/** @param {HTMLElement} body @param {CameraHealth[]} all @param {Map<string, number>} reprojectionPx */
function fillTable(body, all, reprojectionPx) {
  while (body.children.length > all.length) body.lastElementChild?.remove();
  while (body.children.length < all.length) {
    body.append(element("tr", {}, [element("th", { scope: "row" }), element("td", { class: "why" }), ...COLUMNS.map(({ key }) => element("td", { "data-figure": key }))]));
  }
  for (const [i, health] of all.entries()) {
    const row = body.children[i];
    const { camera, problems } = health;
    const state = problems.length === 0 ? "well" : problems[0].isSevere ? "grave" : "ill";
    if (row.getAttribute("data-health") !== state || row.getAttribute("data-name") !== camera.name) {
      row.setAttribute("data-health", state);
      row.setAttribute("data-name", camera.name);
      row.children[0].replaceChildren(glyph(state === "well" ? "running" : "failed"), ` ${camera.name}`);
    }
    for (const [k, { value }] of COLUMNS.entries()) setText(row.children[k + 2], value(health, reprojectionPx));
    setText(row.children[1], problems.map((one) => one.why).join(" ") || "OK");
  }
}

/** @param {HTMLElement} target @returns {(histogram: {stepMs: number, shares: number[]}) => void} */
function makeBars(target) {
  const bars = Array.from({ length: STEPS }, () => element("span"));
  target.append(...bars);
  const caption = find("#health-bars-caption");
  return ({ stepMs, shares }) => {
    const most = Math.max(...shares, 1e-9);
    for (const [i, share] of shares.entries()) {
      // Set by script: the page's security policy forbids style attributes in markup.
      bars[i].style.height = `${(share / most) * 100}%`;
      bars[i].title = `${i * stepMs} ms${i + 1 < STEPS ? ` to ${(i + 1) * stepMs} ms` : " and later"}: ${fixed(share * 100, 1)} %`;
    }
    setText(caption, `Latency of the snapshots in the last minute: bars of ${stepMs} ms from 0 to ${(STEPS - 1) * stepMs} ms; the last bar holds all later ones`);
  };
}
