/** How the stream fares, told the time. */

import assert from "node:assert/strict";
import { describe, test } from "node:test";

import { Gauge } from "../../../client/dashboard/js/state/stream-statistics.js";

const snapshot = (more = {}) => ({ sequence: 1, sourceId: "a", poseTimeMs: 0, latencyMs: 20, objects: [], missed: 0, ...more });

describe("the gauge", () => {
  test("knows nothing before anything has come", () => {
    const gauge = new Gauge();
    gauge.begin(1000);
    assert.deepEqual(gauge.report(1200), { rateHz: null, ageMs: null, receivedAtMs: null, missed: 0, latenciesMs: [] });
  });

  test("counts the snapshots of the last two seconds", () => {
    const gauge = new Gauge();
    gauge.begin(0);
    for (let ms = 0; ms < 5000; ms += 20) gauge.take(snapshot(), ms);
    assert.ok(Math.abs(gauge.report(5000).rateHz - 50) < 1);
    assert.equal(gauge.report(9000).rateHz, 0, "none have come for so long");
  });

  test("begins to count anew with a connection", () => {
    const gauge = new Gauge();
    gauge.begin(0);
    for (let ms = 0; ms < 3000; ms += 20) gauge.take(snapshot(), ms);
    gauge.begin(3000);
    assert.equal(gauge.report(3100).rateHz, null);
    assert.equal(gauge.report(4000).rateHz, 0);
  });

  test("adds what has passed since to how late the newest snapshot was", () => {
    const gauge = new Gauge();
    gauge.take(snapshot({ latencyMs: 25 }), 100);
    assert.equal(gauge.report(140).ageMs, 65);
    assert.equal(gauge.report(1140).ageMs, 1065);
  });

  test("reports each lateness once, and none where the server gave none", () => {
    const gauge = new Gauge();
    gauge.take(snapshot({ latencyMs: 5 }), 0);
    gauge.take(snapshot({ latencyMs: null }), 10);
    gauge.take(snapshot({ latencyMs: 7 }), 20);
    assert.deepEqual(gauge.report(30).latenciesMs, [5, 7]);
    assert.deepEqual(gauge.report(40).latenciesMs, []);
  });

  test("adds up what was missed, of one run of the server", () => {
    const gauge = new Gauge();
    gauge.take(snapshot({ missed: 2 }), 0);
    gauge.take(snapshot({ missed: 3 }), 10);
    assert.equal(gauge.report(20).missed, 5);
    gauge.take(snapshot({ sourceId: "b", missed: 1 }), 30);
    assert.equal(gauge.report(40).missed, 1);
  });
});
