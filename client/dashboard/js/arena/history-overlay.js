/** Draws trajectories or a heat map of the history over the arena. */

import { heatOpacity, eachPoint } from "../state/trajectories.js";
import { drawOutlinedText } from "./canvas/outlined-text.js";

/** Opacity of the oldest part of a trajectory. */
const OLDEST_ALPHA = 0.3;
const BANDS = 5;
/** Height of the heat map in 3D, metres. */
const LIFT_M = 0.004;

/** @typedef {import("../state/trajectories.js").HistoryOverlay} HistoryOverlay */
/** @typedef {import("../state/trajectories.js").Trajectory} Trajectory */
/** @typedef {import("./viewport.js").Viewport} Viewport */
/** @typedef {import("./palette.js").Palette} Palette */

/** A line's colour in this theme. @param {Trajectory} trajectory @param {Palette} palette */
export function colorOf(trajectory, palette) {
  return `hsl(${trajectory.hue}, 75%, ${palette.isDark ? 66 : 38}%)`;
}

/**
 * Draws it from above.
 * @param {import("./canvas/canvas-layer.js").Context2D} context in CSS pixels
 * @param {Viewport} view
 * @param {Palette} palette
 * @param {HistoryOverlay} overlay
 */
export function drawOverlay(context, view, palette, overlay) {
  if (overlay.heat) drawHeat(context, view, palette, overlay.heat);
  else for (const trajectory of overlay.trajectories.trajectories) drawTrajectory(context, view, palette, trajectory, overlay.trajectories.stepS);
}

/** @param {import("./canvas/canvas-layer.js").Context2D} context @param {Viewport} view @param {Palette} palette @param {import("../state/trajectories.js").HeatMap} heat */
function drawHeat(context, view, palette, heat) {
  const side = heat.cellM * view.scale;
  context.fillStyle = palette.heat;
  for (let row = 0; row < heat.rows; row += 1) {
    const top = Math.round(view.screenY(heat.minY + (row + 1) * heat.cellM));
    const bottom = Math.round(view.screenY(heat.minY + row * heat.cellM));
    if (bottom < 0 || top > view.height) continue;
    for (let column = 0; column < heat.columns; column += 1) {
      const seconds = heat.seconds[row * heat.columns + column];
      if (seconds === 0) continue;
      const left = Math.round(view.screenX(heat.minX + column * heat.cellM));
      if (left > view.width || left + side < 0) continue;
      context.globalAlpha = heatOpacity(seconds, heat.mostS);
      const right = Math.round(view.screenX(heat.minX + (column + 1) * heat.cellM));
      context.fillRect(left, top, right - left, bottom - top);
    }
  }
  context.globalAlpha = 1;
}

/** @param {import("./canvas/canvas-layer.js").Context2D} context @param {Viewport} view @param {Palette} palette @param {Trajectory} trajectory @param {number} stepS */
function drawTrajectory(context, view, palette, trajectory, stepS) {
  if (trajectory.count === 0) return;
  const { places, count } = trajectory;
  const color = colorOf(trajectory, palette);
  const bands = Array.from({ length: BANDS }, () => new Path2D());
  let [px, py] = [0, 0];
  eachPoint(trajectory, stepS, (i, joined) => {
    const [x, y] = [view.screenX(places[i * 3]), view.screenY(places[i * 3 + 1])];
    const band = bands[Math.min(BANDS - 1, Math.floor((i / count) * BANDS))];
    if (joined) {
      band.moveTo(px, py);
      band.lineTo(x, y);
    } else band.rect(x - 0.75, y - 0.75, 1.5, 1.5);
    [px, py] = [x, y];
  });
  context.strokeStyle = color;
  context.lineWidth = 1.75;
  context.lineCap = "round";
  for (const [i, band] of bands.entries()) {
    context.globalAlpha = OLDEST_ALPHA + ((1 - OLDEST_ALPHA) * i) / (BANDS - 1);
    context.stroke(band);
  }
  context.globalAlpha = 1;
  // A ring at the start, a disc with the name at the end.
  context.beginPath();
  context.arc(view.screenX(places[0]), view.screenY(places[1]), 4, 0, 2 * Math.PI);
  context.fillStyle = palette.sheet;
  context.fill();
  context.stroke();
  context.beginPath();
  context.arc(px, py, 4.5, 0, 2 * Math.PI);
  context.fillStyle = color;
  context.fill();
  context.font = `600 11px ${palette.font}`;
  context.textAlign = "left";
  context.textBaseline = "middle";
  drawOutlinedText(context, palette, trajectory.label, px + 8, py + 9, color);
}

/**
 * Draws it in 3D.
 * @param {import("./space/meshes.js").Lines} lines
 * @param {import("./space/meshes.js").Tiles} tiles
 * @param {(css: string) => [number, number, number]} rgb
 * @param {Palette} palette
 * @param {HistoryOverlay | null} overlay
 */
export function addOverlay(lines, tiles, rgb, palette, overlay) {
  const heat = overlay?.heat;
  tiles.clear();
  if (heat) {
    const color = rgb(palette.heat);
    for (const [i, seconds] of heat.seconds.entries()) {
      if (seconds === 0) continue;
      const x = heat.minX + (i % heat.columns) * heat.cellM;
      const y = heat.minY + Math.floor(i / heat.columns) * heat.cellM;
      tiles.add(x, y, LIFT_M, heat.cellM, color, heatOpacity(seconds, heat.mostS));
    }
  }
  tiles.done();
  if (!overlay || heat) return;
  for (const trajectory of overlay.trajectories.trajectories) {
    const color = rgb(colorOf(trajectory, palette));
    const { places, count } = trajectory;
    eachPoint(trajectory, overlay.trajectories.stepS, (i, joined) => {
      if (!joined) return;
      const alpha = OLDEST_ALPHA + (1 - OLDEST_ALPHA) * (i / count);
      lines.end(places[i * 3 - 3], places[i * 3 - 2], places[i * 3 - 1], color, alpha);
      lines.end(places[i * 3], places[i * 3 + 1], places[i * 3 + 2], color, alpha);
    });
  }
}
