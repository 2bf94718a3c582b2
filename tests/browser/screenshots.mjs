/**
 * Pictures of the page for looking at: `npm run screenshots`, with ROUNDEL_URL for a real server.
 * They land in `screenshots/`, which is not kept in the repository.
 */

import { mkdir } from "node:fs/promises";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

import { launch, openDashboard, target } from "./harness.mjs";

const FOLDER = join(dirname(fileURLToPath(import.meta.url)), "screenshots");
const WIDE = { width: 1440, height: 900 };
const PHONE = { width: 390, height: 844 };

await mkdir(FOLDER, { recursive: true });
const server = await target();
const browser = await launch({ space: true });
const shot = (page, name, options = {}) => page.screenshot({ path: join(FOLDER, `${name}.png`), ...options });

for (const colorScheme of ["light", "dark"]) {
  const { page, context } = await openDashboard(browser, server.url, { viewport: WIDE, colorScheme });
  // Long enough for trails and plots, and to look back.
  await page.waitForTimeout(15_000);
  await shot(page, `wide-${colorScheme}`);
  await page.locator("#object-rows button").nth(6).click();
  await page.waitForTimeout(1500);
  await shot(page, `wide-${colorScheme}-selected`);
  await page.locator("#past").fill("-10");
  await page.waitForTimeout(1000);
  await shot(page, `wide-${colorScheme}-past`);
  await page.locator("#live").click();
  for (const mode of ["space", "health"]) {
    await page.locator(`input[name=mode][value=${mode}]`).check();
    await page.waitForTimeout(2000);
    await shot(page, `wide-${colorScheme}-${mode}`);
  }
  await page.keyboard.press("?");
  await page.waitForTimeout(300);
  await shot(page, `wide-${colorScheme}-help`);
  await context.close();
}

const { page, context } = await openDashboard(browser, server.url, { viewport: PHONE, colorScheme: "light", hasTouch: true });
await page.waitForTimeout(4000);
await shot(page, "phone", { fullPage: true });
await page.locator("#object-rows button").first().click();
await page.waitForTimeout(500);
await page.evaluate(() => scrollTo(0, 0));
await shot(page, "phone-selected");
for (const mode of ["space", "health"]) {
  await page.locator(`input[name=mode][value=${mode}]`).check();
  await page.waitForTimeout(2000);
  await shot(page, `phone-${mode}`);
}
await context.close();

const calibrating = await openDashboard(browser, server.url, { viewport: WIDE, colorScheme: "light" });
await calibrating.page.locator("#calibrate").click();
await calibrating.page.waitForTimeout(500);
await shot(calibrating.page, "wide-light-calibration");
await calibrating.context.close();

const adding = await openDashboard(browser, server.url, { viewport: WIDE, colorScheme: "light" });
await adding.page.locator("#add-camera").click();
await adding.page.locator("#setup-source").fill("v4l2:/dev/video0");
await adding.page.getByLabel("As measured").check();
await adding.page.locator("#setup-save").click();
await adding.page.waitForTimeout(500);
await shot(adding.page, "wide-light-setup");
await adding.context.close();

if (server.world) {
  const troubled = await openDashboard(browser, server.url, { viewport: WIDE, colorScheme: "light" });
  server.world.failCamera("north-west", "the folder frames/north-west has no images; put PNG or JPEG files there");
  await troubled.page.waitForTimeout(2500);
  await shot(troubled.page, "wide-light-camera-failed");
  await server.close();
  await troubled.page.waitForTimeout(2500);
  await shot(troubled.page, "wide-light-lost");
  await troubled.context.close();
}
await browser.close();
if (!server.world) await server.close();
