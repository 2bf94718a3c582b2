/** Form that adds, changes and removes cameras. Errors are shown at their fields. */

import { lookAtOf, orientationOf } from "./look-at.js";
import { callApi } from "../../wire/api-client.js";
import { find, setText } from "../../base/dom.js";
import { sourceTestText } from "./source-test.js";
import { FormErrors } from "../forms/form-errors.js";

/** Fields that can have errors, by their API names. */
const FIELDS = ["name", "source", "calibration", "pose", "rate_hz", "mode"];
/** Values are rounded to three decimals. */
const DECIMALS = 1000;

/** @typedef {{position: {x: number, y: number, z: number} | null, orientation: import("./look-at.js").Quaternion | null}} Pose */
/** @typedef {{unknown?: boolean, pose?: Pose | null, object?: string, localizes?: boolean}} PoseSetup */
/** @typedef {{name: string, source: string, calibration: string, pose: PoseSetup | null, rate_hz: number | null, mode: string}} Setup */

/** @typedef {ReturnType<typeof import("../calibration/lens-calibration.js").showLensCalibration>["open"]} FindLens */

/**
 * @param {FindLens} findLens
 * @returns {{edit: (name: string) => void}} opens the form for a camera
 */
export function showCameraForm(findLens) {
  const form = new CameraForm(findLens);
  find("#add-camera").addEventListener("click", () => form.open(null));
  return { edit: (name) => void form.edit(name) };
}

class CameraForm {
  /** @param {FindLens} findLens */
  constructor(findLens) {
    this.findLens = findLens;
    const dialog = find("#setup");
    if (!(dialog instanceof HTMLDialogElement)) throw new Error("index.html's setup is not a dialog");
    this.dialog = dialog;
    this.form = /** @type {HTMLFormElement} */ (find("#setup-form"));
    this.words = find("#setup-words");
    this.errors = new FormErrors("setup", FIELDS, { pose: "setup-place" });
    this.remove = /** @type {HTMLButtonElement} */ (find("#setup-remove"));
    this.buttons = [...dialog.querySelectorAll("button[data-acts]")].map((it) => /** @type {HTMLButtonElement} */ (it));
    /** @type {Setup | null} the server's version; null for a new camera */
    this.before = null;
    this.poseTouched = false;

    dialog.addEventListener("click", (event) => {
      if (event.target === dialog) dialog.close();
    });
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.save();
    });
    find("#setup-try").addEventListener("click", () => void this.tryIt());
    find("#setup-lens").addEventListener("click", () => this.lens());
    this.remove.addEventListener("click", () => void this.removeIt());
    find("#setup-place").addEventListener("input", () => {
      this.poseTouched = true;
      this.showPlace();
    });
  }

  /** @param {string} name @returns {HTMLInputElement} */
  field(name) {
    return /** @type {HTMLInputElement} */ (find(`#setup-${name}`));
  }

  /** @param {Setup | null} setup */
  open(setup) {
    this.before = setup;
    this.poseTouched = setup === null;
    this.form.reset();
    setText(find("#setup-title"), setup ? `Camera ${setup.name}` : "Add a camera");
    setText(find("#setup-save"), setup ? "Save" : "Add");
    this.remove.hidden = setup === null;
    this.asksBack = false;
    setText(this.remove, "Remove…");
    if (setup) this.fill(setup);
    this.showPlace();
    this.say("");
    this.errors.clear();
    this.dialog.showModal();
    this.field("name").focus();
  }

  /** Opens the form with the camera's configuration. @param {string} name */
  async edit(name) {
    this.open(null);
    setText(find("#setup-title"), `Camera ${name}`);
    const setup = await this.callApi("GET", `cameras/${encodeURIComponent(name)}/setup`);
    if (setup && this.dialog.open) {
      this.dialog.close();
      this.open(setup);
    }
  }

  /** @param {Setup} setup */
  fill(setup) {
    this.field("name").value = setup.name;
    this.field("source").value = setup.source;
    this.field("calibration").value = setup.calibration;
    this.field("rate_hz").value = setup.rate_hz === null ? "" : String(setup.rate_hz);
    this.field("mode").value = setup.mode;
    const { pose } = setup;
    const rides = Boolean(pose?.object);
    this.field("place-rides").disabled = !rides;
    setText(find("#setup-carrier"), rides ? `Mounted on ${pose?.object}` : "Mounted on an object");
    const stands = !rides && pose?.pose?.position && pose.pose.orientation;
    this.field(rides ? "place-rides" : stands ? "place-stands" : pose ? "place-found" : "place-own").checked = true;
    if (!stands) return;
    const { position, target, turnedDeg } = lookAtOf({ position: pose.pose.position, orientation: pose.pose.orientation });
    for (const axis of /** @type {("x" | "y" | "z")[]} */ (["x", "y", "z"])) {
      this.field(`at-${axis}`).value = rounded(position[axis]);
      this.field(`to-${axis}`).value = rounded(target[axis]);
    }
    this.field("turned").value = rounded(turnedDeg);
  }

  /** Shows the fields of the chosen kind of pose. */
  showPlace() {
    find("#setup-aim").hidden = !this.field("place-stands").checked;
  }

  /** Reads the form; null if the pose is invalid. @returns {Setup | null} */
  read() {
    const rate = this.field("rate_hz").value.trim();
    const pose = this.readPose();
    if (pose === undefined) return null;
    return {
      name: this.field("name").value.trim(),
      source: this.field("source").value.trim(),
      calibration: this.field("calibration").value.trim(),
      pose,
      rate_hz: rate === "" ? null : Number(rate),
      mode: this.field("mode").value,
    };
  }

  /** Returns undefined if the pose is invalid. @returns {PoseSetup | null | undefined} */
  readPose() {
    if (!this.poseTouched || this.field("place-rides").checked) return this.before?.pose ?? null;
    if (this.field("place-own").checked) return null;
    if (this.field("place-found").checked) return { unknown: true };
    const numbers = ["at-x", "at-y", "at-z", "to-x", "to-y", "to-z", "turned"].map((name) => this.field(name).value.trim());
    if (numbers.some((it) => it === "" || !Number.isFinite(Number(it)))) {
      this.errors.showError("pose", "Enter all numbers of the pose, in metres and degrees.");
      return undefined;
    }
    const [x, y, z, tx, ty, tz, turnedDeg] = numbers.map(Number);
    const position = { x, y, z };
    const orientation = orientationOf({ position, target: { x: tx, y: ty, z: tz }, turnedDeg });
    if (!orientation) {
      this.errors.showError("pose", "The camera must look at a point other than its own position.");
      return undefined;
    }
    return { pose: { position, orientation } };
  }

  async save() {
    this.errors.clear();
    const wanted = this.read();
    if (!wanted) return;
    const done = this.before
      ? await this.callApi("PATCH", `cameras/${encodeURIComponent(this.before.name)}`, changedFields(this.before, wanted))
      : await this.callApi("POST", "cameras", withoutEmpty(wanted));
    if (done) this.dialog.close();
  }

  async removeIt() {
    if (!this.before) return;
    if (!this.asksBack) {
      this.asksBack = true;
      setText(this.remove, `Remove ${this.before.name}`);
      this.say("This also removes it from the configuration. Press again to confirm.");
      return;
    }
    const done = await this.callApi("DELETE", `cameras/${encodeURIComponent(this.before.name)}`);
    if (done) this.dialog.close();
  }

  async tryIt() {
    this.errors.clear();
    const source = this.field("source").value.trim();
    if (source === "") return this.errors.showError("source", "Enter the source first.");
    this.say("Opening the source. If it does not respond, this takes up to 15 s.");
    const answer = await this.callApi("POST", "sources/test", { source });
    this.say(answer ? sourceTestText(answer) : "");
    if (answer?.error) this.errors.showError("source", answer.error);
  }

  /** Opens lens calibration, with the name of an existing camera or the source of a new one. */
  lens() {
    this.errors.clear();
    const [source, name] = [this.field("source").value.trim(), this.field("name").value.trim()];
    if (this.before) return this.findLens({ camera: this.before.name, source: "", name: "" }, (file) => this.keep(file));
    if (source === "") return this.errors.showError("source", "Enter the source first.");
    this.findLens({ camera: "", source, name }, (file) => this.keep(file));
  }

  /** Uses the file of a finished lens calibration. @param {string} file */
  keep(file) {
    if (!this.dialog.open) return;
    this.field("calibration").value = file;
    if (this.before) this.before = { ...this.before, calibration: file };
  }

  /**
   * Returns the response, or null after showing the error.
   * @param {string} method
   * @param {string} path
   * @param {object} [body]
   * @returns {Promise<any>}
   */
  async callApi(method, path, body) {
    for (const button of this.buttons) button.disabled = true;
    const { answer, error } = await callApi(method, path, body);
    for (const button of this.buttons) button.disabled = false;
    if (error) this.errors.showApiError(error);
    return answer;
  }

  /** @param {string} words */
  say(words) {
    setText(this.words, words);
  }
}

/** Rounds a value; -0 becomes 0. @param {number} value */
function rounded(value) {
  return String(Math.round(value * DECIMALS) / DECIMALS + 0);
}

/** Returns the fields that are not empty. @param {Setup} setup */
export function withoutEmpty(setup) {
  return Object.fromEntries(Object.entries(setup).filter(([, value]) => value !== null && value !== ""));
}

/**
 * Returns the changed fields for a PATCH request: unchanged ones are absent, removed ones null.
 * @param {Setup} before
 * @param {Setup} after
 */
export function changedFields(before, after) {
  /** @type {Record<string, unknown>} */
  const changed = {};
  for (const [key, value] of Object.entries(after)) {
    const old = before[/** @type {keyof Setup} */ (key)] ?? null;
    const wanted = value === "" ? null : value;
    const is = old === "" ? null : old;
    if (JSON.stringify(is) !== JSON.stringify(wanted)) changed[key] = wanted;
  }
  return changed;
}
