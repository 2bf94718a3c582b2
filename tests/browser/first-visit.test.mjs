/**
 * A first-time visitor finds three answers by visible text: which camera has a problem and why, where robot 7 was ten
 * seconds ago, and how accurate its position is. These tests use only texts and roles, no element ids.
 */

import assert from "node:assert/strict";
import { after, before, describe, test } from "node:test";

import { launch, target, visit } from "./harness.mjs";

const PHONE = { viewport: { width: 390, height: 844 }, hasTouch: true, isMobile: true };

let server;
let browser;
before(async () => {
  server = await target();
  browser = await launch();
});
after(async () => {
  await browser?.close();
  await server?.close();
});

const asVisitor = (options, body) => visit(browser, server.url, options, body);

for (const [where, options] of Object.entries({ "on a desk": {}, "on a phone": PHONE })) {
  describe(`a first-time visitor finds, ${where},`, () => {
    test("which camera has a problem and why", async () => {
      await asVisitor(options, async (page) => {
        server.world?.failCamera("north-west", "no frame has come for 5 s: is its cable plugged in?");
        const summary = page.getByRole("button", { name: server.world ? /1 camera failed/ : /cameras? (OK|failed|not in use|degraded)/i });
        await summary.waitFor();
        await summary.click();
        const table = page.getByRole("table").filter({ hasText: "Problem" });
        await table.waitFor();
        const row = table.locator("tbody tr").first();
        await row.waitFor();
        const first = await row.innerText();
        // Cameras with problems come first.
        if (!/OK/.test(await summary.innerText())) assert.match(first, /\S+\s+.*[a-z]{4,}.*\./s);
        if (server.world) {
          assert.match(first, /is its cable plugged in/);
          server.world.restoreCamera("north-west");
        }
      });
    });

    test("where robot 7 was ten seconds ago, and how accurate its position is now", async () => {
      await asVisitor(options, async (page) => {
        await page.getByPlaceholder("Number or name").fill("robot 7");
        await page.keyboard.press("Enter");
        const panel = page.getByRole("region", { name: /7/ });
        await panel.getByText(/^Accuracy [\d.]+ mm.* \(95 %\), seen by/).waitFor();
        const row = panel.getByRole("row", { name: /10 s ago/ });
        await row.waitFor();
        // The page's own history is long enough ten seconds after it was opened.
        await page.waitForFunction(
          () => [...document.querySelectorAll("tr")].some((one) => /10 s ago/.test(one.innerText) && /\d\.\d{3}.*\d\.\d{3}/s.test(one.innerText)),
        );
        assert.match(await row.innerText(), /10 s ago m(\s+\u2212?\d+\.\d{3}){3}/);
      });
    });
  });
}
