/** Small helpers for building and changing the page. */

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
 * An element that the page cannot do without.
 * @param {string} selector
 * @returns {HTMLElement}
 */
export function find(selector) {
  const found = document.querySelector(selector);
  if (!(found instanceof HTMLElement)) throw new Error(`index.html has no element ${selector}`);
  return found;
}

/**
 * Writes a text only where it differs: unchanged numbers then cost no layout.
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
 * The sign of a life stage or of a camera's status, drawn in index.html once.
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
 * Calls at most once per `intervalMs`, and always once more after the last request: tables need not
 * change with each of thirty snapshots a second, but have to end on the newest.
 * @param {number | (() => number)} intervalMs
 * @param {() => void} action
 * @param {{alone?: boolean}} [how] alone: it takes its time, and has a frame of the screen for itself
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

/** What is due: the quick ones together, each of the others in a frame of its own. @type {{quick: (() => void)[], slow: (() => void)[]}} */
const turns = { quick: [], slow: [] };
let isAsked = false;

/** Calls in the next frame of the screen. @param {() => void} action */
function soon(action) {
  turns.quick.push(action);
  requestTurn();
}

/** Calls in one of the next frames of the screen, which it has for itself. @param {() => void} action */
export function inOwnFrame(action) {
  turns.slow.push(action);
  requestTurn();
}

function requestTurn() {
  if (isAsked) return;
  isAsked = true;
  requestAnimationFrame(takeTurn);
}

function takeTurn() {
  isAsked = false;
  const { quick, slow } = turns;
  const actions = quick.length > 0 ? quick.splice(0) : slow.splice(0, 1);
  if (slow.length > 0) requestTurn();
  for (const action of actions) action();
}
