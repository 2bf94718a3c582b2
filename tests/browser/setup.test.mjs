/** Form that tests, adds, changes and removes cameras, with the mock server. */

import assert from "node:assert/strict";
import { after, before, describe, test } from "node:test";

import { assertAccessible, launch, visit } from "./harness.mjs";
import { startMock } from "./mock.mjs";
import { MockConfiguration } from "./mock-configuration.mjs";
import { World } from "./world.mjs";

let browser;
before(async () => {
  browser = await launch();
});
after(() => browser?.close());

/** @param {object} options of the configuration @param {(page: import("playwright-core").Page, configuration: MockConfiguration) => Promise<void>} body */
async function withConfiguration(options, body, context = {}) {
  const world = new World();
  const configuration = new MockConfiguration(world, options);
  const server = await startMock({ world, configuration });
  try {
    await visit(browser, server.url, context, (page) => body(page, configuration));
  } finally {
    await server.close();
  }
}

async function openNew(page) {
  await page.locator("#add-camera").click();
  await page.locator("#setup[open]").waitFor();
}

async function openOf(page, name) {
  await page.getByRole("button", { name: `Edit camera ${name}` }).click();
  await page.locator("#setup-title", { hasText: `Camera ${name}` }).waitFor();
  await page.locator("#setup-remove").waitFor();
}

const closed = (page) => page.locator("#setup:not([open])").waitFor({ state: "attached" });
const trouble = (page, field, text) => page.locator(`#setup-${field}-trouble`, { hasText: text }).waitFor();
const answered = (configuration, method) => configuration.asked.filter((asked) => asked.method === method).at(-1);

describe("the camera form", () => {
  test("tests a source, and shows the result or the error", async () => {
    await withConfiguration({}, async (page, configuration) => {
      await openNew(page);
      await page.locator("#setup-try").click();
      await trouble(page, "source", "Enter the source first.");
      await page.locator("#setup-source").fill("http://10.0.0.2/stream");
      await page.locator("#setup-try").click();
      await page.locator("#setup-words", { hasText: "640 × 480 pixels, 25.0 frames per second (30.0 promised); 3 roundels" }).waitFor();
      assert.equal(await page.locator("#setup-source-trouble").isVisible(), false);
      await page.locator("#setup-source").fill("http://closed/stream");
      await page.locator("#setup-try").click();
      await trouble(page, "source", "connection refused: is the camera on?");
      await page.locator("#setup-source").fill("10.0.0.2");
      await page.locator("#setup-try").click();
      await trouble(page, "source", "expected a URL, found \"10.0.0.2\"");
      assert.equal(await page.locator("#setup-source").getAttribute("aria-invalid"), "true");
      assert.deepEqual(answered(configuration, "POST").body, { source: "10.0.0.2" });
    });
  });

  test("adds a camera with an unknown pose, after errors at its fields are corrected", async () => {
    await withConfiguration({}, async (page, configuration) => {
      await openNew(page);
      await page.locator("#setup-save").click();
      await trouble(page, "name", "missing key");
      await page.locator("#setup-name").fill("south-west");
      await page.locator("#setup-source").fill("v4l2:/dev/video0");
      await page.locator("#setup-save").click();
      await trouble(page, "name", "give each camera its own name");
      await page.locator("#setup-name").fill("door");
      await page.locator("#setup-save").click();
      await trouble(page, "calibration", "missing key");
      assert.equal(await page.locator("#setup-name-trouble").isVisible(), false, "a corrected field has no error");
      await page.locator("#setup-calibration").fill("door.yaml");
      await page.locator("#setup summary").click();
      await page.locator("#setup-rate_hz").fill("-1");
      await page.locator("#setup-save").click();
      await trouble(page, "rate_hz", "must be a number above 0");
      await page.locator("#setup-rate_hz").fill("30");
      await page.locator("#setup-save").click();
      await closed(page);
      assert.deepEqual(answered(configuration, "POST").body, {
        name: "door",
        source: "v4l2:/dev/video0",
        calibration: "door.yaml",
        pose: { unknown: true },
        rate_hz: 30,
      });
      await page.locator('[data-camera-card="door"]').waitFor();
      await page.locator("#event-rows", { hasText: "Camera door was added; saved in lab.toml." }).waitFor();
    });
  });

  test("adds a camera with a measured pose", async () => {
    await withConfiguration({}, async (page, configuration) => {
      await openNew(page);
      await page.locator("#setup-name").fill("top");
      await page.locator("#setup-source").fill("push:");
      await page.locator("#setup-calibration").fill("top.yaml");
      await page.getByLabel("As measured").check();
      await page.locator("#setup-save").click();
      await trouble(page, "pose", "Enter all numbers");
      for (const [axis, value] of [["at-x", "1"], ["at-y", "2"], ["at-z", "4"], ["to-x", "1"], ["to-y", "2"], ["to-z", "4"]]) {
        await page.locator(`#setup-${axis}`).fill(value);
      }
      await page.locator("#setup-save").click();
      await trouble(page, "pose", "a point other than its own position");
      await page.locator("#setup-to-z").fill("0");
      await page.locator("#setup-save").click();
      await closed(page);
      const { pose } = answered(configuration, "POST").body;
      // Straight down: x to the right, y up in the picture.
      assert.deepEqual(pose, { pose: { position: { x: 1, y: 2, z: 4 }, orientation: { x: 1, y: 0, z: 0, w: 0 } } });
    });
  });

  test("sends only changed fields", async () => {
    await withConfiguration({}, async (page, configuration) => {
      await openOf(page, "north-west");
      assert.equal(await page.locator("#setup-source").inputValue(), "sim:?seed=1&camera=2");
      assert.equal(await page.getByLabel("As measured").isChecked(), true);
      assert.equal(await page.locator("#setup-to-z").inputValue(), "0");
      await page.locator("#setup-name").fill("window");
      await page.locator("#setup-save").click();
      await closed(page);
      assert.deepEqual(answered(configuration, "PATCH"), { method: "PATCH", path: "/cameras/north-west", body: { name: "window" } });
      await page.locator('[data-camera-card="window"]').waitFor();
      await page.locator('[data-camera-card="north-west"]').waitFor({ state: "detached" });
      await openOf(page, "window");
      await page.locator("#setup-at-z").fill("4.5");
      await page.locator("#setup-calibration").fill("");
      await page.locator("#setup-save").click();
      await closed(page);
      const { body } = answered(configuration, "PATCH");
      assert.deepEqual(Object.keys(body).sort(), ["calibration", "pose"]);
      assert.equal(body.calibration, null);
      assert.equal(body.pose.pose.position.z, 4.5);
    });
  });

  test("removes a camera after a second click, and asks again the next time", async () => {
    await withConfiguration({}, async (page, configuration) => {
      await openOf(page, "south-east");
      await page.locator("#setup-remove").click();
      await page.locator("#setup-remove", { hasText: "Remove south-east" }).waitFor();
      assert.equal(answered(configuration, "DELETE"), undefined);
      await page.locator("#setup .icon-button").click();
      await openOf(page, "south-east");
      assert.equal(await page.locator("#setup-remove").textContent(), "Remove…");
      await page.locator("#setup-remove").click();
      await page.locator("#setup-remove").click();
      await closed(page);
      assert.equal(answered(configuration, "DELETE").path, "/cameras/south-east");
      await page.locator('[data-camera-card="south-east"]').waitFor({ state: "detached" });
      await page.locator("#event-rows", { hasText: "Camera south-east was removed" }).waitFor();
    });
  });

  test("shows why the server refuses changes", async () => {
    await withConfiguration({ refuses: "this server is open to a network: `setup = true` under [server] allows it" }, async (page) => {
      await openNew(page);
      await page.locator("#setup-name").fill("door");
      await page.locator("#setup-source").fill("push:");
      await page.locator("#setup-save").click();
      await page.locator("#setup-trouble", { hasText: "open to a network" }).waitFor();
    });
  });

  for (const context of [{}, { colorScheme: "dark", viewport: { width: 390, height: 844 } }]) {
    test(`axe finds nothing serious with ${JSON.stringify(context)}`, async () => {
      await withConfiguration(
        {},
        async (page) => {
          await openNew(page);
          await page.getByLabel("As measured").check();
          await page.locator("#setup summary").click();
          await page.locator("#setup-save").click();
          await trouble(page, "pose", "Enter all");
          await assertAccessible(page, "#setup");
          const { width } = await page.locator("#setup").boundingBox();
          assert.ok(width <= page.viewportSize().width, `${width} px wide`);
        },
        context,
      );
    });
  }
});
