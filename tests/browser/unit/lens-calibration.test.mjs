/** Texts and drawing of the lens calibration. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { zonesOf } from "../../../client/dashboard/js/panels/calibration/lens-preview.js";
import { canFinish, isRunning, missingText, parameterCells, progressOf, reportText, sizeOf, stageText, subjectOf } from "../../../client/dashboard/js/panels/calibration/lens-text.js";

const LENS = {
  stage: "gathering",
  camera: "north",
  source: "",
  board: "7 x 5 roundels of 30 mm, 36 mm from centre to centre",
  width: 1280,
  height: 720,
  frames: 12,
  taken: 4,
  enough: 20,
  least: 5,
  most: 40,
  newest: "the board is moving: hold it still for a moment",
  newest_taken: false,
  coverage: { columns: 3, rows: 3, zones: [0, 5, 0, 9, 40, 3, 4, 0, 0], visited_from: 4, share: 4 / 9 },
  outlines: [],
  outline: [],
  missing: ["the board in the top left corner of the picture"],
  left_out: "",
  error: "",
  report: null,
  can_apply: true,
  applied: "",
};

test("the text describes each stage", () => {
  assert.equal(stageText(LENS), "4 views of 20, 44 % of the picture covered. The board is moving: hold it still for a moment.");
  assert.equal(stageText({ ...LENS, frames: 0 }), "Waiting for the first picture.");
  assert.match(stageText({ ...LENS, stage: "idle" }), /^Print the board/);
  assert.equal(stageText({ ...LENS, stage: "done" }), "Finished. Not assigned to a camera yet.");
  assert.equal(stageText({ ...LENS, stage: "done", applied: "north.lens-1.yaml" }), "Finished. Saved as north.lens-1.yaml and used by camera north.");
  assert.equal(stageText({ ...LENS, stage: "done", camera: "", applied: "x.lens-1.yaml" }), "Finished. Saved as x.lens-1.yaml.");
  assert.deepEqual(["idle", "gathering", "solving", "done", "failed"].map((stage) => isRunning({ ...LENS, stage })), [false, true, true, false, false]);
  assert.equal(subjectOf({ ...LENS, camera: "", source: "sim:" }), "sim:");
});

test("missing views are listed, and limit the progress", () => {
  assert.deepEqual(missingText(LENS), ["The board in the top left corner of the picture."]);
  assert.deepEqual(missingText({ ...LENS, missing: [] }), ["Good coverage; add a few more views."]);
  assert.deepEqual(missingText({ ...LENS, missing: [], taken: 20 }), []);
  assert.deepEqual(missingText({ ...LENS, stage: "done" }), []);
  assert.equal(progressOf(LENS), 0.2);
  assert.equal(progressOf({ ...LENS, taken: 30 }), 0.95);
  assert.equal(progressOf({ ...LENS, taken: 30, missing: [] }), 1);
  assert.deepEqual([4, 5].map((taken) => canFinish({ ...LENS, taken })), [false, true]);
  assert.equal(canFinish({ ...LENS, taken: 9, stage: "solving" }), false);
});

test("parameters are rounded by their deviations", () => {
  assert.deepEqual(parameterCells({ name: "fx", value: 912.04567, deviation: 0.0451, unit: "px" }), ["912.046 px", "± 0.045 px"]);
  assert.deepEqual(parameterCells({ name: "k1", value: -0.14012, deviation: 0.00021, unit: "" }), ["−0.14012", "± 0.00021"]);
  assert.deepEqual(parameterCells({ name: "fx", value: 912.4, deviation: 23, unit: "px" }), ["912 px", "± 23 px"]);
  const report = { distortion_model: "plumb_bob", parameters: [], rms_px: 0.0312, views: 19, views_left_out: 1, outliers: 0, width_warning: "" };
  assert.equal(reportText(report), "plumb_bob, from 19 views, 1 excluded as inconsistent; rms reprojection error 0.031 px.");
  const off = reportText({ ...report, width_warning: "the roundels appear 30.58 mm wide, not 30.00" });
  assert.ok(off.endsWith("0.031 px. The roundels appear 30.58 mm wide, not 30.00."), off);
});

test("zones are thirds of the picture, and are covered from a number of roundels on", () => {
  const zones = zonesOf(LENS);
  assert.deepEqual(zones.map((zone) => zone.isDone), [false, true, false, true, true, false, true, false, false]);
  const { left, top, width, height } = zones[5];
  [left - 2560 / 3, top - 240, width - 1280 / 3, height - 240].forEach((off) => assert.ok(Math.abs(off) < 1e-9));
  assert.deepEqual(zonesOf({ ...LENS, coverage: { ...LENS.coverage, zones: [] } }), []);
});

test("a size is two numbers", () => {
  for (const text of ["1920x1080", " 1920 x 1080 ", "1920×1080", "1920X1080"]) assert.deepEqual(sizeOf(text), { width: 1920, height: 1080 });
  for (const text of ["", "1920", "1920x", "x1080", "1920x1080x3", "-1x5", "1e3x5"]) assert.equal(sizeOf(text), null);
});
