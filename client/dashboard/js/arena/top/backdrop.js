/**
 * Static part of the view from above: grid, rulers, world axes, fixed cameras and their footprints.
 * It has its own canvas, which is redrawn only when the view or a camera changes. Mounted cameras
 * are drawn by the same code, on the canvas of the objects.
 */

import { footprint, roundStep, rotate } from "../../base/geometry.js";
import { drawOutlinedText } from "../canvas/outlined-text.js";
import { drawOverlay } from "../history-overlay.js";

/** Width of the left ruler and height of the lower one, CSS pixels. */
export const RULER = { left: 38, bottom: 22 };

/** @typedef {import("../viewport.js").Viewport} Viewport */
/** @typedef {import("../palette.js").Palette} Palette */
/** @typedef {import("../../wire/messages.js").Camera} Camera */

/**
 * @param {import("../canvas/canvas-layer.js").Context2D} context in CSS pixels
 * @param {Viewport} view
 * @param {Palette} palette
 * @param {Camera[]} cameras
 * @param {import("../../state/trajectories.js").HistoryOverlay | null} overlay
 */
export function drawBackdrop(context, view, palette, cameras, overlay) {
  context.fillStyle = palette.sheet;
  context.fillRect(0, 0, view.width, view.height);
  const stepM = gridStepM(view);
  drawGrid(context, view, palette, stepM);
  for (const camera of cameras) drawFootprint(context, view, palette, camera);
  drawAxes(context, view, palette, stepM);
  if (overlay) drawOverlay(context, view, palette, overlay);
  for (const camera of cameras) drawCamera(context, view, palette, camera);
  drawRulers(context, view, palette, stepM);
}

/**
 * Draws mounted cameras with their footprints.
 * @param {import("../canvas/canvas-layer.js").Context2D} context in CSS pixels
 * @param {Viewport} view
 * @param {Palette} palette
 * @param {Camera[]} cameras
 */
export function drawCameras(context, view, palette, cameras) {
  for (const camera of cameras) drawFootprint(context, view, palette, camera);
  for (const camera of cameras) drawCamera(context, view, palette, camera);
}

/** Distance between grid lines: at most about 70 pixels. @param {Viewport} view */
export function gridStepM(view) {
  return roundStep(90 / view.scale);
}

/**
 * A camera's footprint; empty while its pose or lens is unknown.
 * @param {Camera} camera
 */
export function cameraFootprint(camera) {
  if (!camera.pose || !camera.intrinsics || !camera.width || !camera.height) return [];
  return footprint(camera.pose, camera.intrinsics, camera);
}

/**
 * Visits each multiple of the step in [from, to], without accumulating rounding errors.
 * @param {number} from
 * @param {number} to
 * @param {number} step
 * @param {(value: number) => void} visit
 */
function eachStep(from, to, step, visit) {
  for (let i = Math.ceil(from / step); i * step <= to; i += 1) visit(i * step);
}

/**
 * @param {import("../canvas/canvas-layer.js").Context2D} context
 * @param {Viewport} view
 * @param {Palette} palette
 * @param {number} stepM
 */
function drawGrid(context, view, palette, stepM) {
  const [left, right] = [view.worldX(0), view.worldX(view.width)];
  const [low, high] = [view.worldY(view.height), view.worldY(0)];
  for (const [step, color] of /** @type {[number, string][]} */ ([
    [stepM / 5, palette.gridMinor],
    [stepM, palette.gridMajor],
  ])) {
    context.beginPath();
    eachStep(left, right, step, (x) => {
      const px = Math.round(view.screenX(x)) + 0.5;
      context.moveTo(px, 0);
      context.lineTo(px, view.height);
    });
    eachStep(low, high, step, (y) => {
      const py = Math.round(view.screenY(y)) + 0.5;
      context.moveTo(0, py);
      context.lineTo(view.width, py);
    });
    context.strokeStyle = color;
    context.lineWidth = 1;
    context.stroke();
  }
}

/**
 * Draws the world's x and y axes at the origin, one grid step long.
 * @param {import("../canvas/canvas-layer.js").Context2D} context
 * @param {Viewport} view
 * @param {Palette} palette
 * @param {number} stepM
 */
function drawAxes(context, view, palette, stepM) {
  const [ox, oy] = [view.screenX(0), view.screenY(0)];
  const length = stepM * view.scale;
  context.lineWidth = 1.5;
  context.font = `italic 600 12px ${palette.font}`;
  context.textAlign = "left";
  context.textBaseline = "middle";
  for (const [dx, dy, color, letter] of /** @type {[number, number, string, string][]} */ ([
    [1, 0, palette.axisX, "x"],
    [0, -1, palette.axisY, "y"],
  ])) {
    const [ex, ey] = [ox + dx * length, oy + dy * length];
    context.strokeStyle = color;
    context.fillStyle = color;
    context.beginPath();
    context.moveTo(ox, oy);
    context.lineTo(ex, ey);
    context.stroke();
    context.beginPath();
    context.moveTo(ex + dx * 7, ey + dy * 7);
    context.lineTo(ex - dy * 3.5, ey + dx * 3.5);
    context.lineTo(ex + dy * 3.5, ey - dx * 3.5);
    context.fill();
    context.fillText(letter, ex + dx * 7 + 5, ey + dy * 7 + (dx ? 0 : 2));
  }
}

/**
 * @param {import("../canvas/canvas-layer.js").Context2D} context
 * @param {Viewport} view
 * @param {Palette} palette
 * @param {Camera} camera
 */
function drawFootprint(context, view, palette, camera) {
  const outline = cameraFootprint(camera);
  if (outline.length === 0) return;
  context.beginPath();
  for (const [i, point] of outline.entries()) {
    const [px, py] = [view.screenX(point.x), view.screenY(point.y)];
    if (i === 0) context.moveTo(px, py);
    else context.lineTo(px, py);
  }
  context.closePath();
  const failed = camera.status === "failed";
  if (!failed) {
    // Translucent fills make overlapping views darker.
    context.fillStyle = palette.viewFill;
    context.fill();
  }
  context.strokeStyle = failed ? palette.failed : palette.view;
  context.lineWidth = 1;
  context.setLineDash(failed ? [2, 5] : [7, 4]);
  context.stroke();
  context.setLineDash([]);
}

/**
 * Draws a camera as a body with a lens in its viewing direction.
 * @param {import("../canvas/canvas-layer.js").Context2D} context
 * @param {Viewport} view
 * @param {Palette} palette
 * @param {Camera} camera
 */
function drawCamera(context, view, palette, camera) {
  if (!camera.pose) return;
  const { position, orientation } = camera.pose;
  const forward = rotate(orientation, { x: 0, y: 0, z: 1 });
  // A camera that looks straight down has no horizontal direction; the top of its image is used.
  const level = Math.hypot(forward.x, forward.y) > 0.05;
  const pointing = level ? forward : rotate(orientation, { x: 0, y: -1, z: 0 });
  const [px, py] = [view.screenX(position.x), view.screenY(position.y)];
  const color = camera.status === "failed" ? palette.failed : palette.inkSoft;
  context.save();
  context.translate(px, py);
  context.rotate(Math.atan2(-pointing.y, pointing.x));
  context.fillStyle = palette.sheet;
  context.strokeStyle = color;
  context.lineWidth = 1.5;
  context.beginPath();
  context.rect(-8, -5, 11, 10);
  context.moveTo(3, -2);
  context.lineTo(8, -5);
  context.lineTo(8, 5);
  context.lineTo(3, 2);
  context.fill();
  context.stroke();
  context.restore();

  const note = camera.status === "failed" ? `${camera.name} – failed` : camera.name;
  context.font = `11px ${palette.font}`;
  context.textAlign = "center";
  context.textBaseline = "top";
  drawOutlinedText(context, palette, note, px, py + 12, color);
}

/**
 * Draws rulers in metres along the left and the lower edge.
 * @param {import("../canvas/canvas-layer.js").Context2D} context
 * @param {Viewport} view
 * @param {Palette} palette
 * @param {number} stepM
 */
function drawRulers(context, view, palette, stepM) {
  const bottom = view.height - RULER.bottom;
  context.fillStyle = palette.sheet;
  context.fillRect(0, bottom, view.width, RULER.bottom);
  context.fillRect(0, 0, RULER.left, view.height);
  context.strokeStyle = palette.gridMajor;
  context.lineWidth = 1;
  context.beginPath();
  context.moveTo(RULER.left - 0.5, 0);
  context.lineTo(RULER.left - 0.5, bottom + 0.5);
  context.lineTo(view.width, bottom + 0.5);

  const decimals = Math.max(0, -Math.floor(Math.log10(stepM) + 1e-9));
  const label = (/** @type {number} */ value) =>
    (value < -1e-9 ? "\u2212" : "") + Math.abs(value).toFixed(decimals);
  context.font = `10.5px ${palette.font}`;
  context.fillStyle = palette.inkSoft;
  context.textAlign = "center";
  context.textBaseline = "middle";
  eachStep(view.worldX(RULER.left + 12), view.worldX(view.width - 30), stepM, (x) => {
    const px = Math.round(view.screenX(x)) + 0.5;
    context.moveTo(px, bottom);
    context.lineTo(px, bottom + 5);
    context.fillText(label(x), px, bottom + 13);
  });
  context.textAlign = "right";
  eachStep(view.worldY(bottom - 8), view.worldY(12), stepM, (y) => {
    const py = Math.round(view.screenY(y)) + 0.5;
    context.moveTo(RULER.left - 5, py);
    context.lineTo(RULER.left, py);
    context.fillText(label(y), RULER.left - 8, py);
  });
  context.stroke();
  context.fillText("m", view.width - 10, bottom + 13);
}
