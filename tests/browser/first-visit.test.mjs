/**
 * Somebody who has never seen the page finds, by what it says alone, which camera is unwell and why, where robot 7 was ten
 * seconds ago, and how precise it is now. Nothing is looked for here that a person does not see: words, and what words
 * are beside it.
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

const asStranger = (options, body) => visit(browser, server.url, options, body);

for (const [where, options] of Object.entries({ "on a desk": {}, "on a phone": PHONE })) {
  describe(`a stranger finds, ${where}`, () => {
    test("which camera is unwell and why", async () => {
      await asStranger(options, async (page) => {
        server.world?.failCamera("north-west", "no frame has come for 5 s: is its cable plugged in?");
        const said = page.getByRole("button", { name: server.world ? /\d of \d cameras unwell/ : /cameras? (un)?well/ });
        await said.waitFor();
        await said.click();
        const table = page.getByRole("table").filter({ hasText: "What is the matter" });
        await table.waitFor();
        const row = table.locator("tbody tr").first();
        await row.waitFor();
        const first = await row.innerText();
        // Cameras with problems come first.
        if (/unwell/.test(await said.innerText())) assert.match(first, /\S+\s+.*[a-z]{4,}.*\./s);
        if (server.world) {
          assert.match(first, /is its cable plugged in/);
          server.world.restoreCamera("north-west");
        }
      });
    });

    test("where robot 7 was ten seconds ago, and how precise it is now", async () => {
      await asStranger(options, async (page) => {
        await page.getByPlaceholder("Number or name").fill("robot 7");
        await page.keyboard.press("Enter");
        const panel = page.getByRole("region", { name: /7/ });
        await panel.getByText(/^Known to [\d.]+ mm.* \(95 %\), seen by/).waitFor();
        const row = panel.getByRole("row", { name: /10 s ago/ });
        await row.waitFor();
        // The page remembers what it has seen itself: ten seconds after it was opened it can tell.
        await page.waitForFunction(
          () => [...document.querySelectorAll("tr")].some((one) => /10 s ago/.test(one.innerText) && /\d\.\d{3}.*\d\.\d{3}/s.test(one.innerText)),
        );
        assert.match(await row.innerText(), /10 s ago m(\s+\u2212?\d+\.\d{3}){3}/);
      });
    });
  });
}
