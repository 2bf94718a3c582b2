/** The camera form's conversions. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { lookAtOf, orientationOf } from "../../../client/dashboard/js/panels/cameras/look-at.js";
import { rotate } from "../../../client/dashboard/js/base/geometry.js";
import { changedFields, withoutEmpty } from "../../../client/dashboard/js/panels/cameras/camera-form.js";

const near = (a, b, message) => assert.ok(Math.abs(a - b) < 1e-9, `${message}: ${a} for ${b}`);
const nearVector = (a, b, message) => ["x", "y", "z"].forEach((axis) => near(a[axis], b[axis], `${message} ${axis}`));

test("a level camera has its right side level and its lower side down", () => {
  const turn = orientationOf({ position: { x: 0, y: 0, z: 2 }, target: { x: 5, y: 0, z: 2 }, turnedDeg: 0 });
  nearVector(rotate(turn, { x: 0, y: 0, z: 1 }), { x: 1, y: 0, z: 0 }, "ahead");
  nearVector(rotate(turn, { x: 1, y: 0, z: 0 }), { x: 0, y: -1, z: 0 }, "right");
  nearVector(rotate(turn, { x: 0, y: 1, z: 0 }), { x: 0, y: 0, z: -1 }, "down");
});

test("a positive roll lowers the camera's right side", () => {
  const turn = orientationOf({ position: { x: 0, y: 0, z: 2 }, target: { x: 5, y: 0, z: 2 }, turnedDeg: 90 });
  nearVector(rotate(turn, { x: 1, y: 0, z: 0 }), { x: 0, y: 0, z: -1 }, "right");
});

test("a camera that looks straight down has the world's x to its right", () => {
  const turn = orientationOf({ position: { x: 1, y: 2, z: 3 }, target: { x: 1, y: 2, z: 0 }, turnedDeg: 0 });
  nearVector(rotate(turn, { x: 1, y: 0, z: 0 }), { x: 1, y: 0, z: 0 }, "right");
  nearVector(rotate(turn, { x: 0, y: 1, z: 0 }), { x: 0, y: -1, z: 0 }, "down");
});

test("position, target and roll survive the conversion to a quaternion and back", () => {
  for (const [position, target, turnedDeg] of [
    [{ x: 2.5, y: 2, z: 5 }, { x: 1.25, y: 1, z: 0 }, 0],
    [{ x: -2.5, y: 2, z: 5 }, { x: 4, y: -3, z: 0 }, 37],
    [{ x: 1, y: 1, z: 4 }, { x: 1, y: 1, z: 0 }, -120],
    [{ x: 0, y: 0, z: 1 }, { x: 0, y: 1, z: 1 }, 180],
  ]) {
    const orientation = orientationOf({ position, target, turnedDeg });
    near(Math.hypot(orientation.x, orientation.y, orientation.z, orientation.w), 1, "length");
    const aim = lookAtOf({ position, orientation });
    nearVector(aim.target, target, "target");
    near(Math.abs(aim.turnedDeg), Math.abs(turnedDeg), "turn");
  }
  assert.equal(orientationOf({ position: { x: 1, y: 1, z: 1 }, target: { x: 1, y: 1, z: 1 }, turnedDeg: 0 }), null);
});

test("a PATCH request has the changed fields, and null for removed ones", () => {
  const before = { name: "a", source: "push:", calibration: "a.yaml", pose: { unknown: true }, rate_hz: 30, mode: "" };
  assert.deepEqual(changedFields(before, { ...before, pose: { unknown: true } }), {});
  assert.deepEqual(changedFields(before, { ...before, rate_hz: null, mode: "fast", calibration: "" }), { rate_hz: null, mode: "fast", calibration: null });
  assert.deepEqual(withoutEmpty({ ...before, rate_hz: null, calibration: "" }), { name: "a", source: "push:", pose: { unknown: true } });
});
