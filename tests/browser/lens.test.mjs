/** Dialog of the lens calibration, with the real server, whose camera sees the printed board move. */

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { join } from "node:path";
import { after, before, describe, test } from "node:test";

import { FOCAL_PX, HEIGHT, WIDTH, writeViews } from "./board.mjs";
import { assertAccessible, launch, visit } from "./harness.mjs";
import { BINARY, CONFIG, call, cameraFile, lacking, startLab } from "./lab.mjs";

const PATIENCE_MS = 60_000;
/** Has another focal length, to recognise which lens is in use. */
const ROUGH = cameraFile("bench", [WIDTH, HEIGHT], 500);
const BENCH = `
[[camera]]
name = "bench"
source = "images:board/*.pgm?fps=12&loop=true"
calibration = "bench.yaml"
pose = { position_m = [1.0, 0.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }
`;

describe("the lens calibration", { skip: lacking }, () => {
  let browser;
  let lab;
  before(async () => {
    browser = await launch();
    lab = await startLab(CONFIG + BENCH, { "bench.yaml": ROUGH, prepare: (folder) => writeViews(BINARY, folder) });
  });
  after(async () => {
    await browser?.close();
    await lab?.close();
  });

  /** @param {(page: import("playwright-core").Page) => Promise<void>} body */
  async function withPage(body, options = {}) {
    await visit(browser, lab.url, options, async (page, opened) => {
      page.setDefaultTimeout(PATIENCE_MS);
      await body(page);
      // The browser logs the responses with errors that the tests provoke.
      const complaints = opened.complaints.filter((it) => !it.startsWith("Failed to load resource"));
      assert.deepEqual([complaints, opened.foreign], [[], []]);
    });
  }

  const words = (page, text) => page.locator("#lens-words", { hasText: text }).waitFor();

  test("runs while the board moves, shows the lens with deviations, and applies it", async () => {
    await withPage(async (page) => {
      await page.getByRole("button", { name: "Calibrate the lens of camera bench" }).click();
      await words(page, "Print the board");
      assert.equal(await page.locator("#lens-figure").isVisible(), false);
      await page.locator("#lens-start").click();
      // The dialog shows the number of views, the missing ones, and the coverage over the picture.
      await words(page, /(^|\D)[1-4] views? of 20/);
      const early = await page.locator("#lens-missing li").allTextContents();
      assert.ok(early.length > 0 && early.every((it) => it.endsWith(".")), early.join());
      await page.waitForFunction(([width]) => /** @type {HTMLImageElement} */ (document.querySelector("#lens-picture")).naturalWidth === width, [WIDTH]);
      const drawn = await page.locator("#lens-coverage").evaluate((canvas) => {
        const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
        return data.filter((_, i) => i % 4 === 3 && data[i] > 0).length;
      });
      assert.ok(drawn > 500, `${drawn} pixels drawn`);
      assert.equal(await page.locator("#lens-form").isVisible(), false);
      // Another camera has to wait, and the error names the busy one.
      const busy = await call(lab, "POST", "lens", { camera: "door" });
      assert.deepEqual([busy.status, /the lens of bench/.test(busy.answer.error.message)], [409, true]);
      await words(page, /1[2-9] views of 20/);
      const later = await page.locator("#lens-missing li").allTextContents();
      assert.ok(!later.includes(early[0]), `${early.join()} and then ${later.join()}`);
      await page.locator("#lens-finish").click();
      await words(page, "Finished. Not assigned to a camera yet.");

      const cells = await page.locator("#lens-results tr", { hasText: "fx" }).locator("td").allTextContents();
      assert.ok(Math.abs(parseFloat(cells[0]) / FOCAL_PX - 1) < 3e-3, cells.join());
      assert.match(cells[1], /^± \d+\.\d+ px$/);
      const [download] = await Promise.all([page.waitForEvent("download"), page.locator("#lens-file").click()]);
      assert.equal(download.suggestedFilename(), "bench.yaml");
      const yaml = await readFile(await download.path(), "utf8");
      assert.match(yaml, /camera_name: "bench"/);

      await page.locator("#lens-apply", { hasText: "Apply to bench" }).click();
      await words(page, "Saved as bench.lens-1.yaml and used by camera bench");
      assert.equal(await page.locator("#lens-apply").isVisible(), false);
      assert.match(await lab.config(), /calibration = "bench\.lens-1\.yaml"/);
      assert.equal(await readFile(join(lab.folder, "bench.lens-1.yaml"), "utf8"), yaml);
      const { answer } = await call(lab, "GET", "cameras/bench");
      assert.ok(Math.abs(answer.intrinsics.fx_px / FOCAL_PX - 1) < 3e-3, JSON.stringify(answer.intrinsics));
      // The dialog of another camera shows no result.
      await page.keyboard.press("Escape");
      await page.getByRole("button", { name: "Calibrate the lens of camera door" }).click();
      await words(page, "Print the board");
      assert.equal(await page.locator("#lens-results").isVisible(), false);
    });
  });

  test("runs for a source that is not a camera yet, and shows errors at their fields", async () => {
    await withPage(async (page) => {
      await page.locator("#add-camera").click();
      await page.locator("#setup-lens").click();
      await page.locator("#setup-source-trouble", { hasText: "Enter the source first." }).waitFor();
      await page.locator("#setup-name").fill("window");
      await page.locator("#setup-source").fill("images:board/*.pgm?fps=25&loop=true");
      await page.locator("#setup-lens").click();
      await page.locator("#lens-title", { hasText: "Lens of window" }).waitFor();
      await page.locator("#lens-board").fill("2x2");
      await page.locator("#lens-start").click();
      await page.locator("#lens-board-trouble", { hasText: "expected a board of 3 to 40" }).waitFor();
      await page.locator("#lens-board").fill("7x5");
      await page.locator("#lens-form summary").click();
      await page.locator("#lens-views").fill("14");
      await page.locator("#lens-size").fill("wide");
      await page.locator("#lens-start").click();
      await page.locator("#lens-size-trouble", { hasText: "such as 1920x1080, found wide" }).waitFor();
      await page.locator("#lens-size").fill("99999x1");
      await page.locator("#lens-start").click();
      await page.locator("#lens-size-trouble", { hasText: "99999 x 1" }).waitFor();
      await page.locator("#lens-size").fill("");
      await page.locator("#lens-start").click();
      // It ends with the requested number of views.
      await words(page, "Finished. Not assigned to a camera yet.");
      await page.locator("#lens-apply", { hasText: "Save next to the configuration" }).click();
      await words(page, "Saved as window.lens-1.yaml");
      await page.locator("#lens .icon-button").click();
      assert.equal(await page.locator("#setup-calibration").inputValue(), "window.lens-1.yaml");
    });
  });

  test("can be cancelled", async () => {
    await withPage(async (page) => {
      await page.getByRole("button", { name: "Calibrate the lens of camera door" }).click();
      await page.locator("#lens-start").click();
      await words(page, "No roundel of the board is visible");
      assert.equal(await page.locator("#lens-finish").isVisible(), false);
      await page.locator("#lens-cancel").click();
      await words(page, "Print the board");
      await page.locator("#lens-start").waitFor();
    });
  });

  for (const context of [{}, { colorScheme: "dark", viewport: { width: 390, height: 844 } }]) {
    test(`axe finds nothing serious with ${JSON.stringify(context)}`, async () => {
      await withPage(async (page) => {
        await page.getByRole("button", { name: "Calibrate the lens of camera bench" }).click();
        await page.locator("#lens-form summary").click();
        assert.equal(await page.locator("#lens-size").isVisible(), false);
        await page.locator("#lens-views").fill("1");
        await page.locator("#lens-start").click();
        await page.locator("#lens-views-trouble", { hasText: "5 to 100" }).waitFor();
        await assertAccessible(page, "#lens");
        const { width } = await page.locator("#lens").boundingBox();
        assert.ok(width <= page.viewportSize().width, `${width} px wide`);
      }, context);
    });
  }
});
