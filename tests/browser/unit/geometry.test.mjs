/** Known answers of the arena's geometry. */

import assert from "node:assert/strict";
import { test } from "node:test";

import {
  CHI2_95_2D,
  errorEllipse,
  footprint,
  headingRad,
  rotate,
  roundStep,
  sigmasM,
  tiltRad,
} from "../../../client/dashboard/js/base/geometry.js";

const near = (actual, expected, tolerance = 1e-12) =>
  assert.ok(Math.abs(actual - expected) <= tolerance, `${actual} is not ${expected}`);

/** The 21 numbers of a covariance with this position block and nothing else. */
function positionCovariance({ xx, xy = 0, xz = 0, yy, yz = 0, zz = 0 }) {
  const entries = new Array(21).fill(0);
  [entries[0], entries[1], entries[2], entries[6], entries[7], entries[11]] = [xx, xy, xz, yy, yz, zz];
  return entries;
}

/** Rotation about a unit axis. */
function turn(axis, rad) {
  const s = Math.sin(rad / 2);
  return { x: axis.x * s, y: axis.y * s, z: axis.z * s, w: Math.cos(rad / 2) };
}

/** Area of a polygon, negative for clockwise corners. */
function area(points) {
  return points.reduce((sum, p, i) => {
    const q = points[(i + 1) % points.length];
    return sum + (p.x * q.y - q.x * p.y) / 2;
  }, 0);
}

test("a rotation by 90° about z maps x to y", () => {
  const turned = rotate(turn({ x: 0, y: 0, z: 1 }, Math.PI / 2), { x: 1, y: 0, z: 0 });
  near(turned.x, 0, 1e-15);
  near(turned.y, 1);
  near(turned.z, 0);
});

test("heading and tilt follow from the rotation", () => {
  near(headingRad(turn({ x: 0, y: 0, z: 1 }, 2.5)), 2.5);
  near(headingRad(turn({ x: 0, y: 0, z: 1 }, -0.5)), -0.5);
  near(tiltRad(turn({ x: 1, y: 0, z: 0 }, 0.3)), 0.3, 1e-9);
  near(tiltRad(turn({ x: 0, y: 0, z: 1 }, 1.9)), 0);
});

test("semi-axes of an axis-aligned ellipse follow from the standard deviations", () => {
  const ellipse = errorEllipse(positionCovariance({ xx: 4e-6, yy: 1e-6 }));
  near(ellipse.majorM, Math.sqrt(CHI2_95_2D) * 2e-3);
  near(ellipse.minorM, Math.sqrt(CHI2_95_2D) * 1e-3);
  near(ellipse.angleRad, 0);
  near(Math.abs(errorEllipse(positionCovariance({ xx: 1e-6, yy: 4e-6 })).angleRad), Math.PI / 2);
});

test("a rotated ellipse is recovered from its covariance", () => {
  const angle = 0.7;
  const [major, minor] = [9e-6, 1e-6];
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  const ellipse = errorEllipse(
    positionCovariance({
      xx: major * c * c + minor * s * s,
      xy: (major - minor) * c * s,
      yy: major * s * s + minor * c * c,
    }),
  );
  near(ellipse.angleRad, angle);
  near(ellipse.majorM, Math.sqrt(CHI2_95_2D * major));
  near(ellipse.minorM, Math.sqrt(CHI2_95_2D * minor));
});

test("the ellipse contains 95 % of random points", () => {
  // Deterministic normal numbers: a linear congruential generator and Box-Muller.
  let seed = 12345;
  const uniform = () => (seed = (seed * 1664525 + 1013904223) % 2 ** 32) / 2 ** 32;
  const normal = () => Math.sqrt(-2 * Math.log(1 - uniform())) * Math.cos(2 * Math.PI * uniform());
  // Σ = L Lᵀ with L = [[2, 0], [1.5, 1]] mm
  const ellipse = errorEllipse(positionCovariance({ xx: 4e-6, xy: 3e-6, yy: 3.25e-6 }));
  const [c, s] = [Math.cos(ellipse.angleRad), Math.sin(ellipse.angleRad)];
  let inside = 0;
  for (let i = 0; i < 20_000; i += 1) {
    const [a, b] = [normal(), normal()];
    const [x, y] = [2e-3 * a, 1.5e-3 * a + 1e-3 * b];
    const along = (c * x + s * y) / ellipse.majorM;
    const across = (c * y - s * x) / ellipse.minorM;
    if (along * along + across * across <= 1) inside += 1;
  }
  near(inside / 20_000, 0.95, 0.01);
});

test("an invalid covariance gives an ellipse of size 0 and not NaN", () => {
  const ellipse = errorEllipse(positionCovariance({ xx: -1, yy: -2 }));
  assert.equal(ellipse.majorM, 0);
  assert.equal(ellipse.minorM, 0);
  assert.deepEqual(sigmasM(positionCovariance({ xx: -1, yy: 4, zz: 9 })), { x: 0, y: 2, z: 3 });
});

const PINHOLE = { lens: "plumb_bob", fxPx: 500, fyPx: 500, cxPx: 499.5, cyPx: 249.5 };
const IMAGE = { width: 1000, height: 500 };
/** Looks straight down: the camera's z is the world's -z, its x the world's x. */
const DOWN = { position: { x: 1, y: 2, z: 4 }, orientation: { x: 1, y: 0, z: 0, w: 0 } };

test("a camera that looks straight down sees a rectangle below it", () => {
  const outline = footprint(DOWN, PINHOLE, IMAGE);
  assert.equal(outline.length, 4);
  const corners = outline.map(({ x, y }) => [x, y].map((v) => Math.round(v * 1e9) / 1e9).join(" ")).sort();
  // Half widths 500 / 500 · 4 m and 250 / 500 · 4 m.
  assert.deepEqual(corners, ["-3 0", "-3 4", "5 0", "5 4"].sort());
  near(area(outline), 32, 1e-9);
});

test("the footprint on a higher floor is smaller", () => {
  near(area(footprint(DOWN, PINHOLE, IMAGE, 2)), 8, 1e-9);
});

test("a camera that looks level sees the floor up to the drawn depth", () => {
  // Forward is world x, the image's down is world -z.
  const level = {
    position: { x: 0, y: 0, z: 1 },
    orientation: { x: -0.5, y: 0.5, z: -0.5, w: 0.5 },
  };
  const forward = rotate(level.orientation, { x: 0, y: 0, z: 1 });
  near(forward.x, 1);
  const outline = footprint(level, PINHOLE, IMAGE, 0, 10);
  assert.equal(outline.length, 4);
  // The lower edge of the view meets the floor 1 m below after 1 / 0.5 m.
  near(Math.min(...outline.map((p) => p.x)), 2, 1e-9);
  near(Math.max(...outline.map((p) => p.x)), 10, 1e-9);
  assert.ok(area(outline) > 0, "counter-clockwise");
});

test("a camera that looks up sees no floor", () => {
  const up = { position: { x: 0, y: 0, z: 1 }, orientation: { x: 0, y: 0, z: 0, w: 1 } };
  assert.deepEqual(footprint(up, PINHOLE, IMAGE), []);
});

test("a fisheye lens sees more than a pinhole of the same focal length", () => {
  const pinhole = area(footprint(DOWN, PINHOLE, IMAGE));
  const fisheye = area(footprint(DOWN, { ...PINHOLE, lens: "equidistant" }, IMAGE));
  assert.ok(fisheye > 1.5 * pinhole, `${fisheye} against ${pinhole}`);
});

test("grid steps are 1, 2 or 5 times a power of ten", () => {
  const pairs = [[1, 1], [1.9, 1], [2, 2], [4.99, 2], [5, 5], [99, 50], [0.2, 0.2], [0.07, 0.05]];
  for (const [limit, step] of pairs) near(roundStep(limit), step);
});
