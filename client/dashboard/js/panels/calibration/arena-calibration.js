/** Dialog of the arena calibration: instructions, progress and report. */

import { element, find, setText } from "../../base/dom.js";
import { fixed, whole } from "../../base/format.js";
import { request } from "../../wire/api-client.js";

/** Polling interval during a calibration, ms. */
const LOOK_MS = 400;

/** @typedef {{camera: string, frames: number, codes: number, coverage: number, together: {camera: string}[]}} Recorded */
/** @typedef {{camera: string, moved_m: number | null, turned_rad: number | null, position_deviation_m: number, rotation_deviation_rad: number, reprojection_px: number, error_ratio: number, coverage: number}} Calibrated */
/** @typedef {{cameras: Calibrated[], findings: {message: string, grave: boolean}[], sightings: number, roundels: number, solve_s: number, sound: boolean}} Report */
/** @typedef {{stage: string, seconds: number, recorded_s: number, recorded: Recorded[], steps: number, error: string, report: Report | null, applied_version: number, version: number}} Calibration */

/** @param {import("../../state/store.js").Store} store */
export function showArenaCalibration(store) {
  const dialog = find("#calibration");
  if (!(dialog instanceof HTMLDialogElement)) throw new Error("index.html's calibration is not a dialog");
  const form = /** @type {HTMLFormElement} */ (find("#calibration-form"));
  const seconds = /** @type {HTMLInputElement} */ (find("#calibration-seconds"));
  const lenses = /** @type {HTMLInputElement} */ (find("#calibration-lenses"));
  const bar = /** @type {HTMLProgressElement} */ (find("#calibration-bar"));
  const [start, cancel, apply] = ["#calibration-start", "#calibration-cancel", "#calibration-apply"].map((id) =>
    /** @type {HTMLButtonElement} */ (find(id)),
  );
  const words = find("#calibration-words");
  const trouble = find("#calibration-trouble");
  const results = find("#calibration-results");
  let timer = 0;

  find("#calibrate").addEventListener("click", () => {
    dialog.showModal();
    void look();
  });
  dialog.addEventListener("click", (event) => {
    if (event.target === dialog) dialog.close();
  });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const body = JSON.stringify({ seconds: Number(seconds.value), refine_lenses: lenses.checked });
    void callApi("POST", "", body);
  });
  cancel.addEventListener("click", () => void callApi("DELETE"));
  apply.addEventListener("click", () => void callApi("PUT", "/applied"));
  // Another client may have started a calibration.
  store.on("events", () => {
    if (dialog.open && timer === 0) void look();
  });

  const look = () => callApi("GET");

  /**
   * @param {string} method
   * @param {string} [path]
   * @param {string} [body]
   */
  async function callApi(method, path = "", body) {
    clearTimeout(timer);
    timer = 0;
    try {
      const headers = body === undefined ? undefined : { "content-type": "application/json" };
      const response = await request(`calibration${path}`, { method, headers, body });
      const answer = await response.json();
      if (!response.ok) say(answer?.error?.message ?? `The server responded with status ${response.status}.`);
      else show(answer);
    } catch {
      say("No response from the server. Retrying automatically.");
      timer = setTimeout(() => void look(), LOOK_MS * 5);
    }
  }

  /** @param {string} text */
  function say(text) {
    setText(trouble, text);
    trouble.hidden = text === "";
  }

  /** @param {Calibration} it */
  function show(it) {
    const isRecording = it.stage === "recording";
    const isRunning = isRecording || it.stage === "solving";
    form.hidden = isRunning;
    bar.hidden = !isRunning;
    cancel.hidden = !isRunning;
    // Without a value the bar is indeterminate.
    if (isRecording) bar.value = it.recorded_s / Math.max(it.seconds, 1e-3);
    else bar.removeAttribute("value");
    setText(words, stageText(it));
    say(it.error ? sentence(it.error) : "");
    const canApply = it.report !== null && it.applied_version === 0;
    apply.hidden = !canApply;
    setText(start, it.report || it.error ? "Calibrate again" : "Start");
    if (it.report) results.replaceChildren(...reportOf(it.report));
    else results.replaceChildren(...(it.recorded.length > 0 ? [recordedTable(it.recorded)] : []));
    if (isRunning && dialog.open) timer = setTimeout(() => void look(), LOOK_MS);
  }
}

/** @param {string} text */
function sentence(text) {
  return `${text.charAt(0).toUpperCase()}${text.slice(1)}`.replace(/([^.!?])$/, "$1.");
}

/** @param {Calibration} it */
function stageText(it) {
  const inUse = it.version > 0 ? `Version ${it.version} is in use.` : "The cameras use their configured poses.";
  switch (it.stage) {
    case "recording":
      return `Recording, ${fixed(it.recorded_s, 0)} of ${fixed(it.seconds, 0)} s. Drive robots through the areas where views overlap.`;
    case "solving":
      return `Calculating, step ${it.steps}. The robots can stop.`;
    case "done":
      return it.applied_version > 0
        ? `Finished. Applied as version ${it.applied_version}.`
        : "Finished, but not applied. Check the findings first.";
    case "failed":
      return `No result. ${inUse}`;
    default:
      return inUse;
  }
}

/** @param {Recorded[]} cameras */
function recordedTable(cameras) {
  const rows = cameras.map((camera) => ({
    name: camera.camera,
    isBad: camera.together.length === 0,
    cells: [
      whole(camera.frames),
      whole(camera.codes),
      percent(camera.coverage),
      camera.together.map((other) => other.camera).join(", ") || "none yet",
    ],
  }));
  return table("Recorded so far", ["Camera", "Frames", "Codes", "Image covered", "Shares codes with"], rows);
}

/** @param {Report} report */
function reportOf(report) {
  const rows = report.cameras.map((camera) => ({
    name: camera.camera,
    isBad: camera.error_ratio > 3,
    cells: [
      camera.moved_m === null
        ? "was unknown"
        : `${fixed(camera.moved_m * 1000, 1)} mm, ${angle(camera.turned_rad)}`,
      `${fixed(camera.position_deviation_m * 1000, 2)} mm, ${angle(camera.rotation_deviation_rad)}`,
      fixed(camera.reprojection_px, 2),
      fixed(camera.error_ratio, 2),
      percent(camera.coverage),
    ],
  }));
  const titles = ["Camera", "Moved by", "Accuracy (1 σ)", "Error px", "Error ratio", "Image covered"];
  const findings = report.findings.map(({ message, grave }) =>
    element("li", { class: grave ? "grave" : "" }, [grave ? element("strong", {}, ["Severe: "]) : "", sentence(message)]),
  );
  const summary = `${report.sightings} sightings of ${report.roundels} roundels, solved in ${fixed(report.solve_s, 1)} s.`;
  const list = findings.length > 0 ? element("ul", { class: "findings" }, findings) : element("p", {}, ["No findings."]);
  return [table(summary, titles, rows), list];
}

/** Formats a small angle. @param {number | null} rad */
function angle(rad) {
  return `${fixed(((rad ?? 0) * 180) / Math.PI, 4)}°`;
}

/** @param {number} share */
function percent(share) {
  return `${fixed(share * 100, 0)} %`;
}

/**
 * @param {string} caption
 * @param {string[]} titles
 * @param {{name: string, isBad: boolean, cells: string[]}[]} rows
 */
function table(caption, titles, rows) {
  const head = titles.map((title) => element("th", { scope: "col" }, [title]));
  const lines = rows.map(({ name, isBad, cells }) =>
    element("tr", isBad ? { class: "bad" } : {}, [
      element("th", { scope: "row" }, [name]),
      ...cells.map((cell) => element("td", {}, [cell])),
    ]),
  );
  return element("table", {}, [
    element("caption", {}, [caption]),
    element("thead", {}, [element("tr", {}, head)]),
    element("tbody", {}, lines),
  ]);
}
