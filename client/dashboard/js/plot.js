/**
 * What moves in the arena: objects with their trails, velocities, headings, heights and uncertainty.
 *
 * Life stages differ by shape as well as by colour: tracked is a closed ring, predicted a broken
 * one, tentative a diamond, lost a cross.
 */

import { drawCameras, RULER } from "./backdrop.js";
import { fixed } from "./format.js";
import { TRAIL_MS } from "./store.js";

/** Objects higher than this carry their height, metres; a robot's roundel is mostly below. */
const FLYING_M = 0.5;
/** The line of the velocity ends where the object will be after this time, s. */
const LEAD_S = 0.5;
/** Ellipses are filled up to this part of the arena's smaller side. */
const LARGEST_FILL = 0.25;
/** Trails fade in so many steps; each step is one stroke for all objects of a stage. */
const TRAIL_BANDS = 4;
/** A trail is not drawn across a gap in time longer than this, ms. */
const TRAIL_GAP_MS = 500;

/** @typedef {import("./view.js").View} View */
/** @typedef {import("./palette.js").Palette} Palette */
/** @typedef {import("./store.js").Track} Track */

/**
 * @typedef {object} PlotOptions
 * @property {number} exaggeration of the ellipses; 0: none drawn
 * @property {boolean} trails
 * @property {number | null} selected
 * @property {number | null} hovered
 * @property {number} timeMs pose time of the newest snapshot
 * @property {import("./message.js").Camera[]} cameras those that move
 */

/** Radius of an object's disc, CSS pixels: about 0.3 m wide in the world, but always legible. */
export function discRadius(/** @type {View} */ view) {
  return Math.min(15, Math.max(6.5, 0.13 * view.scale));
}

/**
 * @param {CanvasRenderingContext2D} context in CSS pixels
 * @param {View} view
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
  if (options.trails) drawTrails(context, view, palette, tracks, options.timeMs);
  const margin = 80;
  const seen = tracks.filter(({ state }) => {
    if (!state.positionM) return false;
    const [px, py] = [view.screenX(state.positionM.x), view.screenY(state.positionM.y)];
    return px > -margin && py > -margin && px < view.width + margin && py < view.height + margin;
  });
  if (options.exaggeration > 0) {
    for (const track of seen) drawEllipse(context, view, palette, track, options);
  }
  for (const track of seen) drawObject(context, view, palette, track, options);
  context.font = `600 11.5px ${palette.font}`;
  for (const track of seen) drawLabel(context, view, palette, track, options);
  context.restore();
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {View} view
 * @param {Palette} palette
 * @param {Track[]} tracks
 * @param {number} timeMs
 */
function drawTrails(context, view, palette, tracks, timeMs) {
  context.lineWidth = 1.75;
  for (const stage of /** @type {const} */ (["tracked", "predicted", "tentative", "lost"])) {
    const members = tracks.filter((track) => track.state.stage === stage);
    if (members.length === 0) continue;
    context.strokeStyle = palette.stage[stage];
    for (let band = 0; band < TRAIL_BANDS; band += 1) {
      const oldMs = timeMs - (TRAIL_MS * (TRAIL_BANDS - band)) / TRAIL_BANDS;
      const newMs = oldMs + TRAIL_MS / TRAIL_BANDS;
      context.beginPath();
      for (const { trail } of members) traceTrail(context, view, trail, oldMs, newMs);
      context.globalAlpha = 0.15 + (0.6 * band) / (TRAIL_BANDS - 1);
      context.stroke();
    }
  }
  context.globalAlpha = 1;
}

/**
 * Adds the part of a trail between two times; it starts at the last point before, so that bands join.
 * @param {CanvasRenderingContext2D} context
 * @param {View} view
 * @param {import("./store.js").TrailPoint[]} trail
 * @param {number} oldMs
 * @param {number} newMs
 */
function traceTrail(context, view, trail, oldMs, newMs) {
  for (let i = 1; i < trail.length; i += 1) {
    const [from, to] = [trail[i - 1], trail[i]];
    if (to.timeMs <= oldMs || to.timeMs > newMs) continue;
    const joins = i > 1 && trail[i - 1].timeMs > oldMs && from.timeMs - trail[i - 2].timeMs <= TRAIL_GAP_MS;
    if (to.timeMs - from.timeMs > TRAIL_GAP_MS) continue;
    if (!joins) context.moveTo(view.screenX(from.x), view.screenY(from.y));
    context.lineTo(view.screenX(to.x), view.screenY(to.y));
  }
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {View} view
 * @param {Palette} palette
 * @param {Track} track
 * @param {PlotOptions} options
 */
function drawEllipse(context, view, palette, { state }, options) {
  const { ellipse, positionM } = state;
  if (!ellipse || !positionM || state.stage === "lost") return;
  const stretch = view.scale * options.exaggeration;
  context.beginPath();
  context.ellipse(
    view.screenX(positionM.x),
    view.screenY(positionM.y),
    ellipse.majorM * stretch,
    ellipse.minorM * stretch,
    // The canvas' y points down, so angles turn the other way.
    -ellipse.angleRad,
    0,
    2 * Math.PI,
  );
  const color = palette.stage[state.stage];
  // A new object may be known to metres only; filled, it would tint the whole arena.
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

/**
 * @param {CanvasRenderingContext2D} context
 * @param {View} view
 * @param {Palette} palette
 * @param {Track} track
 * @param {PlotOptions} options
 */
function drawObject(context, view, palette, { state }, options) {
  const { positionM, velocityMS } = state;
  if (!positionM) return;
  const [px, py] = [view.screenX(positionM.x), view.screenY(positionM.y)];
  const radius = discRadius(view);
  const color = palette.stage[state.stage];
  if (velocityMS && state.stage !== "lost") {
    context.beginPath();
    context.moveTo(px, py);
    context.lineTo(
      px + velocityMS.x * LEAD_S * view.scale,
      py - velocityMS.y * LEAD_S * view.scale,
    );
    context.strokeStyle = color;
    context.lineWidth = 1.25;
    context.stroke();
  }
  if (state.id === options.selected || state.id === options.hovered) {
    context.beginPath();
    context.arc(px, py, radius + 5, 0, 2 * Math.PI);
    context.strokeStyle = palette.accent;
    context.lineWidth = state.id === options.selected ? 2.5 : 1.25;
    context.stroke();
  }
  drawMark(context, px, py, radius, state.stage, color, palette.sheet);
  if (state.headingRad !== null && state.stage !== "lost") {
    const [hx, hy] = [Math.cos(state.headingRad), -Math.sin(state.headingRad)];
    context.beginPath();
    for (const side of state.eitherWay ? [1, -1] : [1]) {
      context.moveTo(px + hx * radius * 0.2 * side, py + hy * radius * 0.2 * side);
      context.lineTo(px + hx * radius * 1.5 * side, py + hy * radius * 1.5 * side);
    }
    context.strokeStyle = palette.ink;
    context.lineWidth = 2.5;
    context.stroke();
  }
}

/**
 * The sign of a life stage; index.html draws the same ones for the lists.
 * @param {CanvasRenderingContext2D} context
 * @param {number} px
 * @param {number} py
 * @param {number} radius
 * @param {import("./message.js").Stage} stage
 * @param {string} color
 * @param {string} sheet
 */
function drawMark(context, px, py, radius, stage, color, sheet) {
  const width = Math.max(2.5, radius * 0.38);
  context.beginPath();
  context.strokeStyle = color;
  context.fillStyle = sheet;
  if (stage === "lost") {
    const arm = radius * 0.7;
    context.moveTo(px - arm, py - arm);
    context.lineTo(px + arm, py + arm);
    context.moveTo(px + arm, py - arm);
    context.lineTo(px - arm, py + arm);
    context.lineWidth = 2.5;
    context.stroke();
    return;
  }
  if (stage === "tentative") {
    context.moveTo(px, py - radius);
    context.lineTo(px + radius, py);
    context.lineTo(px, py + radius);
    context.lineTo(px - radius, py);
    context.closePath();
    context.lineWidth = 2;
  } else {
    context.arc(px, py, radius - width / 2, 0, 2 * Math.PI);
    context.lineWidth = width;
  }
  context.fill();
  if (stage === "predicted") {
    const sixth = (Math.PI * (2 * radius - width)) / 12;
    context.lineCap = "butt";
    context.setLineDash([sixth * 1.25, sixth * 0.75]);
  }
  context.stroke();
  context.setLineDash([]);
  context.lineCap = "round";
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {View} view
 * @param {Palette} palette
 * @param {Track} track
 * @param {PlotOptions} options
 */
function drawLabel(context, view, palette, { state }, options) {
  const { positionM } = state;
  if (!positionM) return;
  const radius = discRadius(view);
  const px = view.screenX(positionM.x) + radius + 4;
  const py = view.screenY(positionM.y) - radius * 0.55;
  const flying = positionM.z > FLYING_M;
  context.textAlign = "left";
  context.textBaseline = "middle";
  context.lineWidth = 3.5;
  context.strokeStyle = palette.sheet;
  context.strokeText(state.label, px, py);
  context.fillStyle = state.id === options.selected ? palette.accent : palette.ink;
  context.fillText(state.label, px, py);
  if (!flying) return;
  const height = `\u2191\u2009${fixed(positionM.z, 1)} m`;
  context.save();
  context.font = `10.5px ${palette.font}`;
  context.strokeText(height, px, py + 12.5);
  context.fillStyle = palette.inkSoft;
  context.fillText(height, px, py + 12.5);
  context.restore();
}
