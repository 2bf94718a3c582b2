/**
 * Measures the distance between two floor points or objects, or to the pointer while only the start is set. Ends
 * at objects move with them.
 */

import { fixed } from "../../base/format.js";
import { drawOutlinedText } from "../canvas/outlined-text.js";

/** @typedef {import("../viewport.js").Viewport} Viewport */
/** @typedef {import("../../state/track.js").Track} Track */
/** @typedef {{x: number, y: number, z: number | null}} Place metres; z is known only for objects */
/** @typedef {{id: number} | {id: null, x: number, y: number}} End */
/** Smaller height differences are not shown, metres. */
const LEVEL_M = 0.01;
/** Half the length of the bar across either end, CSS pixels. */
const TICK_PX = 5;

export class TapeMeasure {
  constructor() {
    this.isOut = false;
    /** @type {End[]} none, one or both */
    this.ends = [];
    /** @type {[number, number] | null} world, metres */
    this.pointer = null;
  }

  /** Turns it on or off. It starts at the selected object, if there is one. @param {boolean} isOut @param {number | null} selected */
  take(isOut, selected) {
    this.isOut = isOut;
    this.ends = isOut && selected !== null ? [{ id: selected }] : [];
  }

  /** Handles a click, which sets the start, the end, or a new start. @param {End} end */
  set(end) {
    this.ends = this.ends.length === 1 ? [this.ends[0], end] : [end];
  }

  /** Sets the end to the object that was just selected. @param {number | null} id */
  reach(id) {
    if (!this.isOut || id === null) return;
    const [begin] = this.ends;
    this.ends = begin && begin.id !== id ? [begin, { id }] : [{ id }];
  }

  /** @param {Map<number, Track>} tracks @returns {[Place, Place] | null} null unless both ends are known */
  places(tracks) {
    const [begin, end] = this.ends.map((one) => placeOf(one, tracks));
    const { pointer } = this;
    const until = this.ends.length > 1 ? end : pointer && { x: pointer[0], y: pointer[1], z: null };
    return this.isOut && begin && until ? [begin, until] : null;
  }

  /** Text for the caption; empty while it is off. @param {Map<number, Track>} tracks */
  words(tracks) {
    if (!this.isOut) return "";
    if (this.ends.length === 0) return "Measure: click the start point";
    const between = this.places(tracks);
    const [from, to] = [this.ends[0], this.ends[1]].map((end) => end && nameOf(end, tracks));
    if (!between) return `Measure: from ${from} to …`;
    return `${from} to ${to ?? "pointer"}: ${distanceText(between)}`;
  }
}

/** @param {[Place, Place]} places */
export function distanceText([from, to]) {
  const level = Math.hypot(to.x - from.x, to.y - from.y);
  const rise = from.z === null || to.z === null ? 0 : to.z - from.z;
  if (Math.abs(rise) < LEVEL_M) return `${fixed(level, 3)} m`;
  return `${fixed(Math.hypot(level, rise), 3)} m (${fixed(level, 3)} m horizontal)`;
}

/** @param {End} end @param {Map<number, Track>} tracks @returns {Place | null} null if the object is gone */
function placeOf(end, tracks) {
  return end.id === null ? { x: end.x, y: end.y, z: null } : (tracks.get(end.id)?.state.positionM ?? null);
}

/** @param {End} end @param {Map<number, Track>} tracks */
function nameOf(end, tracks) {
  if (end.id === null) return `(${fixed(end.x, 2)}, ${fixed(end.y, 2)})`;
  return tracks.get(end.id)?.state.label ?? `object ${end.id} (gone)`;
}

/**
 * @param {import("../canvas/canvas-layer.js").Context2D} context in CSS pixels
 * @param {Viewport} view
 * @param {import("../palette.js").Palette} palette
 * @param {[Place, Place]} places
 */
export function drawTape(context, view, palette, places) {
  const [[ax, ay], [bx, by]] = places.map(({ x, y }) => [view.screenX(x), view.screenY(y)]);
  const length = Math.hypot(bx - ax, by - ay) || 1;
  const [nx, ny] = [(-(by - ay) / length) * TICK_PX, ((bx - ax) / length) * TICK_PX];
  context.beginPath();
  context.moveTo(ax, ay);
  context.lineTo(bx, by);
  for (const [x, y] of [[ax, ay], [bx, by]]) {
    context.moveTo(x - nx, y - ny);
    context.lineTo(x + nx, y + ny);
  }
  context.strokeStyle = palette.accent;
  context.lineWidth = 2;
  context.stroke();
  context.font = `600 12px ${palette.font}`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  drawOutlinedText(context, palette, distanceText(places), (ax + bx) / 2, (ay + by) / 2 - 12, palette.accent, 4);
}
