/**
 * Poses of cameras that are mounted on objects, at the time of a snapshot.
 *
 * The server sends camera poses only twice a second. The page computes them for each snapshot from the object's pose and
 * the camera's mounting pose.
 */

import { compose } from "../base/geometry.js";

/** @typedef {import("../wire/messages.js").Camera} Camera */
/** @typedef {import("./object-state.js").ObjectState} ObjectState */

/** Life stages in which an object's pose determines its camera's. */
const FOLLOWED = new Set(["tracked", "predicted"]);

/**
 * Returns the camera with the pose that follows from its carrier.
 * @param {Camera} camera
 * @param {Iterable<ObjectState>} objects of one snapshot
 * @returns {Camera}
 */
export function moveWithCarrier(camera, objects) {
  if (!camera.mount || !camera.pose || !camera.carrier) return camera;
  const own = [...objects].filter((state) => state.name === camera.carrier && FOLLOWED.has(state.stage));
  // With two objects of that name the pose is ambiguous; the server treats it in the same way.
  const [state] = own;
  if (own.length !== 1 || !state.positionM || !state.orientation || state.headingRad === null) return camera;
  const pose = compose({ position: state.positionM, orientation: state.orientation }, camera.mount);
  return { ...camera, pose };
}
