/**
 * Labels of objects. Each label is painted once and then copied, since outlined text is slow to draw. Among overlapping
 * labels, the selected one has priority and the others are omitted.
 */

import { fixed } from "../../base/format.js";
import { makeCanvas } from "./canvas-layer.js";

/** Height from which a label includes the height, metres; roundels on robots are mostly lower. */
const FLYING_M = 0.5;
/** Up to this number of objects all labels are drawn, even if they overlap. */
const ALWAYS_DRAWN = 40;
/** Size of the cells that detect overlaps, CSS pixels. */
const CELL_PX = 11;
/** Number of columns and rows of cells: enough for 5632 by 2816 CSS pixels. */
const COLUMNS = 512;
const ROWS = 256;
/** Largest number of labels drawn with many objects. */
const MOST_DRAWN = 160;
const PADDING_PX = 3;
/** Size of the cache of painted labels; heights change often. */
const MOST_KEPT = 4000;

/** @typedef {import("../palette.js").Palette} Palette */
/** @typedef {{state: import("../../state/object-state.js").ObjectState, px: number, py: number}} Label where its text begins, middle of its line */
/** @typedef {{canvas: OffscreenCanvas | HTMLCanvasElement, width: number, height: number}} Painted */

/** @type {Map<string, Painted>} */
const painted = new Map();
const taken = new Uint8Array(COLUMNS * ROWS);
/** Colours and pixel ratio of the cached labels. */
let paintedFor = "";

/**
 * @param {import("./canvas-layer.js").Context2D} context in CSS pixels
 * @param {Palette} palette
 * @param {Label[]} labels
 * @param {{selected: number | null, hovered: number | null}} options
 * @param {number} ratio of the screen's pixels to CSS pixels
 */
export function drawLabels(context, palette, labels, options, ratio) {
  const look = `${palette.ink} ${palette.sheet} ${ratio}`;
  if (look !== paintedFor || painted.size > MOST_KEPT) {
    painted.clear();
    paintedFor = look;
  }
  const isMarked = (/** @type {Label} */ { state }) => state.id === options.selected || state.id === options.hovered;
  const isCrowded = labels.length > ALWAYS_DRAWN;
  const order = isCrowded ? [...labels.filter(isMarked), ...labels.filter((label) => !isMarked(label))] : labels;
  taken.fill(0);
  let drawn = 0;
  for (const label of order) {
    const { state } = label;
    const isChosen = isMarked(label);
    if (isCrowded && !isChosen && drawn >= MOST_DRAWN) break;
    const z = state.positionM?.z ?? 0;
    const height = z > FLYING_M && (!isCrowded || isChosen) ? `\u2191\u2009${fixed(z, 1)} m` : "";
    const picture = paint(state.label, height, state.id === options.selected, palette, ratio);
    if (isCrowded && !claims(label, picture) && !isChosen) continue;
    drawn += 1;
    // At whole pixels, copying is fast and text is sharp.
    const left = Math.round((label.px - PADDING_PX) * ratio) / ratio;
    const top = Math.round((label.py - 8 - PADDING_PX) * ratio) / ratio;
    context.drawImage(picture.canvas, left, top, picture.width, picture.height);
  }
}

/** Reserves a label's cells, unless they are taken. @param {Label} label @param {Painted} picture */
function claims(label, picture) {
  const row = Math.floor(label.py / CELL_PX);
  const first = Math.max(0, Math.floor(label.px / CELL_PX));
  const last = Math.min(COLUMNS - 1, Math.floor((label.px + picture.width - 2 * PADDING_PX) / CELL_PX));
  if (row < 0 || row >= ROWS) return false;
  for (let column = first; column <= last; column += 1) if (taken[row * COLUMNS + column]) return false;
  for (let column = first; column <= last; column += 1) taken[row * COLUMNS + column] = 1;
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
  const fonts = [`600 11.5px ${palette.font}`, `10.5px ${palette.font}`];
  const widths = [name, height].map((text, i) => (text ? widthOf(text, fonts[i]) : 0));
  const width = Math.ceil(Math.max(...widths)) + 2 * PADDING_PX;
  const tall = (height ? 29 : 16) + 2 * PADDING_PX;
  const { canvas, context } = makeCanvas(Math.ceil(width * ratio), Math.ceil(tall * ratio));
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

/** @type {import("./canvas-layer.js").Context2D | null} */
let ruler = null;

/** @param {string} text @param {string} font */
function widthOf(text, font) {
  ruler ??= makeCanvas(1, 1).context;
  ruler.font = font;
  return ruler.measureText(text).width;
}
