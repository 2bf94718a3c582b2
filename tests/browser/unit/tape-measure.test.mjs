/** The tape measure. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { ObjectState } from "../../../client/dashboard/js/state/object-state.js";
import { TapeMeasure } from "../../../client/dashboard/js/arena/top/tape-measure.js";
import { Track } from "../../../client/dashboard/js/state/track.js";

const object = (id, x, y, z) =>
  Track.of(
    new ObjectState({
      id, name: id === 2 ? "lift" : "", stage: "tracked", positionM: { x, y, z }, orientation: null, yawObserved: false, isHeadingAmbiguous: false,
      velocityMS: null, covariance: null, cameras: [], ageMs: 0, residual: 1, roundel: "", code: null,
    }),
  );
const tracks = () => new Map([[1, object(1, 0, 0, 0.3)], [2, object(2, 3, 4, 0.3)], [3, object(3, 3, 4, 1.3)]]);

test("a measurement between two objects moves with them", () => {
  const tape = new TapeMeasure();
  tape.take(true, 1);
  assert.equal(tape.words(tracks()), "Measure: from 1 to …");
  tape.reach(2);
  assert.equal(tape.words(tracks()), "1 to lift: 5.000 m");
  const moved = tracks().set(2, object(2, 0, 1, 0.3));
  assert.equal(tape.words(moved), "1 to lift: 1.000 m");
  tape.reach(3);
  assert.match(tape.words(tracks()), /^1 to 3: 5\.099 m \(5\.000 m horizontal\)$/);
});

test("clicks set the start, the end, and a new start", () => {
  const tape = new TapeMeasure();
  tape.take(true, null);
  assert.match(tape.words(tracks()), /click the start point/);
  tape.set({ id: null, x: 1, y: 1 });
  tape.pointer = [1, 2.5];
  assert.equal(tape.words(tracks()), "(1.00, 1.00) to pointer: 1.500 m");
  tape.set({ id: 1 });
  assert.equal(tape.words(tracks()), "(1.00, 1.00) to 1: 1.414 m");
  tape.set({ id: 2 });
  assert.equal(tape.ends.length, 1);
});

test("nothing is measured to an object that is gone", () => {
  const tape = new TapeMeasure();
  tape.take(true, 1);
  tape.reach(9);
  assert.equal(tape.places(tracks()), null);
  assert.match(tape.words(tracks()), /^Measure: from 1/);
  tape.take(false, 1);
  assert.equal(tape.words(tracks()), "");
});
