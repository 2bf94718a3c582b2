/**
 * What objects are called, beside them. Each label is painted once and then copied, since outlined text is the dearest
 * thing on the page; where they would lie on one another, the selected one comes first and the others give way.
 */

import { fixed } from "./format.js";

/** Objects higher than this carry their height, metres; a robot's roundel is mostly below. */
const FLYING_M = 0.5;
/** Up to so many objects all labels are drawn, even on one another: few enough to be told apart. */
const ALWAYS_DRAWN = 40;
/** Cells of the raster that tells whether a place is taken, CSS pixels. */
const CELL_PX = 11;
const PADDING_PX = 3;
/** Labels kept painted; heights change all the time. */
const MOST_KEPT = 4000;

/** @typedef {import("./palette.js").Palette} Palette */
/** @typedef {{state: import("./state.js").ObjectState, px: number, py: number}} Label where its text begins, middle of its line */
/** @typedef {{canvas: HTMLCanvasElement, width: number, height: number}} Painted */

/** @type {Map<string, Painted>} */
const painted = new Map();
/** What the kept ones were painted for. */
let paintedFor = "";

/**
 * @param {CanvasRenderingContext2D} context in CSS pixels
 * @param {Palette} palette
 * @param {Label[]} labels
 * @param {{selected: number | null, hovered: number | null}} options
 */
export function drawLabels(context, palette, labels, options) {
  const ratio = devicePixelRatio || 1;
  const look = `${palette.ink} ${palette.sheet} ${ratio}`;
  if (look !== paintedFor || painted.size > MOST_KEPT) {
    painted.clear();
    paintedFor = look;
  }
  const isMarked = (/** @type {Label} */ { state }) => state.id === options.selected || state.id === options.hovered;
  const isCrowded = labels.length > ALWAYS_DRAWN;
  const order = isCrowded ? [...labels.filter(isMarked), ...labels.filter((label) => !isMarked(label))] : labels;
  /** @type {Set<number>} */
  const taken = new Set();
  for (const label of order) {
    const { state } = label;
    const z = state.positionM?.z ?? 0;
    const height = z > FLYING_M ? `\u2191\u2009${fixed(z, 1)} m` : "";
    const picture = paint(state.label, isCrowded && !isMarked(label) ? "" : height, state.id === options.selected, palette, ratio);
    if (isCrowded && !claims(taken, label, picture) && !isMarked(label)) continue;
    context.drawImage(picture.canvas, label.px - PADDING_PX, label.py - 8 - PADDING_PX, picture.width, picture.height);
  }
}

/** Takes a label's place, if nobody has it. @param {Set<number>} taken @param {Label} label @param {Painted} picture */
function claims(taken, label, picture) {
  const cells = [];
  const row = Math.floor(label.py / CELL_PX);
  const last = Math.floor((label.px + picture.width - 2 * PADDING_PX) / CELL_PX);
  for (let column = Math.floor(label.px / CELL_PX); column <= last; column += 1) cells.push(row * 4096 + column);
  if (cells.some((cell) => taken.has(cell))) return false;
  for (const cell of cells) taken.add(cell);
  return true;
}

/**
 * @param {string} name
 * @param {string} height
 * @param {boolean} isSelected
 * @param {Palette} palette
 * @param {number} ratio of the screen's pixels to CSS pixels
 * @returns {Painted}
 */
function paint(name, height, isSelected, palette, ratio) {
  const key = `${isSelected ? "*" : ""}${name}\n${height}`;
  const known = painted.get(key);
  if (known) return known;
  const canvas = document.createElement("canvas");
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  const fonts = [`600 11.5px ${palette.font}`, `10.5px ${palette.font}`];
  const widths = [name, height].map((text, i) => {
    context.font = fonts[i];
    return text ? context.measureText(text).width : 0;
  });
  const width = Math.ceil(Math.max(...widths)) + 2 * PADDING_PX;
  const tall = (height ? 29 : 16) + 2 * PADDING_PX;
  canvas.width = Math.ceil(width * ratio);
  canvas.height = Math.ceil(tall * ratio);
  context.scale(ratio, ratio);
  context.lineJoin = "round";
  context.lineWidth = 3.5;
  context.strokeStyle = palette.sheet;
  context.textBaseline = "middle";
  for (const [i, text] of [name, height].entries()) {
    if (!text) continue;
    context.font = fonts[i];
    context.fillStyle = i === 1 ? palette.inkSoft : isSelected ? palette.accent : palette.ink;
    context.strokeText(text, PADDING_PX, PADDING_PX + 8 + 12.5 * i);
    context.fillText(text, PADDING_PX, PADDING_PX + 8 + 12.5 * i);
  }
  const made = { canvas, width: canvas.width / ratio, height: canvas.height / ratio };
  painted.set(key, made);
  return made;
}
