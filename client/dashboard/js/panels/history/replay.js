/** Controls of a replay: pause, position, speed and loop. */

import { callApi } from "../../wire/api-client.js";
import { find, setAttribute, setText } from "../../base/dom.js";
import { minutes, preciseTimeOfDay } from "../../base/format.js";
import { milliseconds } from "../../base/validate.js";

/** Polling interval, ms. Other clients can control the replay, too. */
const LOOK_MS = 500;
/** Interval between two seeks while the slider is dragged, ms. */
const SEEK_MS = 150;

/** @typedef {{file: string, paused: boolean, speed: number, looping: boolean, position_s: number, duration_s: number, begin_time_ns: string, ended: boolean, damage: string}} Replay */

/**
 * @param {import("../../state/store.js").Store} store
 * @returns {{togglePause: () => void}}
 */
export function showReplay(store) {
  const view = new ReplayPanel(store);
  store.on("info", () => void view.look());
  return { togglePause: () => view.togglePause() };
}

class ReplayPanel {
  /** @param {import("../../state/store.js").Store} store */
  constructor(store) {
    this.store = store;
    this.bar = find("#replay");
    this.pause = /** @type {HTMLButtonElement} */ (find("#replay-pause"));
    this.slider = /** @type {HTMLInputElement} */ (find("#replay-position"));
    this.time = find("#replay-time");
    this.speed = /** @type {HTMLSelectElement} */ (find("#replay-speed"));
    this.loop = /** @type {HTMLInputElement} */ (find("#replay-loop"));
    this.trouble = find("#replay-trouble");
    /** @type {Replay | null} */
    this.known = null;
    this.knownAtMs = 0;
    this.timer = 0;
    /** True from the start of a drag until the server has reached the position. */
    this.isSeeking = false;
    this.seekTimer = 0;

    this.pause.addEventListener("click", () => this.togglePause());
    this.speed.addEventListener("change", () => void this.control({ speed: Number(this.speed.value) }));
    this.loop.addEventListener("change", () => void this.control({ looping: this.loop.checked }));
    this.slider.addEventListener("input", () => {
      this.isSeeking = true;
      this.showTime(Number(this.slider.value));
      this.seekTimer ||= setTimeout(() => void this.seek(), SEEK_MS);
    });
    this.slider.addEventListener("change", () => void this.seek());
    store.on("snapshot", () => this.showPosition());
  }

  togglePause() {
    // The key has no effect while the button is not offered.
    if (!this.known || this.pause.hidden) return;
    // At the end, start over.
    void this.control(this.known.ended ? { position_s: 0, paused: false } : { paused: !this.known.paused });
  }

  async seek() {
    clearTimeout(this.seekTimer);
    this.seekTimer = 0;
    const wanted = this.slider.value;
    await this.control({ position_s: Math.min(Number(wanted), this.known?.duration_s ?? 0) });
    if (this.slider.value === wanted) this.isSeeking = false;
  }

  /** @param {object} wish */
  async control(wish) {
    this.take(await callApi("PATCH", "replay", wish));
  }

  async look() {
    clearTimeout(this.timer);
    const isPlaying = this.store.info?.replays === true;
    document.body.classList.toggle("replayed", isPlaying);
    if (!isPlaying) {
      this.store.setReplay(null);
      this.known = null;
      return;
    }
    if (document.visibilityState === "visible") this.take(await callApi("GET", "replay"));
    clearTimeout(this.timer);
    this.timer = setTimeout(() => void this.look(), LOOK_MS);
  }

  /** @param {import("../../wire/api-client.js").Reply} reply */
  take({ answer, error }) {
    // The page shows a lost connection elsewhere.
    setText(this.trouble, error && error.status > 0 ? error.message : (answer?.damage ?? ""));
    this.trouble.hidden = this.trouble.textContent === "";
    if (!answer) return;
    this.known = answer;
    this.knownAtMs = performance.now();
    this.store.setReplay({ paused: answer.paused, ended: answer.ended });
    this.show(answer);
  }

  /** @param {Replay} it */
  show(it) {
    setText(find("#replay-file"), it.file.split(/[\\/]/).at(-1) ?? "");
    setAttribute(find("#replay-file"), "title", it.file);
    setText(this.pause, it.ended ? "Play again" : it.paused ? "Play" : "Pause");
    this.slider.max = String(it.duration_s);
    if (document.activeElement !== this.speed) this.showSpeed(it.speed);
    this.loop.checked = it.looping;
    this.showPosition();
  }

  /** Another client may have chosen a speed that is not in the list. @param {number} speed */
  showSpeed(speed) {
    const options = [...this.speed.options];
    const own = options.find((option) => option.dataset.own === "");
    if (!options.some((option) => Number(option.value) === speed)) {
      const option = own ?? new Option();
      option.dataset.own = "";
      option.value = String(speed);
      option.text = `${speed}×`;
      if (!own) this.speed.append(option);
    } else if (own && Number(own.value) !== speed) own.remove();
    this.speed.value = String(speed);
  }

  /** Extrapolates the position between two polls. */
  showPosition() {
    const { known } = this;
    if (!known || this.isSeeking) return;
    const isMoving = !known.paused && !known.ended;
    const passedS = isMoving ? ((performance.now() - this.knownAtMs) / 1000) * known.speed : 0;
    const atS = Math.min(known.duration_s, known.position_s + passedS);
    const text = String(Math.round(atS * 10) / 10);
    if (this.slider.value !== text) this.slider.value = text;
    this.showTime(atS);
  }

  /** @param {number} atS */
  showTime(atS) {
    const { known } = this;
    if (!known) return;
    const beginMs = milliseconds(known.begin_time_ns);
    const clock = beginMs ? `, ${preciseTimeOfDay(beginMs + atS * 1000)}` : "";
    const text = `${minutes(atS)} of ${minutes(known.duration_s)}${clock}`;
    setText(this.time, text);
    setAttribute(this.slider, "aria-valuetext", text);
  }
}
