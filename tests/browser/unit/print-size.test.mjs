/** Words for the measured size of prints. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { printSizeText } from "../../../client/dashboard/js/state/print-size.js";

const text = (state, factor, deviation) => printSizeText({ roundel: "robot", state, factor, deviation, cameras: [] });

test("the size of prints is described with its remedy", () => {
  assert.equal(text("exact", 1, 0), "As configured; not measured");
  assert.match(text("assumed", 1, 0.015), /^Not measured yet \(± 1\.50 %\): two cameras must see/);
  assert.equal(text("measured", 0.9995, 0.0003), "As configured (± 0.03 %)");
  assert.equal(text("measured", 0.97, 0.0003), "3.0 % smaller than configured (± 0.03 %); positions are corrected. Printed with “fit to page”?");
  assert.equal(text("measured", 1.02, 0.0003), "2.0 % larger than configured (± 0.03 %); positions are corrected");
  assert.match(text("contradicted", 0.76, 0.001), /^24\.0 % smaller than configured: correct its diameters/);
});
