/** Detection of camera problems. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { cameraProblems, Latencies, groupProblems, healthSummary, FrameCounters } from "../../../client/dashboard/js/state/camera-health.js";
import { readCameras } from "../../../client/dashboard/js/wire/messages.js";

const POSE = { position: { x: 0, y: 0, z: 5 }, orientation: { x: 1, y: 0, z: 0, w: 0 } };

/** A healthy camera with some changed fields. */
function camera(more = {}) {
  const well = { name: "north", status: "running", pose: POSE, frames: 100, rate_hz: 30, latency_ms: 25, blur_px: 0.7 };
  return readCameras([{ ...well, ...more }])[0];
}

const words = (more, shares = null) => cameraProblems(camera(more), shares).map(({ why }) => why).join(" ");

test("a healthy camera has no problems", () => {
  assert.deepEqual(cameraProblems(camera(), { dropped: 0.05, broken: 0, missing: 0 }), []);
  const agreed = { state: "agrees", position_error_m: 0.001, rotation_error_rad: 0.0001 };
  assert.deepEqual(cameraProblems(camera({ agreement: agreed, clock: { offset_ms: 30, deviation_ms: 0.1 } }), null), []);
});

test("a severe problem is shown alone", () => {
  for (const [more, expected] of [
    [{ status: "failed", error: "no route to host" }, /^No route to host\. Retrying automatically\.$/],
    [{ status: "failed" }, /The source failed without a message\./],
    [{ status: "finished" }, /no more frames/],
    [{ status: "starting", error: "waiting for a sender" }, /^Waiting for a sender\.$/],
    [{ pose: null, pose_reason: "it sees two of three references" }, /^Pose unknown: it sees two of three references\. Its detections are not used\.$/],
    [{ link: { sender: "node", connected: false } }, /No sender is connected/],
    [{ rate_hz: 0 }, /^No frames are arriving\.$/],
  ]) {
    const found = cameraProblems(camera({ ...more, blur_px: 5, rate_reason: "delivers 3 frames a second" }), null);
    assert.equal(found.length, 1, JSON.stringify(more));
    assert.equal(found[0].isSevere, true);
    assert.match(found[0].why, expected);
  }
});

test("other problems are all shown", () => {
  assert.match(words({ rate_reason: "delivers 12.0 frames a second where 30.0 were promised" }), /^It delivers 12\.0 frames a second where 30\.0 were promised\.$/);
  assert.match(words({ agreement: { state: "suspected", position_error_m: 0.021, rotation_error_rad: 0.0175 } }), /moved by 21 mm and 1\.00°/);
  assert.match(words({ agreement: { state: "quarantined" } }), /bumped/);
  assert.match(words({ clock: { offset_ms: 1, deviation_ms: 7.25 } }), /known only to 7\.3 ms/);
  assert.match(words({ latency_ms: 400 }), /400 ms late/);
  assert.match(words({ blur_px: 3.2 }), /blurred by 3\.2 px/);
  const lost = words({}, { dropped: 0.41, broken: 0.1, missing: 0.05 });
  assert.match(lost, /Dropping 41 % of frames: this computer is too slow\. 10 % of frames arrive broken.*5 % of frames are lost between sender and server/);
});

test("shares cover the last ten seconds, and restart with the server", () => {
  const frameCounters = new FrameCounters();
  const counts = (frames, dropped) => [camera({ frames, dropped })];
  frameCounters.take(counts(1000, 500), 0);
  assert.equal(frameCounters.shares("north"), null, "one message is not enough");
  for (let second = 1; second <= 20; second += 1) frameCounters.take(counts(1000 + 30 * second, 500 + (second > 10 ? 10 * (second - 10) : 0)), second * 1000);
  assert.ok(Math.abs(frameCounters.shares("north").dropped - 0.25) < 0.01, `${frameCounters.shares("north").dropped}`);
  frameCounters.take(counts(30, 0), 21_000);
  assert.equal(frameCounters.shares("north"), null);
  frameCounters.take([], 22_000);
  assert.equal(frameCounters.counts.size, 0);
});

test("quantiles and histogram cover the newest latencies", () => {
  const latencies = new Latencies();
  assert.deepEqual(latencies.quantiles([0.5]), [null]);
  for (let i = 0; i < 5000; i += 1) latencies.take(1000);
  for (let i = 0; i < 3600; i += 1) latencies.take(20 + (i % 10));
  assert.deepEqual(latencies.quantiles([0, 0.5, 0.999]), [20, 25, 29]);
  const { stepMs, shares } = latencies.histogram(24);
  assert.equal(stepMs, 2);
  assert.ok(Math.abs(shares.reduce((sum, share) => sum + share, 0) - 1) < 1e-9);
  assert.ok(Math.abs(shares[10] - 0.2) < 1e-9 && shares[9] === 0);
});

test("the summary counts failed, unused and degraded cameras", () => {
  const health = (more) => ({ camera: camera(more), problems: cameraProblems(camera(more), null) });
  const [ok, failed, unused, degraded] = [health({}), health({ status: "failed" }), health({ pose: null }), health({ blur_px: 5 })];
  assert.equal(healthSummary([]), "No cameras");
  assert.equal(healthSummary([ok]), "Camera OK");
  assert.equal(healthSummary(Array(16).fill(ok)), "All 16 cameras OK");
  assert.equal(healthSummary([ok, failed]), "1 camera failed");
  assert.equal(healthSummary([failed, degraded, degraded, degraded]), "1 camera failed, 3 degraded");
  assert.equal(healthSummary([degraded, unused, unused]), "2 cameras not in use, 1 degraded");
});

test("cameras with the same problem are grouped, with ranges of the numbers", () => {
  const ill = (name, why, isSevere = false) => ({ name, problems: [{ isSevere, why }] });
  assert.deepEqual(
    groupProblems([
      ill("a", "Dropping 39 % of frames: this computer is too slow."),
      ill("b", "No frames are arriving.", true),
      ill("c", "Dropping 35 % of frames: this computer is too slow."),
      ill("d", "Dropping 9.5 % of frames: this computer is too slow."),
    ]),
    [
      { names: ["a", "c", "d"], why: "Dropping 9.5–39 % of frames: this computer is too slow.", isSevere: false },
      { names: ["b"], why: "No frames are arriving.", isSevere: true },
    ],
  );
  // Numbers in addresses, files and devices are not quantities.
  for (const [one, other] of [["No route to host 10.0.0.4.", "No route to host 10.0.0.5."], ["/dev/video0 is gone.", "/dev/video1 is gone."], ["http://cam:81/a fails.", "http://cam:82/a fails."]]) {
    assert.equal(groupProblems([ill("a", one), ill("b", other)]).length, 2, one);
  }
});
