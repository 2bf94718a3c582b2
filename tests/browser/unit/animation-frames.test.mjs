/** Sharing of animation frames between quick and slow actions. */

import assert from "node:assert/strict";
import { afterEach, test } from "node:test";

import { inOwnFrame, throttle } from "../../../client/dashboard/js/base/dom.js";

/** @type {(() => void)[]} */
const requested = [];
globalThis.requestAnimationFrame = (callback) => requested.push(callback);
const frame = () => requested.splice(0).forEach((callback) => callback());

afterEach(() => {
  while (requested.length > 0) frame();
});

test("quick actions share a frame, and each slow one has its own", () => {
  const ran = [];
  const quick = ["a", "b"].map((name) => throttle(0, () => ran.push(name)));
  inOwnFrame(() => ran.push("slow 1"));
  inOwnFrame(() => ran.push("slow 2"));
  for (const request of quick) request();
  frame();
  const first = ran.splice(0);
  frame();
  const second = ran.splice(0);
  frame();
  assert.deepEqual([first, second, ran].map((names) => names.join()).sort(), ["a,b", "slow 1", "slow 2"]);
  assert.equal(requested.length, 0);
});

test("slow actions run although every frame has quick ones", () => {
  let [quickRuns, slowRuns] = [0, 0];
  const quick = throttle(0, () => (quickRuns += 1));
  const slow = Array.from({ length: 4 }, () => () => (slowRuns += 1));
  for (let i = 0; i < 80; i += 1) {
    quick();
    slow.forEach(inOwnFrame);
    frame();
  }
  assert.equal(quickRuns, 40);
  assert.equal(slowRuns, 40);
});

test("a slow action that is requested again before it has run runs once", () => {
  let runs = 0;
  const slow = () => (runs += 1);
  for (let i = 0; i < 100; i += 1) inOwnFrame(slow);
  for (let i = 0; i < 100; i += 1) frame();
  assert.equal(runs, 1);
});
