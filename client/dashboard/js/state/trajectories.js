/**
 * Trajectories from the server's history, and a heat map of the time that each cell was occupied. Pure functions.
 */

import { roundStep } from "../base/geometry.js";
import { count, list, milliseconds, number, text, vector } from "../base/validate.js";

/** Points that are more steps of the history apart than this are not joined. */
const GAP_STEPS = 3.5;
/** Approximate number of cells along the longer side of a heat map. */
const CELLS = 64;
const LEAST_CELL_M = 0.02;

/**
 * Trajectory of one object in one run of the server.
 * @typedef {object} Trajectory
 * @property {number} id
 * @property {string} label name, code or id
 * @property {number} hue of its line, degrees
 * @property {number} count
 * @property {Float64Array} timesMs
 * @property {Float32Array} places x, y, z of each point
 */
/** @typedef {{trajectories: Trajectory[], points: number, stepS: number, oldestMs: number | null, newestMs: number | null}} Trajectories */
/** Seconds in each cell, row by row from the lower left one. @typedef {{minX: number, minY: number, cellM: number, columns: number, rows: number, seconds: Float32Array, mostS: number}} HeatMap */
/** Drawn over the arena: the heat map if there is one, else the trajectories. @typedef {{trajectories: Trajectories, heat: HeatMap | null}} HistoryOverlay */

/** @param {any} raw response of /api/v1/history @returns {Trajectories} */
export function readTrajectories(raw) {
  const stepS = count(raw?.step_s);
  const trajectories = list(raw?.objects).map((one, i) => readTrajectory(one, i));
  return { trajectories, points: count(raw?.points), stepS, oldestMs: milliseconds(raw?.oldest_time_ns) || null, newestMs: milliseconds(raw?.newest_time_ns) || null };
}

/** @param {any} raw @param {number} i @returns {Trajectory} */
function readTrajectory(raw, i) {
  const points = list(raw?.points);
  const timesMs = new Float64Array(points.length);
  const places = new Float32Array(points.length * 3);
  let kept = 0;
  for (const point of points) {
    const [atMs, place] = [milliseconds(point?.time_ns), vector(point?.position)];
    if (atMs === null || !place) continue;
    timesMs[kept] = atMs;
    places.set([place.x, place.y, place.z], kept * 3);
    kept += 1;
  }
  const code = number(raw?.code);
  const label = text(raw?.name) || (code ? `#${code}` : String(count(raw?.object_id)));
  // The golden angle makes neighbours differ most.
  return { id: count(raw?.object_id), label, hue: (312 + i * 137.5) % 360, count: kept, timesMs, places };
}

/**
 * Visits the points of a trajectory; `joined` if a line connects it to the previous one.
 * @param {Trajectory} trajectory
 * @param {number} stepS
 * @param {(i: number, joined: boolean) => void} visit
 */
export function eachPoint(trajectory, stepS, visit) {
  const gapMs = Math.max(1000, GAP_STEPS * stepS * 1000);
  for (let i = 0; i < trajectory.count; i += 1) {
    visit(i, i > 0 && trajectory.timesMs[i] - trajectory.timesMs[i - 1] <= gapMs);
  }
}

/**
 * Computes how long each cell of the floor was occupied; every point counts for one step.
 * @param {Trajectories} trajectories
 * @returns {HeatMap | null} null without points
 */
export function computeHeatMap({ trajectories, stepS }) {
  let [minX, minY, maxX, maxY] = [Infinity, Infinity, -Infinity, -Infinity];
  for (const { places, count } of trajectories) {
    for (let i = 0; i < count; i += 1) {
      minX = Math.min(minX, places[i * 3]);
      maxX = Math.max(maxX, places[i * 3]);
      minY = Math.min(minY, places[i * 3 + 1]);
      maxY = Math.max(maxY, places[i * 3 + 1]);
    }
  }
  if (minX > maxX) return null;
  const cellM = Math.max(LEAST_CELL_M, roundStep(Math.max(LEAST_CELL_M, (Math.max(maxX - minX, maxY - minY) / CELLS) * 2)));
  // Cell borders are multiples of the cell size, so that two maps have the same cells.
  const [left, low] = [Math.floor(minX / cellM), Math.floor(minY / cellM)];
  const columns = Math.floor(maxX / cellM) - left + 1;
  const rows = Math.floor(maxY / cellM) - low + 1;
  const seconds = new Float32Array(columns * rows);
  let mostS = 0;
  for (const { places, count } of trajectories) {
    for (let i = 0; i < count; i += 1) {
      const at = (Math.floor(places[i * 3 + 1] / cellM) - low) * columns + Math.floor(places[i * 3] / cellM) - left;
      seconds[at] += stepS;
      mostS = Math.max(mostS, seconds[at]);
    }
  }
  return { minX: left * cellM, minY: low * cellM, cellM, columns, rows, seconds, mostS };
}

/** Opacity of a cell, 0 to 1; briefly occupied cells stay visible. @param {number} seconds @param {number} mostS */
export function heatOpacity(seconds, mostS) {
  return seconds > 0 ? 0.12 + 0.68 * Math.sqrt(seconds / mostS) : 0;
}

/**
 * Finds the trajectory point nearest to a point of the floor.
 * @param {Trajectories} trajectories
 * @param {number} x
 * @param {number} y
 * @param {number} withinM
 * @returns {{trajectory: Trajectory, timeMs: number} | null}
 */
export function nearestPoint({ trajectories }, x, y, withinM) {
  let found = null;
  let nearestM = withinM;
  for (const trajectory of trajectories) {
    for (let i = 0; i < trajectory.count; i += 1) {
      const distanceM = Math.hypot(trajectory.places[i * 3] - x, trajectory.places[i * 3 + 1] - y);
      if (distanceM >= nearestM) continue;
      nearestM = distanceM;
      found = { trajectory, timeMs: trajectory.timesMs[i] };
    }
  }
  return found;
}
