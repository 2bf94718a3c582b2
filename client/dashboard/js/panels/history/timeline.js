/** Time line of the last minute: the slider below the arena, and the instant shown. */

import { find, throttle, setAttribute, setText } from "../../base/dom.js";
import { fixed, preciseTimeOfDay } from "../../base/format.js";
import { HISTORY_MS } from "../../state/history.js";

/** The slider's steps, ms. */
const STEP_MS = 100;

/**
 * @param {import("../../state/store.js").Store} store
 * @returns {{step: (ms: number) => void}} moves the shown instant; back if negative
 */
export function showTimeline(store) {
  const slider = /** @type {HTMLInputElement} */ (find("#past"));
  const words = find("#past-words");
  const live = /** @type {HTMLButtonElement} */ (find("#live"));
  slider.min = String(-HISTORY_MS / 1000);
  slider.step = String(STEP_MS / 1000);

  const now = () => store.snapshot?.poseTimeMs ?? 0;
  const show = () => {
    const { pastMs } = store;
    const agoS = pastMs === null ? 0 : Math.max(0, (now() - pastMs) / 1000);
    slider.value = String(-agoS);
    const text = pastMs === null ? "Now" : `${fixed(agoS, 1)} s ago, ${preciseTimeOfDay(pastMs)}`;
    setText(words, text);
    setAttribute(slider, "aria-valuetext", text);
    live.disabled = pastMs === null;
    document.body.classList.toggle("past", pastMs !== null);
    // Shortly after opening, the slider is longer than the history.
    const reachS = Math.min(HISTORY_MS, now() - (store.history.oldestMs ?? now())) / 1000;
    setAttribute(slider, "title", `This page stores the last ${fixed(reachS, 0)} s`);
  };

  slider.addEventListener("input", () => {
    const ago = -Number(slider.value) * 1000;
    store.seekTo(ago < STEP_MS / 2 ? null : now() - ago);
  });
  live.addEventListener("click", () => store.seekTo(null));
  store.on("time", show);
  store.on("snapshot", throttle(250, show));
  show();
  return { step: (ms) => store.seekTo((store.pastMs ?? now()) + ms) };
}
