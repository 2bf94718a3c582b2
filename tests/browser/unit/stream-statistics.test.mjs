/** Statistics of the stream. */

import assert from "node:assert/strict";
import { describe, test } from "node:test";

import { StreamStatistics } from "../../../client/dashboard/js/state/stream-statistics.js";

const snapshot = (more = {}) => ({ sequence: 1, sourceId: "a", poseTimeMs: 0, latencyMs: 20, objects: [], missed: 0, ...more });

describe("the statistics", () => {
  test("are unknown before the first snapshot", () => {
    const statistics = new StreamStatistics();
    statistics.begin(1000);
    assert.deepEqual(statistics.report(1200), { rateHz: null, ageMs: null, receivedAtMs: null, missed: 0, latenciesMs: [] });
  });

  test("have the rate of the last two seconds", () => {
    const statistics = new StreamStatistics();
    statistics.begin(0);
    for (let ms = 0; ms < 5000; ms += 20) statistics.take(snapshot(), ms);
    assert.ok(Math.abs(statistics.report(5000).rateHz - 50) < 1);
    assert.equal(statistics.report(9000).rateHz, 0, "no snapshots in the last two seconds");
  });

  test("restart the rate with a connection", () => {
    const statistics = new StreamStatistics();
    statistics.begin(0);
    for (let ms = 0; ms < 3000; ms += 20) statistics.take(snapshot(), ms);
    statistics.begin(3000);
    assert.equal(statistics.report(3100).rateHz, null);
    assert.equal(statistics.report(4000).rateHz, 0);
  });

  test("add the time since the arrival to the latency", () => {
    const statistics = new StreamStatistics();
    statistics.take(snapshot({ latencyMs: 25 }), 100);
    assert.equal(statistics.report(140).ageMs, 65);
    assert.equal(statistics.report(1140).ageMs, 1065);
  });

  test("report each known latency once", () => {
    const statistics = new StreamStatistics();
    statistics.take(snapshot({ latencyMs: 5 }), 0);
    statistics.take(snapshot({ latencyMs: null }), 10);
    statistics.take(snapshot({ latencyMs: 7 }), 20);
    assert.deepEqual(statistics.report(30).latenciesMs, [5, 7]);
    assert.deepEqual(statistics.report(40).latenciesMs, []);
  });

  test("sum the missed snapshots of one run of the server", () => {
    const statistics = new StreamStatistics();
    statistics.take(snapshot({ missed: 2 }), 0);
    statistics.take(snapshot({ missed: 3 }), 10);
    assert.equal(statistics.report(20).missed, 5);
    statistics.take(snapshot({ sourceId: "b", missed: 1 }), 30);
    assert.equal(statistics.report(40).missed, 1);
  });
});
