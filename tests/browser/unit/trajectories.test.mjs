/** Trajectories, gaps and heat maps of the history, and texts about recordings. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { heatOpacity, eachPoint, computeHeatMap, nearestPoint, readTrajectories } from "../../../client/dashboard/js/state/trajectories.js";
import { minutes, size } from "../../../client/dashboard/js/base/format.js";
import { stateText } from "../../../client/dashboard/js/panels/history/recording.js";

const BEGIN_NS = 1_700_000_000_000_000_000n;

/** A response with points [seconds, x, y]. */
function answer(points, rest = {}) {
  const point = ([seconds, x, y]) => ({
    time_ns: String(BEGIN_NS + BigInt(Math.round(seconds * 1000)) * 1_000_000n),
    position: { x, y, z: 0.3 },
    yaw_rad: null,
  });
  return {
    objects: [{ object_id: 7, source_id: "a", name: "", roundel: "robot", code: 0, points: points.map(point), ...rest }],
    step_s: 0.1,
    points: points.length,
    oldest_time_ns: String(BEGIN_NS),
    newest_time_ns: String(BEGIN_NS + 60_000_000_000n),
  };
}

test("a response is converted, without its invalid points", () => {
  const raw = answer([[0, 1, 2], [0.1, 1.5, 2]]);
  raw.objects[0].points.push({ time_ns: "now", position: { x: 1, y: 1, z: 1 } }, { time_ns: "5", position: null });
  const { trajectories, stepS, oldestMs, newestMs } = readTrajectories(raw);
  assert.equal(trajectories.length, 1);
  assert.deepEqual([trajectories[0].label, trajectories[0].count, stepS], ["7", 2, 0.1]);
  assert.deepEqual([...trajectories[0].places.slice(0, 6)].map((one) => Math.round(one * 10)), [10, 20, 3, 15, 20, 3]);
  assert.equal(newestMs - oldestMs, 60_000);
  assert.equal(readTrajectories(answer([], { name: "cart", code: 3 })).trajectories[0].label, "cart");
  assert.equal(readTrajectories(answer([], { code: 3 })).trajectories[0].label, "#3");
  assert.deepEqual(readTrajectories(null), { trajectories: [], points: 0, stepS: 0, oldestMs: null, newestMs: null });
});

test("points are connected except across gaps", () => {
  const { trajectories, stepS } = readTrajectories(answer([[0, 0, 0], [0.1, 1, 0], [0.9, 2, 0], [5, 3, 0], [5.1, 4, 0]]));
  const joined = [];
  eachPoint(trajectories[0], stepS, (_, isJoined) => joined.push(isJoined));
  // Gaps of up to a second are always bridged.
  assert.deepEqual(joined, [false, true, true, false, true]);
});

test("a heat map has the time that each cell was occupied", () => {
  const standing = Array.from({ length: 30 }, (_, i) => [i / 10, 0.5, 0.5]);
  const moving = Array.from({ length: 10 }, (_, i) => [3 + i / 10, 0.5 + i, 4.5]);
  const heat = computeHeatMap(readTrajectories(answer([...standing, ...moving])));
  assert.equal(heat.cellM, 0.2);
  const near = (a, b) => assert.ok(Math.abs(a - b) < 1e-4, `${a} is not ${b}`);
  near(heat.mostS, 3);
  near(heat.seconds.reduce((sum, one) => sum + one, 0), 4);
  near(heat.minX / heat.cellM, Math.round(heat.minX / heat.cellM));
  assert.ok(heat.minX <= 0.5 && heat.minX + heat.columns * heat.cellM > 9.5);
  assert.equal(computeHeatMap(readTrajectories(answer([]))), null);
});

test("a single point gives a heat map of one cell", () => {
  const heat = computeHeatMap(readTrajectories(answer([[0, -1, -1]])));
  assert.deepEqual([heat.columns, heat.rows], [1, 1]);
});

test("briefly occupied cells are visible, and empty ones are not", () => {
  assert.equal(heatOpacity(0, 10), 0);
  assert.ok(heatOpacity(0.001, 10) > 0.1);
  assert.ok(heatOpacity(10, 10) <= 0.8 && heatOpacity(10, 10) > heatOpacity(5, 10));
});

test("the nearest point of a trajectory is found within the limit", () => {
  const trajectories = readTrajectories(answer([[0, 0, 0], [1, 1, 0], [2, 2, 0]]));
  const found = nearestPoint(trajectories, 1.1, 0.1, 0.5);
  assert.equal(found.timeMs, Number(BEGIN_NS / 1_000_000n) + 1000);
  assert.equal(nearestPoint(trajectories, 1.1, 3, 0.5), null);
});

test("sizes and durations have suitable units", () => {
  assert.deepEqual([0, 999, 1000, 12_345, 999_400, 31e9, 2e15].map(size), ["0 B", "999 B", "1.0 kB", "12.3 kB", "999 kB", "31.0 GB", "2000 TB"]);
  assert.deepEqual([0, 7.9, 61, 3599, 3601, 90_061].map(minutes), ["0:00", "0:07", "1:01", "59:59", "1:00:01", "25:01:01"]);
});

const RECORDING = {
  state: "recording", file: "lab-001.mcap", folder: "/r", seconds: 100, bytes: 1e9, files: 1, messages: 10, dropped: 0,
  disk_free_bytes: 36e9, budget_bytes: 20e9, deleted: 0, error: "", frames_every: 0,
};

test("a recording's text has the remaining time and the lost messages", () => {
  const [what, space] = stateText(RECORDING);
  assert.equal(what, "Recording into lab-001.mcap.");
  assert.match(space, /^1:40 so far: 1\.0 GB, 10\.0 MB\/s; 36\.0 GB free on the disk, enough for 60 min\. The oldest .* exceed 20\.0 GB\.$/);
  const troubled = stateText({ ...RECORDING, dropped: 12_000, deleted: 2 }).join(" ");
  assert.match(troubled, /12\u2009000 messages are missing/);
  assert.match(troubled, /2 older files were deleted/);
});

test("a failed recording's text has the reason", () => {
  assert.match(stateText({ ...RECORDING, state: "failed", error: "the disk is full" })[0], /failed: the disk is full/);
  assert.match(stateText({ ...RECORDING, state: "idle", disk_free_bytes: 0 })[0], /shown during a recording/);
});
