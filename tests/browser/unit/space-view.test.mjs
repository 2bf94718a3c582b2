/** Geometry of the 3D view, and matching of searches. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { cholesky, longestSemiaxis } from "../../../client/dashboard/js/base/geometry.js";
import { OrbitCamera } from "../../../client/dashboard/js/arena/space/orbit-camera.js";
import { matchScore } from "../../../client/dashboard/js/panels/objects/object-search.js";
import { ObjectState } from "../../../client/dashboard/js/state/object-state.js";
import { Matrix4, PerspectiveCamera, Vector3 } from "../../../client/dashboard/vendor/three.js";

const ENTRIES = { xx: 0, xy: 1, xz: 2, yy: 6, yz: 7, zz: 11 };

/** R diag(λ) Rᵀ as 21 numbers, with R a rotation by three angles. */
function turned(lambdas, [a, b, c]) {
  const axes = [new Vector3(1, 0, 0), new Vector3(0, 1, 0), new Vector3(0, 0, 1)].map((axis) =>
    axis.applyMatrix4(new Matrix4().makeRotationX(a)).applyMatrix4(new Matrix4().makeRotationY(b)).applyMatrix4(new Matrix4().makeRotationZ(c)),
  );
  const entry = (i, j) => lambdas.reduce((sum, lambda, k) => sum + lambda * axes[k].toArray()[i] * axes[k].toArray()[j], 0);
  const covariance = Array(21).fill(0);
  for (const [name, at] of Object.entries(ENTRIES)) covariance[at] = entry("xyz".indexOf(name[0]), "xyz".indexOf(name[1]));
  return covariance;
}

test("the longest semi-axis is the root of the largest eigenvalue in all orientations", () => {
  for (const angles of [[0, 0, 0], [0.3, 1.1, -2], [1.5, 0.2, 0.7]]) {
    for (const lambdas of [[9e-6, 1e-6, 4e-6], [1, 1, 1], [1e-9, 5e-2, 5e-2], [0, 0, 0]]) {
      const expected = Math.sqrt(Math.max(...lambdas));
      assert.ok(Math.abs(longestSemiaxis(turned(lambdas, angles)) - expected) <= 1e-9 + 1e-7 * expected);
    }
  }
});

test("the Cholesky factor reproduces the covariance", () => {
  const covariance = turned([9e-6, 1e-6, 4e-6], [0.3, 1.1, -2]);
  const [xx, yx, yy, zx, zy, zz] = cholesky(covariance);
  const made = { xx: xx * xx, xy: xx * yx, xz: xx * zx, yy: yx * yx + yy * yy, yz: yx * zx + yy * zy, zz: zx * zx + zy * zy + zz * zz };
  for (const [name, at] of Object.entries(ENTRIES)) assert.ok(Math.abs(made[name] - covariance[at]) < 1e-15, name);
  assert.ok(cholesky(Array(21).fill(0)).every(Number.isFinite));
});

test("points are projected as three.js does", () => {
  const orbit = new OrbitCamera();
  Object.assign(orbit, { target: { x: 1, y: -2, z: 0.5 }, distanceM: 9, azimuthRad: 0.7, elevationRad: 0.6, width: 700, height: 500 });
  const camera = new PerspectiveCamera(40, 700 / 500, 0.05, 2000);
  camera.up.set(0, 0, 1);
  camera.position.set(orbit.eye.x, orbit.eye.y, orbit.eye.z);
  camera.lookAt(1, -2, 0.5);
  camera.updateMatrixWorld();
  for (const point of [{ x: 0, y: 0, z: 0 }, { x: 3, y: -4, z: 2 }, { x: 1, y: -2, z: 0.5 }]) {
    const drawn = new Vector3(point.x, point.y, point.z).project(camera);
    const { px, py } = orbit.project(point);
    assert.ok(Math.hypot(px - (drawn.x + 1) * 350, py - (1 - drawn.y) * 250) < 1e-6, JSON.stringify(point));
  }
  const behind = { x: orbit.eye.x * 2 - 1, y: orbit.eye.y * 2 + 2, z: orbit.eye.z * 2 };
  assert.equal(orbit.project(behind), null);
});

test("panning follows the drag, and fitting shows the whole box", () => {
  const orbit = new OrbitCamera();
  Object.assign(orbit, { width: 700, height: 500, target: { x: 0, y: 0, z: 0 } });
  const before = { ...orbit.target };
  orbit.slide(40, 0);
  const { px } = orbit.project(before);
  assert.ok(Math.abs(px - 390) < 2, `${px}`);
  orbit.fit({ minX: -12, minY: -9, maxX: 12, maxY: 9 }, 5);
  for (const x of [-12, 12]) {
    for (const y of [-9, 9]) {
      const seen = orbit.project({ x, y, z: 0 });
      assert.ok(seen && seen.px > 0 && seen.px < 700 && seen.py > 0 && seen.py < 500, `${x} ${y} at ${seen?.px} ${seen?.py}`);
    }
  }
  for (let i = 0; i < 100; i += 1) orbit.turn(0, 50);
  assert.ok(orbit.elevationRad < Math.PI / 2);
});

test("a search matches number, name and code", () => {
  const state = (id, name = "", code = null) => new ObjectState({ id, name, code, stage: "tracked", cameras: [] });
  assert.equal(matchScore(state(7), "7"), 3);
  assert.equal(matchScore(state(7), " robot 7 "), 3);
  assert.equal(matchScore(state(17), "robot 7"), 0);
  assert.equal(matchScore(state(71), "7"), 2);
  assert.equal(matchScore(state(17), "7"), 0);
  assert.equal(matchScore(state(3, "Forklift"), "fork"), 2);
  assert.equal(matchScore(state(3, "Forklift"), "LIFT"), 1);
  assert.equal(matchScore(state(3, "", { bits: 8, number: 45 }), "#45"), 3);
  assert.equal(matchScore(state(3), ""), 1);
});
