/** The newest picture of a lens calibration, with the board's coverage drawn over it. */

import { fetchFile } from "../../wire/api-client.js";
import { find } from "../../base/dom.js";

/** Colours over the picture, for both themes: covered and uncovered zones, views, the current board. */
const DONE = "rgb(40 220 120 / 22%)";
const WANTED = "rgb(255 190 40 / 90%)";
const VIEW = "rgb(40 220 120 / 75%)";
const TAKEN = "rgb(80 255 150)";
const SEEN = "rgb(255 255 255)";

/** @typedef {import("./lens-text.js").Lens} Lens */

/** Zones of the picture, and whether the board has covered them. @param {Lens} it */
export function zonesOf({ coverage, width, height }) {
  const { columns, rows, zones, visited_from: from } = coverage;
  return zones.map((count, i) => ({
    left: ((i % columns) * width) / columns,
    top: (Math.floor(i / columns) * height) / rows,
    width: width / columns,
    height: height / rows,
    isDone: count >= from,
  }));
}

export class LensPreview {
  constructor() {
    this.image = /** @type {HTMLImageElement} */ (find("#lens-picture"));
    this.canvas = /** @type {HTMLCanvasElement} */ (find("#lens-coverage"));
    this.figure = find("#lens-figure");
    this.shown = "";
  }

  /** Requests the picture and draws the coverage over it. @param {Lens} it */
  async show(it) {
    if (it.frames === 0) return this.clear();
    const { answer } = await fetchFile("lens/picture.jpg");
    if (!answer) return;
    const before = this.shown;
    this.shown = URL.createObjectURL(answer);
    this.image.src = this.shown;
    this.figure.hidden = false;
    if (before) URL.revokeObjectURL(before);
    this.draw(it);
  }

  /** @param {Lens} it */
  draw(it) {
    if (this.canvas.width !== it.width || this.canvas.height !== it.height) {
      this.canvas.width = it.width;
      this.canvas.height = it.height;
    }
    const context = this.canvas.getContext("2d");
    if (!context) return;
    // Lines have the same width on the screen for all picture sizes.
    const unit = Math.max(1, it.width / 480);
    context.clearRect(0, 0, it.width, it.height);
    for (const zone of zonesOf(it)) {
      if (zone.isDone) {
        context.fillStyle = DONE;
        context.fillRect(zone.left, zone.top, zone.width, zone.height);
      } else {
        context.strokeStyle = WANTED;
        context.lineWidth = unit;
        context.setLineDash([6 * unit, 5 * unit]);
        context.strokeRect(zone.left + 3 * unit, zone.top + 3 * unit, zone.width - 6 * unit, zone.height - 6 * unit);
        context.setLineDash([]);
      }
    }
    for (const outline of it.outlines) polygon(context, outline, VIEW, unit);
    polygon(context, it.outline, it.newest_taken ? TAKEN : SEEN, 2 * unit);
  }

  clear() {
    this.figure.hidden = true;
    this.image.removeAttribute("src");
    if (this.shown) URL.revokeObjectURL(this.shown);
    this.shown = "";
  }
}

/** @param {CanvasRenderingContext2D} context @param {[number, number][]} corners @param {string} color @param {number} width */
function polygon(context, corners, color, width) {
  if (corners.length === 0) return;
  context.beginPath();
  for (const [u, v] of corners) context.lineTo(u, v);
  context.closePath();
  context.strokeStyle = color;
  context.lineWidth = width;
  context.stroke();
}
