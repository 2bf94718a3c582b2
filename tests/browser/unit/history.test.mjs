/** History of the last minute. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { FRAME_MS, History, HISTORY_MS } from "../../../client/dashboard/js/state/history.js";
import { ObjectState } from "../../../client/dashboard/js/state/object-state.js";

const START_MS = 1_700_000_000_000;

/** State at a time in seconds of a robot that drives on a circle with a radius of 1 m at 1 m/s. */
function circling(id, seconds, more = {}) {
  const [s, c] = [Math.sin(seconds), Math.cos(seconds)];
  return new ObjectState({
    id,
    name: id === 7 ? "Forklift" : "",
    stage: "tracked",
    positionM: { x: c, y: s, z: 0.3 },
    orientation: { x: 0, y: 0, z: 0, w: 1 },
    yawObserved: id === 7,
    isHeadingAmbiguous: false,
    velocityMS: { x: -s, y: c, z: 0 },
    covariance: Array.from({ length: 21 }, (_, i) => ([0, 6, 11].includes(i) ? 4e-6 : 0)),
    cameras: ["north", "south"],
    ageMs: 20,
    residual: 1,
    roundel: "robot",
    code: null,
    ...more,
  });
}

/** A history filled with snapshots at 60 Hz. */
function filled(seconds, ids = [3, 7]) {
  const history = new History();
  for (let i = 0; i <= seconds * 60; i += 1) {
    history.take(START_MS + (i * 1000) / 60, ids.map((id) => circling(id, i / 60)));
  }
  return history;
}

test("positions between two frames are interpolated, with all other values", () => {
  const history = filled(12);
  for (const second of [2.03, 5.47, 11.96]) {
    const states = history.at(START_MS + second * 1000);
    assert.deepEqual(states.map((state) => state.id), [3, 7]);
    const { positionM, label, cameras, sigmaM, headingRad, ageMs } = states[1];
    const off = Math.hypot(positionM.x - Math.cos(second), positionM.y - Math.sin(second));
    assert.ok(off < 1e-5, `${off} m off`);
    assert.equal(label, "Forklift");
    assert.deepEqual(cameras, ["north", "south"]);
    assert.ok(Math.abs(sigmaM.x - 2e-3) < 1e-8);
    assert.equal(headingRad, 0);
    assert.ok(Math.abs(ageMs - 20) < 1e-3);
    assert.equal(states[0].headingRad, null);
  }
});

test("the history holds one minute, also if objects come and go", () => {
  const history = filled(75);
  assert.ok(Math.abs(history.newestMs - history.oldestMs - HISTORY_MS) <= FRAME_MS);
  assert.deepEqual(history.at(history.oldestMs - 1), []);
  // Each object exists in one frame only; earlier identities are removed.
  let now = history.newestMs;
  for (let id = 100; id < 3000; id += 1) history.take((now += FRAME_MS), [circling(id, 0)]);
  assert.ok(history.identities.size < 1000, `${history.identities.size} names are stored`);
  assert.equal(history.at(now)[0].id, 2999);
});

test("unknown values stay unknown, and a long gap has no objects", () => {
  const history = new History();
  const unknown = { positionM: null, velocityMS: null, orientation: null, covariance: null, ageMs: null, residual: null, stage: "lost" };
  history.take(START_MS, [circling(9, 0), circling(2, 0, unknown)]);
  history.take(START_MS + 100, [circling(9, 0.1, { velocityMS: null })]);
  const [two, nine] = history.at(START_MS + 50);
  for (const [key, value] of Object.entries(unknown)) assert.equal(two[key], value, key);
  assert.ok(Math.abs(nine.positionM.y - Math.sin(0.1) / 2) < 1e-6, "a straight line without both velocities");
  history.take(START_MS + 10_000, [circling(9, 10)]);
  assert.equal(history.at(START_MS + 2000).length, 1, "the last frame is valid for a while");
  assert.deepEqual(history.at(START_MS + 5000), []);
  assert.equal(history.one(9, START_MS + 5000), null);
  assert.ok(Math.abs(history.one(9, START_MS + 50).positionM.y - Math.sin(0.1) / 2) < 1e-6);
  assert.equal(history.at(START_MS + 10_000).length, 1);
});

test("consecutive trails visit the same frames, from old to new", () => {
  const history = filled(10);
  const trail = (stride) => {
    const times = [];
    history.trace(7, START_MS + 4000, START_MS + 9000, stride, (timeMs, x, y) => {
      const second = (timeMs - START_MS) / 1000;
      assert.ok(Math.hypot(x - Math.cos(second), y - Math.sin(second)) < 1e-6);
      times.push(timeMs);
    });
    return times;
  };
  const all = trail(1);
  assert.ok(Math.abs(all.length - 50) <= 1);
  assert.deepEqual(all, [...all].sort((a, b) => a - b));
  const third = trail(3);
  history.take(history.newestMs + FRAME_MS, [circling(7, 10.1)]);
  assert.deepEqual(trail(3), third);
  assert.ok(third.every((timeMs) => all.includes(timeMs)));
});

test("states of an object can be limited to those after a time", () => {
  const history = new History();
  for (let i = 0; i < 20; i += 1) history.take(START_MS + i * FRAME_MS, [circling(7, i / 10)]);
  const newer = history.of(7, START_MS + 16 * FRAME_MS);
  assert.deepEqual(newer.map(({ timeMs }) => timeMs - START_MS), [1700, 1800, 1900]);
  assert.equal(history.of(7).length, 20);
  assert.equal(history.of(7, START_MS + 19 * FRAME_MS).length, 0);
});
