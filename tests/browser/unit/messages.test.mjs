/** Conversion of the server's JSON, valid and invalid, and formatting of values. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { degrees, duration, fixed, significant, whole } from "../../../client/dashboard/js/base/format.js";
import { readCameras, readEvent, readInfo, readSnapshot } from "../../../client/dashboard/js/wire/messages.js";
import { sourceTestText } from "../../../client/dashboard/js/panels/cameras/source-test.js";

const SNAPSHOT = {
  sequence: 7,
  source_id: "a",
  pose_time_ns: "1700000000123456789",
  capture_time_ns: "1700000000100000000",
  fused_time_ns: "1700000000120000000",
  sent_time_ns: "1700000000125500000",
  missed: 2,
  objects: [
    {
      object_id: 3,
      name: "",
      stage: "tracked",
      position: { x: 1, y: 2, z: 0.3 },
      orientation: { x: 0, y: 0, z: 2, w: 0 },
      yaw_observed: false,
      velocity: { x: 0.3, y: 0.4, z: 0 },
      covariance: Array.from({ length: 21 }, (_, i) => ([0, 6, 11, 15, 18, 20].includes(i) ? 1e-6 : 0)),
      cameras: ["north"],
      observation_age_ns: "31500000",
      residual: 1.1,
      roundel: "robot",
    },
  ],
};

test("the capture clock of a camera is null if the server does not send it", () => {
  const [camera, older] = readCameras([
    { name: "north", broken: 3, capture_clock: { base: "arrival", deviation_ms: 50 } },
    { name: "south" },
  ]);
  assert.deepEqual(camera.captureClock, { base: "arrival", deviationMs: 50 });
  assert.equal(camera.broken, 3);
  assert.equal(older.captureClock, null);
  assert.equal(older.broken, 0);
});

test("a snapshot's times are exact to a microsecond", () => {
  const snapshot = readSnapshot(SNAPSHOT);
  assert.equal(snapshot.poseTimeMs, 1700000000123.456);
  assert.equal(snapshot.latencyMs, 25.5);
  assert.equal(snapshot.missed, 2);
});

test("an object's values are converted to the page's units", () => {
  const [state] = readSnapshot(SNAPSHOT).objects;
  assert.equal(state.label, "3");
  assert.equal(state.ageMs, 31.5);
  assert.equal(state.speedMS, 0.5);
  assert.equal(state.headingRad, null, "no heading without an observed yaw");
  assert.equal(state.tiltRad, 0, "the quaternion is normalized first");
  assert.deepEqual(state.sigmaM, { x: 0.001, y: 0.001, z: 0.001 });
});

test("an object has a heading if its yaw is observed", () => {
  const object = { ...SNAPSHOT.objects[0], yaw_observed: true, orientation: { x: 0, y: 0, z: 1, w: 1 } };
  const [state] = readSnapshot({ ...SNAPSHOT, objects: [object] }).objects;
  assert.ok(Math.abs(state.headingRad - Math.PI / 2) < 1e-12);
  assert.equal(state.isHeadingAmbiguous, false);
});

test("a yaw symmetry of 2 makes the heading ambiguous", () => {
  const object = { ...SNAPSHOT.objects[0], yaw_observed: true, yaw_symmetry: 2 };
  assert.equal(readSnapshot({ ...SNAPSHOT, objects: [object] }).objects[0].isHeadingAmbiguous, true);
});

test("an object has a code once it is read", () => {
  const read = (code) => readSnapshot({ ...SNAPSHOT, objects: [{ ...SNAPSHOT.objects[0], code }] }).objects[0].code;
  assert.deepEqual(read({ bits: 8, number: 12 }), { bits: 8, number: 12 });
  for (const none of [null, undefined, {}, { bits: 0, number: 0 }, "12"]) assert.equal(read(none), null);
});

test("there is no latency before the first observation", () => {
  assert.equal(readSnapshot({ ...SNAPSHOT, capture_time_ns: "0" }).latencyMs, null);
});

test("missing and invalid values become null or empty, never NaN", () => {
  const odd = [
    {},
    null,
    { object_id: 1, stage: "hibernating", position: { x: 1, y: null, z: 3 } },
    { object_id: 2, orientation: { x: 0, y: 0, z: 0, w: 0 }, covariance: [1, 2], velocity: "fast" },
    { object_id: 3, covariance: new Array(21).fill(null), cameras: "north", observation_age_ns: 12 },
  ];
  const { objects } = readSnapshot({ objects: odd, pose_time_ns: "soon" });
  assert.equal(objects.length, odd.length);
  for (const state of objects) {
    assert.equal(state.stage, "unspecified");
    assert.equal(state.positionM, null);
    assert.equal(state.ellipse, null);
    assert.deepEqual(state.cameras, []);
    assert.doesNotMatch(JSON.stringify(state), /NaN|undefined/);
  }
  assert.deepEqual(readSnapshot(null).objects, []);
  assert.deepEqual(readCameras("none"), []);
});

test("a camera has a link if a program feeds it", () => {
  const link = { sender: "node robot7", address: "10.0.0.3:4711", connected: true, received: 5, missing: 2, round_trip_ms: 0.8 };
  const links = readCameras([{ link }, { link: null }, {}]).map((camera) => camera.link);
  assert.deepEqual(links, [
    { sender: "node robot7", address: "10.0.0.3:4711", connected: true, missing: 2, roundTripMs: 0.8 },
    null,
    null,
  ]);
});

test("the result of a source test is described in a sentence", () => {
  const trial = { error: "", width: 1280, height: 720, frames: 60, broken: 2, rate_hz: 29.97, promised_rate_hz: 30, roundels: 1, decode_ms: 3.1, detect_ms: 0.4 };
  assert.equal(
    sourceTestText(trial),
    "1\u2009280 × 720 pixels, 30.0 frames per second (30.0 promised); one roundel in the newest frame. 2 arrived broken. Decoding takes 3.1 ms, detection 0.4 ms.",
  );
  assert.equal(sourceTestText({ ...trial, frames: 0 }), "");
});

test("a camera without pose and lens is accepted", () => {
  const [camera] = readCameras([{ name: "north", status: "dreaming", pose: null, intrinsics: { fx_px: 0 } }]);
  assert.equal(camera.status, "unspecified");
  assert.equal(camera.pose, null);
  assert.equal(camera.intrinsics, null);
  assert.equal(camera.rateHz, 0);
});

test("a clock with exact time stamps is null", () => {
  const clocks = [{ offset_ms: -1.5, skew_ppm: 20, deviation_ms: 0.05 }, { offset_ms: 0, deviation_ms: 0 }, null];
  const read = readCameras(clocks.map((clock) => ({ clock }))).map((camera) => camera.clock);
  assert.deepEqual(read, [{ offsetMs: -1.5, skewPpm: 20, deviationMs: 0.05 }, null, null]);
});

test("a blur of 0 is unknown", () => {
  const blurs = readCameras([{ blur_px: 0.72 }, { blur_px: 0 }, {}]).map((camera) => camera.blurPx);
  assert.deepEqual(blurs, [0.72, null, null]);
});

test("a reprojection error of 0 is unknown", () => {
  const errors = readCameras([{ reprojection_px: 0.21 }, { reprojection_px: 0 }, {}]).map((camera) => camera.reprojectionPx);
  assert.deepEqual(errors, [0.21, null, null]);
});

test("events and server info are converted", () => {
  const event = readEvent({ sequence: 4, time_ns: "1700000000000000000", kind: "object_lost", object_id: 9, message: "gone" });
  assert.deepEqual(event, { sequence: 4, timeMs: 1.7e12, kind: "object_lost", objectId: 9, camera: "", message: "gone" });
  assert.equal(readInfo({ name: "lab", started_time_ns: "1700000000000000000" }).startedTimeMs, 1.7e12);
});

test("numbers are formatted for display", () => {
  assert.equal(fixed(-1.25, 1), "\u22121.3");
  assert.equal(fixed(-0.0001, 2), "0.00");
  assert.equal(fixed(null, 2), "–");
  assert.equal(fixed(Number.NaN, 2), "–");
  assert.equal(whole(1234567), "1\u2009234\u2009567");
  assert.equal(whole(999), "999");
  assert.equal(significant(12.345), "12.3");
  assert.equal(significant(0.5), "0.50");
  assert.equal(degrees(Math.PI / 2), "90.0°");
  assert.equal(degrees(null), "–");
  assert.deepEqual(
    [41.4, 3210, 12_000, 300_000, 7.2e6].map(duration),
    ["41 ms", "3.2 s", "12 s", "5 min", "2.0 h"],
  );
});
