/** Orientation of prints: conversion between angles and the configuration's directions. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { directions, turnOf } from "../../../client/dashboard/js/panels/objects/mount-fields.js";

const close = (one, other) => assert.ok(Math.abs(one - other) < 1e-6, `${one} is not ${other}`);
const same = (one, other) => Object.keys(other).forEach((key) => close(one[key], other[key]));

test("a print without rotation has its right along x and its top along y", () => {
  assert.deepEqual(directions({ rollDeg: 0, pitchDeg: 0, yawDeg: 0 }), { right: { x: 1, y: 0, z: 0 }, top: { x: 0, y: 1, z: 0 } });
});

test("yaw rotates counter-clockwise, pitch lowers the right, roll raises the top", () => {
  same(directions({ rollDeg: 0, pitchDeg: 0, yawDeg: 90 }).right, { x: 0, y: 1, z: 0 });
  same(directions({ rollDeg: 0, pitchDeg: 30, yawDeg: 0 }).right, { x: Math.sqrt(0.75), y: 0, z: -0.5 });
  same(directions({ rollDeg: 90, pitchDeg: 0, yawDeg: 0 }).top, { x: 0, y: 0, z: 1 });
});

test("a print on the front of a robot faces ahead with its top up", () => {
  // Seen from ahead, the print's right is the vehicle's left.
  const front = turnOf({ x: 0, y: 1, z: 0 }, { x: 0, y: 0, z: 1 });
  assert.deepEqual(front, { rollDeg: 90, pitchDeg: 0, yawDeg: 90 });
});

test("directions survive the conversion to angles and back, also straight up and down", () => {
  for (const rollDeg of [-170, -90, 0, 33, 90, 180])
    for (const pitchDeg of [-90, -41, 0, 12, 90])
      for (const yawDeg of [-135, 0, 77, 180]) {
        const { right, top } = directions({ rollDeg, pitchDeg, yawDeg });
        const again = directions(turnOf(right, top));
        same(again.right, right);
        same(again.top, top);
      }
});

test("directions need not be of length 1 or exactly perpendicular", () => {
  same(turnOf({ x: 2, y: 0, z: 0 }, { x: 0.001, y: 0.5, z: 0 }), { rollDeg: 0, pitchDeg: 0, yawDeg: 0 });
});
