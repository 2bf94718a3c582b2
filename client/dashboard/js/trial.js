/** Tries a camera's source before it is configured: what it gives, or why nothing comes. */

import { find, setText } from "./dom.js";
import { fixed, whole } from "./format.js";

/** @typedef {{error: string, width: number, height: number, frames: number, broken: number, rate_hz: number, promised_rate_hz: number, roundels: number, decode_ms: number, detect_ms: number}} Trial */

export function showTrial() {
  const dialog = find("#trial");
  if (!(dialog instanceof HTMLDialogElement)) throw new Error("index.html's trial is no dialog");
  const form = /** @type {HTMLFormElement} */ (find("#trial-form"));
  const source = /** @type {HTMLInputElement} */ (find("#trial-source"));
  const start = /** @type {HTMLButtonElement} */ (find("#trial-start"));
  const words = find("#trial-words");
  const trouble = find("#trial-trouble");

  find("#try-source").addEventListener("click", () => {
    say("", "");
    dialog.showModal();
  });
  dialog.addEventListener("click", (event) => {
    if (event.target === dialog) dialog.close();
  });
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    void ask();
  });

  async function ask() {
    start.disabled = true;
    say("Opening it. A camera that does not answer takes up to 15 s.", "");
    try {
      const response = await fetch("api/v1/sources/test", {
        method: "POST",
        headers: { "content-type": "application/json" },
        body: JSON.stringify({ source: source.value.trim() }),
        cache: "no-store",
      });
      const answer = await response.json();
      if (response.ok) say(trialWords(answer), answer.error);
      else say("", answer?.error?.message ?? `The server answers with ${response.status}.`);
    } catch {
      say("", "No answer from the server. Try again.");
    }
    start.disabled = false;
  }

  /**
   * @param {string} told
   * @param {string} wrong
   */
  function say(told, wrong) {
    setText(words, told);
    setText(trouble, wrong);
    trouble.hidden = wrong === "";
    source.setAttribute("aria-invalid", String(wrong !== ""));
  }
}

/** What came, in a sentence or two; empty if nothing did. @param {Trial} it */
export function trialWords(it) {
  if (!(it.frames > 0)) return "";
  const rate = it.rate_hz > 0 ? `${fixed(it.rate_hz, 1)} frames a second` : "one frame";
  const promised = it.promised_rate_hz > 0 ? ` (${fixed(it.promised_rate_hz, 1)} promised)` : "";
  const broken = it.broken > 0 ? ` ${whole(it.broken)} came broken.` : "";
  const roundels = it.roundels === 1 ? "one roundel" : `${whole(it.roundels)} roundels`;
  return `${whole(it.width)} × ${whole(it.height)} pixels, ${rate}${promised}; ${roundels} in the newest frame.${broken} Decoding takes ${fixed(it.decode_ms, 1)} ms, searching ${fixed(it.detect_ms, 1)} ms.`;
}
