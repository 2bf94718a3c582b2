/**
 * Draws objects with their trails, velocities, headings, heights and error ellipses, and mounted cameras.
 */

import { drawCameras, RULER } from "./backdrop.js";
import { FRAME_MS, GAP_MS } from "../../state/history.js";
import { drawManyObjects } from "./many-objects.js";
import { drawLabels } from "../canvas/labels.js";
import { discRadius, drawObject } from "./object-symbol.js";
import { TRAIL_MS } from "../../state/store.js";

/** Largest size of a filled ellipse, as part of the arena's smaller side. */
const LARGEST_FILL = 0.25;
/** Steps in which trails fade. Each step is one stroke for all objects of a stage. */
const TRAIL_BANDS = 4;
/** Approximate total number of trail points. */
const TRAIL_POINTS = 3000;
/** From this number of objects in view on, many-objects.js draws them faster and with less detail. */
export const MANY_OBJECTS = 120;
const MANY_OBJECTS_TRAIL_MS = 2000;

/** @typedef {import("../viewport.js").Viewport} Viewport */
/** @typedef {import("../palette.js").Palette} Palette */
/** @typedef {import("../../state/store.js").Track} Track */
/** @typedef {import("../../state/history.js").History} History */

/**
 * @typedef {object} PlotOptions
 * @property {number} exaggeration of the ellipses; 0 hides them
 * @property {boolean} trails
 * @property {number | null} selected
 * @property {number | null} hovered
 * @property {number} timeMs pose time shown
 * @property {History} history
 * @property {import("../../wire/messages.js").Camera[]} cameras mounted cameras
 */

/**
 * @param {import("../canvas/canvas-layer.js").Context2D} context in CSS pixels
 * @param {Viewport} view
 * @param {Palette} palette
 * @param {Track[]} tracks
 * @param {PlotOptions} options
 */
export function drawTracks(context, view, palette, tracks, options) {
  context.clearRect(0, 0, view.width, view.height);
  context.save();
  context.beginPath();
  context.rect(RULER.left, 0, view.width - RULER.left, view.height - RULER.bottom);
  context.clip();
  context.lineCap = "round";
  context.lineJoin = "round";
  drawCameras(context, view, palette, options.cameras);
  if (options.trails) drawTrails(context, view, palette, tracks, options);
  const margin = 80;
  const seen = tracks.filter(({ state }) => {
    if (!state.positionM) return false;
    const [px, py] = [view.screenX(state.positionM.x), view.screenY(state.positionM.y)];
    return px > -margin && py > -margin && px < view.width + margin && py < view.height + margin;
  });
  if (options.exaggeration > 0) {
    for (const track of seen) drawEllipse(context, view, palette, track, options);
  }
  if (seen.length < MANY_OBJECTS) for (const track of seen) drawObject(context, view, palette, track, options);
  else drawManyObjects(context, view, palette, seen, options);
  const radius = discRadius(view);
  const labels = seen.map(({ state }) => ({
    state,
    px: view.screenX(state.positionM?.x ?? 0) + radius + 4,
    py: view.screenY(state.positionM?.y ?? 0) - radius * 0.55,
  }));
  drawLabels(context, palette, labels, options, view.ratio);
  context.restore();
}

/**
 * Length of the trails and stride in frames of the history, so that the total number of points is limited.
 * @param {number} objects
 * @param {number} points approximate total
 */
export function trailPlan(objects, points) {
  const spanMs = objects < MANY_OBJECTS ? TRAIL_MS : MANY_OBJECTS_TRAIL_MS;
  return { spanMs, stride: Math.max(1, Math.ceil((objects * spanMs) / FRAME_MS / points)) };
}

/**
 * @param {import("../canvas/canvas-layer.js").Context2D} context
 * @param {Viewport} view
 * @param {Palette} palette
 * @param {Track[]} tracks
 * @param {PlotOptions} options
 */
function drawTrails(context, view, palette, tracks, options) {
  const hasManyObjects = tracks.length >= MANY_OBJECTS;
  // Thin lines without round joins are the fastest.
  context.lineWidth = hasManyObjects ? 1 : 1.75;
  context.lineJoin = hasManyObjects ? "bevel" : "round";
  context.lineCap = hasManyObjects ? "butt" : "round";
  const plan = trailPlan(tracks.length, TRAIL_POINTS);
  for (const stage of /** @type {const} */ (["tracked", "predicted", "tentative", "lost"])) {
    const members = tracks.filter((track) => track.state.stage === stage);
    if (members.length === 0) continue;
    context.strokeStyle = palette.stage[stage];
    const bands = Array.from({ length: TRAIL_BANDS }, () => new Path2D());
    for (const { state } of members) traceTrail(bands, view, state, plan, options);
    for (const [band, path] of bands.entries()) {
      context.globalAlpha = 0.15 + (0.6 * band) / (TRAIL_BANDS - 1);
      context.stroke(path);
    }
  }
  context.globalAlpha = 1;
  context.lineJoin = "round";
  context.lineCap = "round";
}

/**
 * Adds an object's trail to the paths of the fading steps, the oldest first.
 * @param {Path2D[]} bands
 * @param {Viewport} view
 * @param {import("../../state/object-state.js").ObjectState} state
 * @param {{spanMs: number, stride: number}} plan
 * @param {PlotOptions} options
 */
function traceTrail(bands, view, state, { spanMs, stride }, { history, timeMs }) {
  let [px, py, lastMs, lastBand] = [0, 0, -Infinity, -1];
  /** @param {number} atMs @param {number} x @param {number} y */
  const visit = (atMs, x, y) => {
    const [toX, toY] = [view.screenX(x), view.screenY(y)];
    const age = (timeMs - atMs) / spanMs;
    const band = Math.min(bands.length - 1, Math.max(0, Math.floor((1 - age) * bands.length)));
    const isWhole = atMs - lastMs <= GAP_MS + stride * FRAME_MS;
    if (isWhole && atMs > lastMs) {
      if (band !== lastBand || lastBand < 0) bands[band].moveTo(px, py);
      bands[band].lineTo(toX, toY);
    }
    lastBand = isWhole ? band : -1;
    [px, py, lastMs] = [toX, toY, atMs];
  };
  history.trace(state.id, timeMs - spanMs, timeMs, stride, visit);
  // From the last stored frame to the current position.
  if (state.positionM) visit(timeMs, state.positionM.x, state.positionM.y);
}

/**
 * @param {import("../canvas/canvas-layer.js").Context2D} context
 * @param {Viewport} view
 * @param {Palette} palette
 * @param {Track} track
 * @param {PlotOptions} options
 */
function drawEllipse(context, view, palette, { state }, options) {
  const { ellipse, positionM } = state;
  if (!ellipse || !positionM || state.stage === "lost") return;
  const stretch = view.scale * options.exaggeration;
  // Hidden by the disc.
  if (ellipse.majorM * stretch < discRadius(view) - 1) return;
  context.beginPath();
  context.ellipse(
    view.screenX(positionM.x),
    view.screenY(positionM.y),
    ellipse.majorM * stretch,
    ellipse.minorM * stretch,
    // The canvas' y axis points down, which reverses angles.
    -ellipse.angleRad,
    0,
    2 * Math.PI,
  );
  const color = palette.stage[state.stage];
  // The ellipse of a new object may be metres wide; filled, it would tint the whole arena.
  if (ellipse.majorM * stretch < LARGEST_FILL * Math.min(view.width, view.height)) {
    context.fillStyle = color;
    context.globalAlpha = 0.12;
    context.fill();
  }
  context.globalAlpha = 0.75;
  context.strokeStyle = color;
  context.lineWidth = 1;
  context.stroke();
  context.globalAlpha = 1;
}
