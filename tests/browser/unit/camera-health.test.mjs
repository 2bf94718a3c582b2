/** Which cameras are unwell, and why. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { cameraProblems, Latencies, groupProblems, healthSummary, FrameCounters } from "../../../client/dashboard/js/state/camera-health.js";
import { readCameras } from "../../../client/dashboard/js/wire/messages.js";

const POSE = { position: { x: 0, y: 0, z: 5 }, orientation: { x: 1, y: 0, z: 0, w: 0 } };

/** A camera that is well but for what is said. */
function camera(more = {}) {
  const well = { name: "north", status: "running", pose: POSE, frames: 100, rate_hz: 30, latency_ms: 25, blur_px: 0.7 };
  return readCameras([{ ...well, ...more }])[0];
}

const words = (more, shares = null) => cameraProblems(camera(more), shares).map(({ why }) => why).join(" ");

test("one that is well has no complaint", () => {
  assert.deepEqual(cameraProblems(camera(), { dropped: 0.05, broken: 0, missing: 0 }), []);
  const agreed = { state: "agrees", position_error_m: 0.001, rotation_error_rad: 0.0001 };
  assert.deepEqual(cameraProblems(camera({ agreement: agreed, clock: { offset_ms: 30, deviation_ms: 0.1 } }), null), []);
});

test("a severe problem is shown alone", () => {
  for (const [more, expected] of [
    [{ status: "failed", error: "no route to host" }, /^No route to host\. It is retried automatically\.$/],
    [{ status: "failed" }, /The source gave no reason\./],
    [{ status: "finished" }, /no more frames/],
    [{ status: "starting", error: "waiting for a sender" }, /^Waiting for a sender\.$/],
    [{ pose: null, pose_reason: "it sees two of three references" }, /^Its place is not known: it sees two of three references\. What it sees is not used/],
    [{ link: { sender: "node", connected: false } }, /not connected/],
    [{ rate_hz: 0 }, /^No frames come\.$/],
  ]) {
    const found = cameraProblems(camera({ ...more, blur_px: 5, rate_reason: "gives 3 frames a second" }), null);
    assert.equal(found.length, 1, JSON.stringify(more));
    assert.equal(found[0].isSevere, true);
    assert.match(found[0].why, expected);
  }
});

test("other problems are all shown", () => {
  assert.match(words({ rate_reason: "gives 12.0 frames a second, not 30" }), /^It gives 12\.0 frames a second, not 30\.$/);
  assert.match(words({ agreement: { state: "suspected", position_error_m: 0.021, rotation_error_rad: 0.0175 } }), /moved by 21 mm and 1\.00°/);
  assert.match(words({ agreement: { state: "quarantined" } }), /bumped/);
  assert.match(words({ clock: { offset_ms: 1, deviation_ms: 7.25 } }), /known to 7\.3 ms only/);
  assert.match(words({ latency_ms: 400 }), /400 ms late/);
  assert.match(words({ blur_px: 3.2 }), /blurred by 3\.2 px/);
  const lost = words({}, { dropped: 0.41, broken: 0.1, missing: 0.05 });
  assert.match(lost, /41 % of its frames are left out.*10 % of its frames arrive broken.*5 % of its frames are lost on the way/);
});

test("shares are of the last ten seconds, and restart with the server", () => {
  const frameCounters = new FrameCounters();
  const counts = (frames, dropped) => [camera({ frames, dropped })];
  frameCounters.take(counts(1000, 500), 0);
  assert.equal(frameCounters.shares("north"), null, "nothing is said of one message");
  for (let second = 1; second <= 20; second += 1) frameCounters.take(counts(1000 + 30 * second, 500 + (second > 10 ? 10 * (second - 10) : 0)), second * 1000);
  assert.ok(Math.abs(frameCounters.shares("north").dropped - 0.25) < 0.01, `${frameCounters.shares("north").dropped}`);
  frameCounters.take(counts(30, 0), 21_000);
  assert.equal(frameCounters.shares("north"), null);
  frameCounters.take([], 22_000);
  assert.equal(frameCounters.counts.size, 0);
});

test("lateness has quantiles and a histogram of the newest ones", () => {
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

test("all cameras make one sentence", () => {
  assert.equal(healthSummary(0, 0), "No cameras");
  assert.equal(healthSummary(1, 0), "Camera well");
  assert.equal(healthSummary(16, 0), "All 16 cameras well");
  assert.equal(healthSummary(16, 2), "2 of 16 cameras unwell");
});

test("who ails from the same is named together, with how much from least to most", () => {
  const ill = (name, why, isSevere = false) => ({ name, problems: [{ isSevere, why }] });
  assert.deepEqual(
    groupProblems([
      ill("a", "39 % of its frames are left out."),
      ill("b", "It gives nothing.", true),
      ill("c", "35 % of its frames are left out."),
      ill("d", "9.5 % of its frames are left out."),
    ]),
    [
      { names: ["a", "c", "d"], why: "9.5 to 39 % of its frames are left out.", isSevere: false },
      { names: ["b"], why: "It gives nothing.", isSevere: true },
    ],
  );
  // Numbers that are part of an address, a file or a device are no amounts.
  for (const [one, other] of [["No route to host 10.0.0.4.", "No route to host 10.0.0.5."], ["/dev/video0 is gone.", "/dev/video1 is gone."], ["http://cam:81/a fails.", "http://cam:82/a fails."]]) {
    assert.equal(groupProblems([ill("a", one), ill("b", other)]).length, 2, one);
  }
});
