/** The API page in headless Chromium, with the real server at ROUNDEL_URL. */

import assert from "node:assert/strict";
import { after, before, test } from "node:test";

import { launch } from "./harness.mjs";

const url = process.env.ROUNDEL_URL;
const skip = url ? false : "ROUNDEL_URL is not set";
let browser;

before(async () => {
  if (url) browser = await launch();
});
after(async () => {
  await browser?.close();
});

test("shows every call of the description, and sends trial requests", { skip }, async () => {
  const context = await browser.newContext();
  const page = await context.newPage();
  const complaints = [];
  page.on("console", (message) => {
    if (message.type() === "error" || message.type() === "warning") complaints.push(message.text());
  });
  page.on("pageerror", (error) => complaints.push(String(error)));
  await page.goto(new URL("/api", url).href);
  await page.locator("#calls details").first().waitFor();

  const described = await (await fetch(new URL("/openapi.json", url))).json();
  const expected = Object.entries(described.paths).flatMap(([path, calls]) => Object.keys(calls).map((method) => `${method} ${path}`));
  const shown = await page.locator("#calls details").evaluateAll((all) => all.map((one) => `${one.dataset.method} ${one.dataset.path}`));
  assert.deepEqual(shown.sort(), expected.sort());

  const call = page.locator('#calls details[data-path="/api/v1/snapshot"]');
  await call.locator("summary").click();
  await call.locator('input[name="ids"]').fill("1");
  await call.getByRole("button", { name: "Try it" }).click();
  await call.locator("pre", { hasText: "pose_time_ns" }).waitFor();
  assert.match(await call.locator("pre").textContent(), /^200 /);
  await call.locator('input[name="horizon_ms"]').fill("-1");
  await call.getByRole("button", { name: "Try it" }).click();
  await call.locator("pre", { hasText: "horizon_ms: expected milliseconds" }).waitFor();

  await call.getByRole("link", { name: "Snapshot" }).click();
  await page.locator("#shape-Snapshot[open] code", { hasText: /^missed$/ }).waitFor();
  // The browser logs the provoked error 400. A violated security policy would be another entry.
  assert.ok(complaints.every((text) => text.includes("400")), complaints.join("\n"));
  await context.close();
});
