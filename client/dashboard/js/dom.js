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
 * @param {number} intervalMs
 * @param {() => void} action
 */
export function paced(intervalMs, action) {
  let lastMs = -Infinity;
  let waiting = false;
  return () => {
    if (waiting) return;
    const pauseMs = lastMs + intervalMs - performance.now();
    const run = () => {
      waiting = false;
      lastMs = performance.now();
      action();
    };
    if (pauseMs <= 0) run();
    else {
      waiting = true;
      setTimeout(run, pauseMs);
    }
  };
}
