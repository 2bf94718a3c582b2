/** Starts and stops recordings, shows their state, and lists the files. */

import { callApi } from "../../wire/api-client.js";
import { findDialog } from "../forms/dialog.js";
import { element, find, setAttribute, setText } from "../../base/dom.js";
import { dateAndTime, duration, minutes, size, whole } from "../../base/format.js";
import { FormErrors } from "../forms/form-errors.js";
import { milliseconds } from "../../base/validate.js";

/** Polling intervals with the dialog open, and with it closed during a recording, ms. */
const LOOK_MS = 1000;
const LOOK_CLOSED_MS = 5000;
/** Length of a recording from which its data rate is shown, s. */
const RATE_S = 3;

/** @typedef {{state: string, file: string, folder: string, seconds: number, bytes: number, files: number, messages: number, dropped: number, disk_free_bytes: number, budget_bytes: number, deleted: number, error: string, frames_every: number}} Recording */

/** @param {import("../../state/store.js").Store} store */
export function showRecording(store) {
  const view = new RecordingPanel(store);
  store.on("info", () => void view.look());
  // Another client may start or stop a recording, or it may end automatically.
  let newest = 0;
  store.on("events", () => {
    const latest = store.events.find(({ kind }) => kind.startsWith("recording_"))?.timeMs ?? 0;
    if (latest === newest) return;
    newest = latest;
    void view.look();
  });
}

class RecordingPanel {
  /** @param {import("../../state/store.js").Store} store */
  constructor(store) {
    this.store = store;
    this.dialog = findDialog("#recording");
    this.button = find("#record");
    this.buttonText = find("#record-text");
    this.form = /** @type {HTMLFormElement} */ (find("#recording-form"));
    this.stop = /** @type {HTMLButtonElement} */ (find("#recording-stop"));
    this.words = find("#recording-words");
    this.list = find("#recording-files");
    this.errors = new FormErrors("recording", ["name", "frames_every", "seconds"]);
    this.timer = 0;
    /** @type {Recording | null} */
    this.known = null;
    this.knownAtMs = 0;
    this.filesShown = "";

    this.button.addEventListener("click", () => {
      this.errors.clear();
      this.dialog.showModal();
      void this.look();
    });
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.start();
    });
    this.stop.addEventListener("click", () => void this.act("DELETE"));
    setInterval(() => this.showButton(), 500);
  }

  /** @param {string} name */
  field(name) {
    return /** @type {HTMLInputElement} */ (find(`#recording-${name}`));
  }

  async start() {
    /** @type {Record<string, unknown>} */
    const wanted = { name: this.field("name").value.trim() };
    for (const [field, words] of [["frames_every", "Enter a whole number."], ["seconds", "Enter a number of seconds above 0."]]) {
      const input = this.field(field);
      // The browser returns an empty value for invalid numbers.
      if (input.validity.badInput) {
        this.errors.clear();
        return this.errors.showError(field, words);
      }
      if (input.value !== "") wanted[field] = Number(input.value);
    }
    await this.act("POST", wanted);
  }

  /** @param {string} method @param {object} [body] */
  async act(method, body) {
    this.errors.clear();
    const { answer, error } = await callApi(method, "recording", body);
    if (error) this.errors.showApiError(error);
    else this.show(answer);
    await this.look();
  }

  async look() {
    clearTimeout(this.timer);
    if (!this.store.info?.records) return;
    const { answer } = await callApi("GET", "recording");
    if (answer) this.show(answer);
    if (this.dialog.open) await this.listFiles();
    clearTimeout(this.timer);
    const pauseMs = this.dialog.open ? LOOK_MS : this.known?.state === "recording" ? LOOK_CLOSED_MS : null;
    if (pauseMs !== null) this.timer = setTimeout(() => void this.look(), pauseMs);
  }

  /** @param {Recording} it */
  show(it) {
    this.known = it;
    this.knownAtMs = performance.now();
    const isRecording = it.state === "recording";
    this.form.hidden = isRecording;
    this.stop.hidden = !isRecording;
    this.words.replaceChildren(...stateText(it).map((words) => element("p", {}, [words])));
    this.words.classList.toggle("trouble", it.state === "failed" || it.dropped > 0);
    this.showButton();
  }

  /** Shows the recording's state in the page's header. */
  showButton() {
    const { known } = this;
    const isRecording = known?.state === "recording";
    setAttribute(this.button, "data-state", known?.state ?? "idle");
    if (!known || !isRecording) {
      setText(this.buttonText, known?.state === "failed" ? "Recording failed" : "Record…");
      return;
    }
    setText(this.buttonText, `Recording ${minutes(known.seconds + (performance.now() - this.knownAtMs) / 1000)}`);
  }

  async listFiles() {
    const { answer } = await callApi("GET", "recordings");
    if (!answer) return;
    const look = JSON.stringify(answer);
    if (look === this.filesShown) return;
    this.filesShown = look;
    const rows = [...answer.files].reverse().map((/** @type {any} */ file) => {
      const startedMs = milliseconds(file.started_time_ns);
      return element("tr", {}, [
        element("th", { scope: "row" }, [file.name]),
        element("td", {}, [startedMs ? dateAndTime(startedMs) : "–"]),
        element("td", {}, [file.open ? `${size(Number(file.bytes))}, being written` : size(Number(file.bytes))]),
      ]);
    });
    const none = rows.length === 0;
    this.list.hidden = none;
    find("#recording-rows").replaceChildren(...rows);
    setText(find("#recording-where"), none ? `No recordings in ${answer.folder} yet.` : `In ${answer.folder} on the server. To replay one: roundel replay FILE`);
  }
}

/** Describes the state in sentences. @param {Recording} it */
export function stateText(it) {
  const [bytes, free, budget] = [Number(it.bytes), Number(it.disk_free_bytes), Number(it.budget_bytes)];
  // The server measures the free space only during a recording.
  const space = free > 0 ? `${size(free)} free on the disk` : "Free disk space is shown during a recording";
  const kept = budget > 0 ? ` The oldest recordings are deleted when all exceed ${size(budget)}.` : "";
  const words = [];
  if (it.state === "recording") {
    const rate = it.seconds > RATE_S ? bytes / it.seconds : 0;
    const lasts = rate > 0 ? `, ${size(rate)}/s; ${space}, enough for ${duration((free / rate) * 1000)}.` : `; ${space}.`;
    const pictures = it.frames_every > 0 ? (it.frames_every === 1 ? ", every frame as a picture" : `, one in ${it.frames_every} frames as a picture`) : "";
    words.push(`Recording into ${it.file}${pictures}.`, `${minutes(it.seconds)} so far: ${size(bytes)}${lasts}${kept}`);
  } else {
    if (it.state === "failed") words.push(`The last recording failed: ${it.error}`);
    if (it.state === "stopped") words.push(`The last recording, ${it.file}, is ${minutes(it.seconds)} long: ${size(bytes)}.`);
    words.push(`${space}.${kept}`);
  }
  if (it.dropped > 0) words.push(`${whole(Number(it.dropped))} messages are missing because the disk was too slow.`);
  if (it.deleted > 0) words.push(`${whole(it.deleted)} older files were deleted to free disk space.`);
  return words;
}
