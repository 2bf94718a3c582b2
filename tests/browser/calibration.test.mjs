/** Dialog of the arena calibration, with a mock server that advances by one step with each poll. */

import assert from "node:assert/strict";
import { after, before, describe, test } from "node:test";

import { Calibrator } from "./calibrator.mjs";
import { assertAccessible, launch, visit } from "./harness.mjs";
import { startMock } from "./mock.mjs";
import { World } from "./world.mjs";

let browser;
before(async () => {
  browser = await launch();
});
after(() => browser?.close());

/** Opens the page and the dialog. */
async function withCalibrator(options, body, context = {}) {
  const world = new World();
  const calibrator = new Calibrator(world.cameras().map((camera) => camera.name), options);
  const server = await startMock({ world, calibrator });
  try {
    await visit(browser, server.url, context, async (page) => {
      await page.locator("#calibrate").click();
      await page.locator("#calibration[open]").waitFor();
      await body(page, calibrator, server);
    });
  } finally {
    await server.close();
  }
}

const words = (page, text) => page.locator("#calibration-words", { hasText: text }).waitFor();

describe("the arena calibration", () => {
  test("records, shows missing overlaps, solves, and is applied", async () => {
    await withCalibrator({}, async (page, calibrator) => {
      await words(page, "The cameras use their configured poses.");
      await page.locator("#calibration-seconds").fill("30");
      await page.getByLabel("Also refine lenses").check();
      calibrator.isHeld = true;
      await page.locator("#calibration-start").click();
      await words(page, "Recording, 0 of 30 s");
      assert.equal(await page.locator("#calibration-form").isVisible(), false);
      await page.locator("#calibration-results tr.bad", { hasText: "none yet" }).waitFor();
      calibrator.stage = "solving";
      await words(page, "Calculating");
      calibrator.isHeld = false;
      await words(page, "Finished. Applied as version 1.");
      const { method, body } = calibrator.asked.find((asked) => asked.method === "POST");
      assert.deepEqual([method, body], ["POST", { seconds: 30, refine_lenses: true }]);
      const rows = await page.locator("#calibration-results tbody tr").allTextContents();
      assert.equal(rows.length, 4);
      assert.match(rows[0], /was unknown/);
      assert.match(rows[1], /12\.3 mm, 0\.0573°.*0\.42 mm/);
      await page.locator(".findings li", { hasText: "weakly constrained" }).waitFor();
      assert.equal(await page.locator("#calibration-apply").isVisible(), false);
      assert.equal(await page.locator("#calibration-start").textContent(), "Calibrate again");
    });
  });

  test("is applied only on request if there is a severe finding", async () => {
    await withCalibrator({ isSevere: true }, async (page, calibrator) => {
      await page.locator("#calibration-start").click();
      await words(page, "Finished, but not applied");
      await page.locator(".findings .grave", { hasText: "Severe: Reference 2 appears 50.1 mm" }).waitFor();
      assert.equal(calibrator.version, 0);
      await page.locator("#calibration-apply").click();
      await words(page, "Applied as version 1.");
      assert.equal(await page.locator("#calibration-apply").isVisible(), false);
    });
  });

  test("can be cancelled, and its result is shown later", async () => {
    await withCalibrator({}, async (page, calibrator) => {
      calibrator.isHeld = true;
      await page.locator("#calibration-start").click();
      await words(page, "Recording");
      await page.locator("#calibration-cancel").click();
      await words(page, "No result.");
      await page.locator("#calibration-trouble", { hasText: "Cancelled." }).waitFor();
      assert.equal(calibrator.stage, "failed");
      await page.keyboard.press("Escape");
      await page.locator("#calibration:not([open])").waitFor({ state: "attached" });
      await page.locator("#calibrate").click();
      await words(page, "No result.");
    });
  });

  test("shows the server's message if it refuses", async () => {
    const refuses = "the configuration has 0 reference roundels";
    await withCalibrator({ refuses }, async (page) => {
      await page.locator("#calibration-start").click();
      await page.locator("#calibration-trouble", { hasText: refuses }).waitFor();
      assert.equal(await page.locator("#calibration-form").isVisible(), true);
    });
  });

  test("says if the server does not respond", async () => {
    await withCalibrator({}, async (page, _, server) => {
      await words(page, "The cameras use their configured poses.");
      await server.close();
      await page.locator("#calibration-start").click();
      await page.locator("#calibration-trouble", { hasText: "No response from the server" }).waitFor();
    });
  });

  for (const context of [{ colorScheme: "light" }, { colorScheme: "dark", viewport: { width: 390, height: 844 } }]) {
    test(`axe finds nothing serious with ${JSON.stringify(context)}`, async () => {
      await withCalibrator(
        { isSevere: true },
        async (page) => {
          await page.locator("#calibration-start").click();
          await page.locator(".findings .grave").waitFor();
          await assertAccessible(page, "#calibration");
          const wide = await page.evaluate(() => document.documentElement.scrollWidth > innerWidth);
          assert.equal(wide, false, "scrolls sideways");
          if (process.env.SHOTS) await page.screenshot({ path: `${process.env.SHOTS}-${context.colorScheme}.png` });
        },
        context,
      );
    });
  }
});
