/**
 * Converts a camera's pose between position, target and roll (as in the form) and a quaternion (as in the configuration).
 *
 * Camera frame: x right, y down, z forward; world frame: z up. A camera with zero roll has a level x axis; if it looks
 * straight up or down, its x axis is the world's.
 */

import { rotate } from "../../base/geometry.js";

/** @typedef {import("../../base/geometry.js").Vector3} Vector */
/** @typedef {import("../../base/geometry.js").Quaternion} Quaternion */
/** @typedef {{position: Vector, target: Vector, turnedDeg: number}} LookAt */

/** Sine of the angle from the vertical below which a view is straight up or down. */
const UPRIGHT = 1e-6;
/** Sine of the smallest downward angle for which the target is on the floor. */
const LEAST_FALL = 0.05;

/** @param {Vector} a @param {Vector} b @returns {Vector} */
const cross = (a, b) => ({ x: a.y * b.z - a.z * b.y, y: a.z * b.x - a.x * b.z, z: a.x * b.y - a.y * b.x });
/** @param {Vector} a @param {Vector} b */
const dot = (a, b) => a.x * b.x + a.y * b.y + a.z * b.z;
/** @param {Vector} a @param {number} factor @param {Vector} b @returns {Vector} a + factor b */
const plus = (a, factor, b) => ({ x: a.x + factor * b.x, y: a.y + factor * b.y, z: a.z + factor * b.z });

/** Level vector to the right of a camera that looks along `z`. @param {Vector} z @returns {Vector} */
function level(z) {
  const right = cross(z, { x: 0, y: 0, z: 1 });
  const length = Math.sqrt(dot(right, right));
  return length < UPRIGHT ? { x: 1, y: 0, z: 0 } : plus({ x: 0, y: 0, z: 0 }, 1 / length, right);
}

/**
 * Orientation of a camera; null if its target is its own position.
 * @param {LookAt} aim
 * @returns {Quaternion | null}
 */
export function orientationOf({ position, target, turnedDeg }) {
  const way = plus(target, -1, position);
  const length = Math.sqrt(dot(way, way));
  if (!(length > 1e-6)) return null;
  const z = plus({ x: 0, y: 0, z: 0 }, 1 / length, way);
  const right = level(z);
  const down = cross(z, right);
  const turn = (turnedDeg * Math.PI) / 180;
  const none = { x: 0, y: 0, z: 0 };
  const x = plus(plus(none, Math.cos(turn), right), Math.sin(turn), down);
  const y = cross(z, x);
  return ofAxes(x, y, z);
}

/** The rotation whose matrix has these columns. @param {Vector} x @param {Vector} y @param {Vector} z @returns {Quaternion} */
function ofAxes(x, y, z) {
  // Four times the squares of the quaternion's components; dividing by the largest is safe.
  const squares = [1 + x.x - y.y - z.z, 1 - x.x + y.y - z.z, 1 - x.x - y.y + z.z, 1 + x.x + y.y + z.z];
  const largest = squares.indexOf(Math.max(...squares));
  const double = Math.sqrt(squares[largest]);
  const by = 1 / (2 * double);
  const parts = [
    [double / 2, (y.x + x.y) * by, (z.x + x.z) * by, (y.z - z.y) * by],
    [(y.x + x.y) * by, double / 2, (z.y + y.z) * by, (z.x - x.z) * by],
    [(z.x + x.z) * by, (z.y + y.z) * by, double / 2, (x.y - y.x) * by],
    [(y.z - z.y) * by, (z.x - x.z) * by, (x.y - y.x) * by, double / 2],
  ][largest];
  const [i, j, k, w] = parts;
  return { x: i, y: j, z: k, w };
}

/**
 * Inverse of `orientationOf`. The target is on the floor if the camera looks down, else a metre ahead.
 * @param {{position: Vector, orientation: Quaternion}} pose
 * @returns {LookAt}
 */
export function lookAtOf({ position, orientation }) {
  const x = rotate(orientation, { x: 1, y: 0, z: 0 });
  const z = rotate(orientation, { x: 0, y: 0, z: 1 });
  const meets = z.z < -LEAST_FALL && position.z > 0 ? position.z / -z.z : 1;
  const right = level(z);
  const turn = Math.atan2(dot(x, cross(z, right)), dot(x, right));
  return { position, target: plus(position, meets, z), turnedDeg: (turn * 180) / Math.PI };
}
