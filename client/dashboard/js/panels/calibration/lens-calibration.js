/** Dialog of the lens calibration: the user moves the board in front of the camera, and the page shows coverage and missing views. */

import { callApi } from "../../wire/api-client.js";
import { findDialog } from "../forms/dialog.js";
import { element, find, setText } from "../../base/dom.js";
import { LensPreview } from "./lens-preview.js";
import { canFinish, isRunning, missingText, parameterCells, progressOf, reportText, sentence, sizeOf, stageText, subjectOf } from "./lens-text.js";
import { FormErrors } from "../forms/form-errors.js";

/** Polling interval while it runs, ms. */
const LOOK_MS = 300;
/** Pause after a failed request, ms. */
const RETRY_MS = 2000;

/** Fields of the form, with their conversion for the request. @type {Record<string, (text: string) => string | number>} */
const FIELDS = { board: String, marker: number, pitch: number, code: String, views: number, model: String };

/** @typedef {import("./lens-text.js").Lens} Lens */
/** @typedef {{camera: string, source: string, name: string}} Subject either camera or source is empty */

/** Text that is not a number is sent unchanged, so that the server's error says what it expects. @param {string} text */
function number(text) {
  const value = Number(text.replace(",", "."));
  return Number.isFinite(value) ? value : text;
}

/** @returns {{open: (subject: Subject, kept?: (file: string) => void) => void}} */
export function showLensCalibration() {
  const dialog = new LensDialog();
  return { open: (subject, kept) => dialog.open(subject, kept) };
}

class LensDialog {
  constructor() {
    this.dialog = findDialog("#lens");
    this.form = /** @type {HTMLFormElement} */ (find("#lens-form"));
    this.bar = /** @type {HTMLProgressElement} */ (find("#lens-bar"));
    this.size = /** @type {HTMLInputElement} */ (find("#lens-size"));
    this.missing = find("#lens-missing");
    this.results = find("#lens-results");
    this.view = new LensPreview();
    this.errors = new FormErrors("lens", [...Object.keys(FIELDS), "size"]);
    this.buttons = Object.fromEntries(
      ["finish", "cancel", "apply"].map((name) => [name, /** @type {HTMLButtonElement} */ (find(`#lens-${name}`))]),
    );
    /** @type {Subject} */
    this.subject = { camera: "", source: "", name: "" };
    /** @type {(file: string) => void} */
    this.kept = () => {};
    this.timer = 0;
    this.drawn = "";

    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.start();
    });
    this.buttons.finish.addEventListener("click", () => void this.act("PUT", "lens/finished"));
    this.buttons.cancel.addEventListener("click", () => void this.act("DELETE", "lens"));
    this.buttons.apply.addEventListener("click", () => void this.act("PUT", "lens/applied"));
    this.dialog.addEventListener("close", () => {
      clearTimeout(this.timer);
      this.view.clear();
    });
  }

  /** @param {Subject} subject @param {(file: string) => void} [kept] receives the name of the saved file */
  open(subject, kept = () => {}) {
    this.subject = subject;
    this.kept = kept;
    this.drawn = "";
    setText(find("#lens-title"), `Lens of ${subject.camera || subject.name || subject.source}`);
    // A configured camera has the size of its lens file.
    find("#lens-size-label").hidden = subject.source === "";
    this.dialog.showModal();
    void this.act("GET", "lens");
  }

  async start() {
    const text = this.subject.source && this.size.value.trim();
    const size = sizeOf(text);
    if (text && !size) {
      this.errors.clear();
      this.errors.showError("size", `Expected columns × rows, such as 1920x1080, found ${text}.`);
      return;
    }
    await this.act("POST", "lens", { ...this.request(), ...size });
  }

  /** Request from the form. Empty fields use the server's defaults. */
  request() {
    /** @type {Record<string, unknown>} */
    const request = {};
    for (const [name, value] of Object.entries(this.subject)) if (value !== "") request[name] = value;
    for (const [name, read] of Object.entries(FIELDS)) {
      const text = /** @type {HTMLInputElement} */ (find(`#lens-${name}`)).value.trim();
      if (text !== "") request[name] = read(text);
    }
    return request;
  }

  /** @param {string} method @param {string} path @param {object} [body] */
  async act(method, path, body) {
    clearTimeout(this.timer);
    this.errors.clear();
    const { answer, error } = await callApi(method, path, body);
    if (!this.dialog.open) return;
    if (error) {
      const isOfSize = error.field === "width" || error.field === "height";
      this.errors.showApiError(isOfSize ? { ...error, field: "size" } : error);
      // A running calibration continues.
      if (method !== "GET" || error.status === 0) this.again(RETRY_MS);
      return;
    }
    if (path === "lens/applied") this.kept(answer.applied);
    await this.follow(answer);
  }

  /** @param {number} ms */
  again(ms) {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => void this.look(), ms);
  }

  /** Polls the state, and keeps the errors shown. */
  async look() {
    const { answer, error } = await callApi("GET", "lens");
    if (!this.dialog.open) return;
    if (error) this.again(RETRY_MS);
    else await this.follow(answer);
  }

  /** Shows the state, and polls again while the calibration runs. @param {Lens} it */
  async follow(it) {
    this.fill(it);
    if (isRunning(it) || this.isDone(it)) await this.view.show(it);
    else this.view.clear();
    if (!this.dialog.open) this.view.clear();
    else if (isRunning(it)) this.again(LOOK_MS);
  }

  /** Whether the calibration for this dialog's subject is finished. @param {Lens} it */
  isDone(it) {
    return it.stage === "done" && this.isMine(it);
  }

  /** @param {Lens} it */
  isMine(it) {
    return subjectOf(it) === (this.subject.camera || this.subject.source);
  }

  /** @param {Lens} it */
  fill(it) {
    const mine = this.isMine(it);
    const runs = isRunning(it);
    this.form.hidden = runs;
    this.bar.hidden = !runs;
    this.buttons.cancel.hidden = !runs;
    this.buttons.finish.hidden = !canFinish(it);
    const isDone = this.isDone(it);
    this.buttons.apply.hidden = !(isDone && it.can_apply && it.applied === "");
    setText(this.buttons.apply, it.camera ? `Apply to ${it.camera}` : "Save next to the configuration");
    find("#lens-file").hidden = !isDone;
    if (it.stage === "gathering") this.bar.value = progressOf(it);
    else this.bar.removeAttribute("value");
    // The result of another camera is not shown here, but while its calibration runs this one has to wait.
    const shown = mine || runs ? it : { ...it, stage: /** @type {"idle"} */ ("idle"), error: "" };
    const whose = runs && !mine ? `The lens of ${subjectOf(it)} is being calibrated. Only one calibration can run at a time. ` : "";
    setText(find("#lens-words"), whose + stageText(shown));
    const error = find("#lens-error");
    error.hidden = shown.error === "";
    setText(error, shown.error && sentence(shown.error));
    this.list(missingText(shown));
    this.showReport(isDone ? it.report : null);
    setText(find("#lens-start"), isDone || shown.stage === "failed" ? "Start again" : "Start");
  }

  /** @param {string[]} missing */
  list(missing) {
    const sign = missing.join("\n");
    if (sign === this.drawn) return;
    this.drawn = sign;
    find("#lens-wanted").hidden = missing.length === 0;
    this.missing.replaceChildren(...missing.map((words) => element("li", {}, [words])));
  }

  /** @param {import("./lens-text.js").Report | null} report */
  showReport(report) {
    this.results.hidden = report === null;
    if (!report) return;
    const rows = report.parameters.map((it) =>
      element("tr", {}, [element("th", { scope: "row" }, [it.name]), ...parameterCells(it).map((cell) => element("td", {}, [cell]))]),
    );
    this.results.replaceChildren(
      element("table", {}, [element("caption", {}, [reportText(report)]), element("tbody", {}, rows)]),
    );
  }
}
