/**
 * Poses of cameras that are mounted on objects, at the time of a snapshot.
 *
 * The server says where its cameras are twice a second, which a drone outruns; with the object's pose in each
 * snapshot and the camera's place on it, the page knows as often as snapshots come.
 */

import { compose } from "../base/geometry.js";

/** @typedef {import("../wire/messages.js").Camera} Camera */
/** @typedef {import("./object-state.js").ObjectState} ObjectState */

/** Stages in which an object's pose says where its camera is. */
const FOLLOWED = new Set(["tracked", "predicted"]);

/**
 * Returns the camera at the pose that its carrier gives it.
 * @param {Camera} camera
 * @param {Iterable<ObjectState>} objects of one snapshot
 * @returns {Camera}
 */
export function moveWithCarrier(camera, objects) {
  if (!camera.mount || !camera.pose || !camera.carrier) return camera;
  const own = [...objects].filter((state) => state.name === camera.carrier && FOLLOWED.has(state.stage));
  // Seen twice it is nowhere, as the server has it too.
  const [state] = own;
  if (own.length !== 1 || !state.positionM || !state.orientation || state.headingRad === null) return camera;
  const pose = compose({ position: state.positionM, orientation: state.orientation }, camera.mount);
  return { ...camera, pose };
}
