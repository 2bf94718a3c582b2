/** Switches the main view: arena from above, arena in 3D, or health. */

import { find } from "../../base/dom.js";

/** @typedef {"top" | "space" | "health"} Mode */

const KEY = "roundel-view";

/** @param {import("../../arena/arena.js").Arena} arena */
export function showViewSwitch(arena) {
  const inputs = /** @type {NodeListOf<HTMLInputElement>} */ (document.querySelectorAll("input[name=mode]"));
  const panel = /** @type {HTMLElement} */ (find("#arena-stage").parentElement);
  const health = find("#health");
  /** @type {Mode} */
  let shown = "top";
  let onHealth = () => {};

  /** @param {Mode} wanted */
  const show = async (wanted) => {
    shown = wanted;
    panel.dataset.shows = wanted;
    health.hidden = wanted !== "health";
    if (wanted === "health") onHealth();
    // Without WebGL this falls back to the view from above.
    else shown = await arena.show(wanted);
    for (const input of inputs) input.checked = input.value === shown;
    write(wanted);
  };

  for (const input of inputs) input.addEventListener("change", () => void show(/** @type {Mode} */ (input.value)));
  const kept = read();
  if (kept === "space" || kept === "health") void show(kept);
  else for (const input of inputs) input.checked = input.value === "top";
  return {
    /** @param {Mode} wanted */
    show: (wanted) => void show(wanted),
    shown: () => shown,
    /** @param {() => void} listener */
    onHealth: (listener) => {
      onHealth = listener;
      if (shown === "health") listener();
    },
  };
}

// If storage is forbidden, the choice lasts as long as the page.
function read() {
  try {
    return localStorage.getItem(KEY);
  } catch {
    return null;
  }
}

/** @param {Mode} mode */
function write(mode) {
  try {
    localStorage.setItem(KEY, mode);
  } catch {
    // The choice is not stored.
  }
}
