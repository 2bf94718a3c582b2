/** DOM helpers. */

const SVG = "http://www.w3.org/2000/svg";

/**
 * @param {string} tag
 * @param {Record<string, string>} [attributes]
 * @param {(Node | string)[]} [children]
 * @returns {HTMLElement}
 */
export function element(tag, attributes = {}, children = []) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

/**
 * Returns an element that index.html must have.
 * @param {string} selector
 * @returns {HTMLElement}
 */
export function find(selector) {
  const found = document.querySelector(selector);
  if (!(found instanceof HTMLElement)) throw new Error(`index.html has no element ${selector}`);
  return found;
}

/**
 * Sets a text only if it differs, so that unchanged numbers cause no layout.
 * @param {Element} target
 * @param {string} text
 */
export function setText(target, text) {
  if (target.textContent !== text) target.textContent = text;
}

/**
 * @param {Element} target
 * @param {string} name
 * @param {string} value
 */
export function setAttribute(target, name, value) {
  if (target.getAttribute(name) !== value) target.setAttribute(name, value);
}

/**
 * Symbol of a life stage or camera status, defined in index.html.
 * @param {string} name
 * @returns {SVGElement}
 */
export function glyph(name) {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("class", `glyph glyph-${name}`);
  svg.setAttribute("viewBox", "0 0 16 16");
  svg.setAttribute("aria-hidden", "true");
  const use = document.createElementNS(SVG, "use");
  use.setAttribute("href", `#glyph-${name}`);
  svg.append(use);
  return svg;
}

/**
 * Calls `action` at most once per `intervalMs`, and once more after the last request, so that a table ends on the newest
 * values.
 * @param {number | (() => number)} intervalMs
 * @param {() => void} action
 * @param {{alone?: boolean}} [how] alone: the action is slow and gets an animation frame to itself
 */
export function throttle(intervalMs, action, { alone = false } = {}) {
  let lastMs = -Infinity;
  let waiting = false;
  const run = () => {
    waiting = false;
    lastMs = performance.now();
    action();
  };
  return () => {
    if (waiting) return;
    waiting = true;
    const pauseMs = lastMs + (typeof intervalMs === "number" ? intervalMs : intervalMs()) - performance.now();
    const due = alone ? () => inOwnFrame(run) : () => soon(run);
    if (pauseMs <= 0) due();
    else setTimeout(due, pauseMs);
  };
}

/** Due actions. Quick ones run together, each slow one in its own animation frame. */
const turns = {
  /** @type {(() => void)[]} */
  quick: [],
  /** @type {Set<() => void>} */
  slow: new Set(),
  wasQuick: false,
};
let isRequested = false;

/** Runs in the next animation frame, or the one after it. @param {() => void} action */
function soon(action) {
  turns.quick.push(action);
  requestTurn();
}

/** Runs alone in one of the next animation frames; once if it is requested again before. @param {() => void} action */
export function inOwnFrame(action) {
  turns.slow.add(action);
  requestTurn();
}

function requestTurn() {
  if (isRequested) return;
  isRequested = true;
  requestAnimationFrame(takeTurn);
}

/** Slow actions get every second frame at least: on a slow computer, each frame has quick ones. */
function takeTurn() {
  isRequested = false;
  const { quick, slow } = turns;
  const [oldest] = slow;
  const takesSlow = oldest !== undefined && (quick.length === 0 || turns.wasQuick);
  const actions = takesSlow ? [oldest] : quick.splice(0);
  if (takesSlow) slow.delete(oldest);
  turns.wasQuick = !takesSlow;
  if (quick.length > 0 || slow.size > 0) requestTurn();
  for (const action of actions) action();
}
