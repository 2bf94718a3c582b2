/** Keyboard shortcuts of the page, and the dialog that lists them. */

import { find } from "../../base/dom.js";

/**
 * @typedef {object} KeyHandlers
 * @property {(mode: "top" | "space" | "health") => void} show
 * @property {(ms: number) => void} step moves the shown instant
 * @property {() => void} live
 * @property {() => void} pause pauses or resumes a replay
 * @property {() => void} fit
 * @property {(step: 1 | -1) => void} selectNext
 * @property {() => void} follow
 * @property {() => void} measure
 * @property {() => void} deselect
 * @property {() => void} theme
 */

/** @param {KeyHandlers} handlers */
export function listenForKeys(handlers) {
  const sheet = /** @type {HTMLDialogElement} */ (find("#help"));
  const help = () => sheet.showModal();
  find("#help-open").addEventListener("click", help);
  sheet.addEventListener("click", (event) => {
    if (event.target === sheet) sheet.close();
  });
  /** @type {Record<string, () => void>} */
  const actions = {
    "?": help,
    "/": () => find("#search").focus(),
    1: () => handlers.show("top"),
    2: () => handlers.show("space"),
    3: () => handlers.show("health"),
    ",": () => handlers.step(-1000),
    ".": () => handlers.step(1000),
    "<": () => handlers.step(-10_000),
    ";": () => handlers.step(-10_000),
    ">": () => handlers.step(10_000),
    ":": () => handlers.step(10_000),
    l: handlers.live,
    " ": handlers.pause,
    0: handlers.fit,
    n: () => handlers.selectNext(1),
    p: () => handlers.selectNext(-1),
    f: handlers.follow,
    m: handlers.measure,
    t: handlers.theme,
    Escape: handlers.deselect,
  };
  document.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented) return;
    // Not while a dialog is open or text is typed.
    if (document.querySelector("dialog[open]") || isTyping(event.target)) return;
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action || (event.key === " " && isPressed(event.target))) return;
    event.preventDefault();
    action();
  });
}

/** @param {EventTarget | null} target */
function isTyping(target) {
  if (!(target instanceof HTMLElement)) return false;
  if (target instanceof HTMLInputElement) return !["checkbox", "radio", "range", "button"].includes(target.type);
  return target instanceof HTMLTextAreaElement || target instanceof HTMLSelectElement || target.isContentEditable;
}

/** Whether the space bar activates the element. @param {EventTarget | null} target */
function isPressed(target) {
  return target instanceof HTMLButtonElement || target instanceof HTMLInputElement || (target instanceof HTMLElement && target.tagName === "SUMMARY");
}
