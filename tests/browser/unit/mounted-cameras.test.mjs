/** Poses of mounted cameras follow their carriers in every snapshot. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { compose, multiply, rotate } from "../../../client/dashboard/js/base/geometry.js";
import { readCameras, readSnapshot } from "../../../client/dashboard/js/wire/messages.js";
import { moveWithCarrier } from "../../../client/dashboard/js/state/mounted-cameras.js";

const HALF = Math.SQRT1_2;
/** Rotation by 90° about z. */
const LEFT = { x: 0, y: 0, z: HALF, w: HALF };

const [CAMERA] = readCameras([
  {
    name: "aboard",
    status: "running",
    carrier: "drone",
    pose: { position: { x: 9, y: 9, z: 9 }, orientation: { x: 0, y: 0, z: 0, w: 1 } },
    mount: { position: { x: 0.5, y: 0, z: -0.1 }, orientation: { x: 1, y: 0, z: 0, w: 0 } },
    pose_status: "riding",
  },
]);

function drones(...changes) {
  const drone = {
    object_id: 1, name: "drone", stage: "tracked", yaw_observed: true, orientation: LEFT,
    position: { x: 1, y: 2, z: 3 },
  };
  return readSnapshot({ objects: changes.map((change) => ({ ...drone, ...change })) }).objects;
}

function near(a, b) {
  for (const key of Object.keys(b)) assert.ok(Math.abs(a[key] - b[key]) < 1e-12, `${key}: ${a[key]}, not ${b[key]}`);
}

test("the product of two rotations applies them in sequence", () => {
  const v = { x: 0.3, y: -1.2, z: 0.7 };
  const tilt = { x: 0.6, y: 0, z: 0, w: 0.8 };
  near(rotate(multiply(LEFT, tilt), v), rotate(LEFT, rotate(tilt, v)));
  const there = compose({ position: v, orientation: LEFT }, { position: { x: 1, y: 0, z: 0 }, orientation: tilt });
  near(there.position, { x: 0.3, y: -0.2, z: 0.7 });
});

test("a camera's pose follows from its carrier", () => {
  const { pose } = moveWithCarrier(CAMERA, drones({}));
  near(pose.position, { x: 1, y: 2.5, z: 2.9 });
  near(rotate(pose.orientation, { x: 0, y: 0, z: 1 }), { x: 0, y: 0, z: -1 });
  near(rotate(pose.orientation, { x: 1, y: 0, z: 0 }), { x: 0, y: 1, z: 0 });
});

test("without a carrier a camera keeps the server's pose, or none", () => {
  for (const objects of [
    drones(),
    drones({ name: "another" }),
    drones({ stage: "lost" }),
    drones({ yaw_observed: false }),
    drones({ position: null }),
    drones({}, { object_id: 2 }),
  ]) {
    assert.deepEqual(moveWithCarrier(CAMERA, objects).pose, CAMERA.pose);
  }
  const unplaced = { ...CAMERA, pose: null };
  assert.equal(moveWithCarrier(unplaced, drones({})).pose, null);
  const standing = { ...CAMERA, mount: null, carrier: "" };
  assert.deepEqual(moveWithCarrier(standing, drones({})).pose, CAMERA.pose);
});
