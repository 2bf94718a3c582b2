/** Recordings, replay, history, printing and objects, with the real server (lab.mjs). */

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { join } from "node:path";
import { after, before, describe, test } from "node:test";

import { assertAccessible, assertChanges, canvasSum, launch, visitObjects } from "./harness.mjs";
import { call, lacking, startLab, startReplay } from "./lab.mjs";

/** A phone. */
const PHONE = { viewport: { width: 390, height: 844 }, hasTouch: true };

let browser;
/** @type {Awaited<ReturnType<typeof startLab>>} */
let lab;
before(async () => {
  if (lacking) return;
  [browser, lab] = await Promise.all([launch(), startLab()]);
});
after(async () => {
  await browser?.close();
  await lab?.close();
});

/** @param {string} url @param {(page: import("playwright-core").Page, opened: object) => Promise<void>} body */
function withPage(url, body, options = {}) {
  return visitObjects(browser, url, options, async (page, opened) => {
    await body(page, opened);
    // Expected: responses that the tests provoke.
    const grave = opened.complaints.filter((text) => !/status of (400|404|409|503)/.test(text));
    assert.deepEqual(grave, []);
    assert.deepEqual(opened.foreign, []);
  });
}

const holds = (page, selector, text) => page.locator(selector, { hasText: text }).waitFor();
const closed = (page, dialog) => page.locator(`${dialog}:not([open])`).waitFor({ state: "attached" });

/** Polls the API until a condition holds. */
async function until(wanted, path = "recording", server = lab) {
  for (let turn = 0; turn < 300; turn += 1) {
    const { answer } = await call(server, "GET", path);
    if (wanted(answer)) return answer;
    await new Promise((resolve) => setTimeout(resolve, 100));
  }
  assert.fail(`GET ${path} never met the condition`);
}

describe("recordings", { skip: lacking }, () => {
  test("are started and stopped, shown on every page, and listed", async () => {
    await withPage(lab.url, async (page) => {
      await page.locator("#record").click();
      await holds(page, "#recording-where", "No recordings in");
      await page.locator("#recording-name").fill("a/b");
      await page.locator("#recording-start").click();
      await holds(page, "#recording-name-trouble", "expected a name of letters");
      assert.equal(await page.locator("#recording-name").getAttribute("aria-invalid"), "true");
      await page.locator("#recording-name").fill("trial");
      await page.locator("#recording-seconds").fill("0");
      await page.locator("#recording-start").click();
      await holds(page, "#recording-seconds-trouble", "expected seconds above 0");
      await page.locator("#recording-seconds").fill("");
      await page.locator("#recording-frames_every").fill("5");
      await page.locator("#recording-start").click();
      await holds(page, "#recording-words", /Recording into trial-.*mcap, one in 5 frames as a picture\./);
      await holds(page, "#recording-words", /\/s; .* free on the disk, enough for \d/);
      await holds(page, "#recording-rows", "being written");
      assert.equal((await until((it) => it.messages > 50)).frames_every, 5);
      await page.keyboard.press("Escape");
      await holds(page, "#record", /Recording 0:\d\d/);
      await holds(page, "#event-rows", /Recording into \S*trial-/);
      // Another page shows it and stops it.
      await withPage(lab.url, async (other) => {
        await holds(other, "#record", /Recording \d/);
        await other.locator("#record").click();
        await other.locator("#recording-stop").click();
        await holds(other, "#recording-words", /The last recording, trial-.*mcap, is 0:\d\d long/);
        await other.locator("#recording-start").waitFor();
      });
      await holds(page, "#record", "Record…");
      const { files } = await until(({ files }) => files.length === 1 && !files[0].open, "recordings");
      await page.locator("#record").click();
      await holds(page, "#recording-rows", files[0].name);
    });
  });

  test("stop automatically after the given time", async () => {
    await withPage(lab.url, async (page) => {
      await page.locator("#record").click();
      await page.locator("#recording-seconds").fill("1.5");
      await page.locator("#recording-start").click();
      await holds(page, "#recording-words", "Recording into");
      await holds(page, "#recording-words", /The last recording/);
    });
  });
});

describe("a replay", { skip: lacking }, () => {
  let play;
  before(async () => {
    await call(lab, "POST", "recording", { name: "played", frames_every: 5 });
    await until((it) => it.seconds > 6);
    const { answer } = await call(lab, "DELETE", "recording");
    play = await startReplay(join(answer.folder, answer.file));
  });
  after(() => play?.close());

  test("is marked as a recording, pauses, seeks, changes speed, and loops", async () => {
    await withPage(play.url, async (page) => {
      await holds(page, "#replay", "Recording, not live");
      await holds(page, "#replay-file", "played-");
      await holds(page, "#link-text", /^Replay/);
      for (const control of ["#record", "#add-camera", "#calibrate", "#add-object", "#history-open"]) {
        assert.equal(await page.locator(control).isVisible(), false, control);
      }
      await page.locator("#replay-loop").check();
      await until((it) => it.looping, "replay", play);
      await page.locator("#arena-stage").focus();
      await page.keyboard.press("Space");
      await until((it) => it.paused, "replay", play);
      await holds(page, "#link-text", "Replay paused");
      await page.locator("#replay-position").fill("1");
      const there = await until((it) => Math.abs(it.position_s - 1) < 0.2, "replay", play);
      assert.equal(there.paused, true);
      // The age of replayed data has no meaning.
      assert.equal(await page.locator("#age").textContent(), "–");
      await holds(page, "#replay-time", "0:01 of");
      await page.locator("#replay-speed").selectOption("5");
      await until((it) => it.speed === 5, "replay", play);
      await page.locator("#replay-pause").click();
      await until((it) => !it.paused, "replay", play);
      // After the loop, objects continue although their times have gone back.
      const wrapped = await page.evaluate(async () => {
        const slider = document.querySelector("#replay-position");
        for (let last = 0, turn = 0; turn < 300; turn += 1) {
          if (Number(slider.value) < last - 2) return true;
          last = Number(slider.value);
          await new Promise((resolve) => setTimeout(resolve, 50));
        }
        return false;
      });
      assert.ok(wrapped);
      const before = await page.locator("#object-rows td").first().textContent();
      await page.waitForFunction((was) => document.querySelector("#object-rows td")?.textContent !== was, before);
      await page.locator("[data-camera-card] img.loaded").waitFor();
    });
  });

  test("stops at its end, and can be played again", async () => {
    await call(play, "PATCH", "replay", { looping: false, speed: 100, paused: false });
    await withPage(play.url, async (page) => {
      await holds(page, "#link-text", "Replay ended");
      // A speed that is not in the list is shown as well.
      assert.equal(await page.locator("#replay-speed").inputValue(), "100");
      await page.locator("#replay-speed").selectOption("0.5");
      await page.locator("#replay-pause", { hasText: "Play again" }).click();
      await until((it) => !it.ended && it.position_s < 3, "replay", play);
    });
  });
});

describe("the history", { skip: lacking }, () => {
  test("is drawn as trajectories and as a heat map, for chosen objects and times", async () => {
    await until((it) => it.points > 20, "history");
    await withPage(lab.url, async (page) => {
      const bare = await canvasSum(page, "arena-backdrop");
      await page.locator("#history-open").click();
      await holds(page, "#history-words", /^(\d+|\d+ objects), \d.*points, one every \d+.*Stored:/);
      await assertChanges(page, "arena-backdrop", bare);
      const trajectories = await canvasSum(page, "arena-backdrop");
      await page.locator("label:has(#history-heat)").click();
      await holds(page, "#history-words", /Darkest: .* in a square of 0\.\d+ m/);
      await assertChanges(page, "arena-backdrop", trajectories);
      const row = page.locator("#object-rows tr").first();
      const id = await row.getAttribute("data-object-id");
      await row.locator("button").click();
      await page.waitForFunction((wanted) => document.querySelector("#history-objects").value === wanted, id);
      await page.locator("#history-objects").fill("unknown");
      await page.locator("#history-show").click();
      await holds(page, "#history-words", "No matching object in this period.");
      await page.locator("#history-objects").fill(id);
      await page.locator("#history-from").fill("2020-01-01T00:00:00");
      await page.locator("#history-until").fill("2020-01-01T01:00:00");
      await page.locator("#history-show").click();
      await holds(page, "#history-words", "No matching object in this period. Stored:");
      await page.locator("#history-from").fill("2021-01-01T00:00:00");
      await page.locator("#history-show").click();
      await holds(page, "#history-from-trouble", "expected a time before");
      await page.locator("#history-from").fill("");
      await page.locator("#history-show").click();
      await holds(page, "#history-from-trouble", "Enter a date and time.");
      await page.getByRole("button", { name: "hour", exact: true }).click();
      await holds(page, "#history-words", /Darkest/);
      // The trajectory is now outside the view.
      await page.locator("#arena-stage").focus();
      for (let turn = 0; turn < 12; turn += 1) await page.keyboard.press("ArrowRight");
      await page.locator("#history-within").check();
      await page.locator("#history-show").click();
      await holds(page, "#history-words", "No matching object in this period.");
      await page.locator("#history-close").click();
      assert.equal(await page.locator("#history").isVisible(), false);
      await page.locator("#fit").click();
    });
  });

  test("shows which object passed the pointer, and when", async () => {
    await until((it) => it.points > 20, "history");
    await withPage(lab.url, async (page) => {
      await page.locator("#history-open").click();
      await holds(page, "#history-words", "points, one every");
      // The middle column of the arena crosses the trajectory at a height that depends on the fit.
      const { x, y, width, height } = await page.locator("#arena-stage").boundingBox();
      for (let row = 1; row < 60; row += 1) {
        await page.mouse.move(x + width / 2, y + (height * row) / 60);
        if (/\d+ was here at \d\d:\d\d:\d\d/.test((await page.locator("#arena-caption").textContent()) ?? "")) return;
      }
      assert.fail("no point of the trajectory was found");
    });
  });
});

describe("printing", { skip: lacking }, () => {
  test("has a preview, saves files, and shows errors at their fields", async () => {
    await withPage(lab.url, async (page) => {
      await page.locator("#print-open").click();
      await page.waitForFunction(() => document.querySelector("#print-picture").naturalWidth > 0);
      assert.equal(await page.locator("#print-marker").inputValue(), "160:64");
      await page.locator("#print-page").fill("A9");
      await holds(page, "#print-page-trouble", "A9");
      assert.equal(await page.locator("#print-files").isVisible(), false);
      await page.locator("#print-page").fill("A3");
      await page.locator("#print-kind").selectOption("coded");
      assert.equal(await page.locator("#print-code").inputValue(), "8:2");
      await page.locator("#print-codes > summary", { hasText: "codes with their Hamming distances" }).click();
      assert.match(await page.locator("#print-code-rows tr").first().innerText(), /^1\s+00000001\s+\d\s+\d$/);
      await page.locator("#print-copies").fill("2");
      await page.waitForFunction(() => document.querySelector("#print-png").getAttribute("href").includes("copies=2"));
      assert.equal(await page.locator("#print-png").innerText(), "PNG, page 1");
      await page.locator("#print-ids").fill("1-3");
      await page.waitForFunction(() => document.querySelector("#print-pdf").getAttribute("href").includes("ids=1-3"));
      const [download] = await Promise.all([page.waitForEvent("download"), page.locator("#print-pdf").click()]);
      assert.equal((await readFile(await download.path())).subarray(0, 5).toString(), "%PDF-");
      await page.locator("#print-sheet").fill("99");
      await holds(page, "#print-sheet-trouble", "a page from 1 to");
      await page.locator("#print-sheet").fill("1");
      await page.locator("#print-kind").selectOption("/board");
      await page.waitForFunction(() => document.querySelector("#print-svg").getAttribute("href")?.includes("board=7x5"));
      await page.locator("#print-board").fill("7");
      await holds(page, "#print-board-trouble", /./);
    });
  });
});

describe("objects", { skip: lacking }, () => {
  test("are named, added, changed and removed, also in the configuration", async () => {
    await withPage(lab.url, async (page) => {
      await page.locator('#object-rows tr[data-stage="tracked"] button').first().click();
      await page.locator("#name-object", { hasText: "Name…" }).click();
      await page.locator("#object-save").click();
      await holds(page, "#object-name-trouble", "Enter a name.");
      await page.locator("#object-name").fill("cart");
      await page.locator("#object-save").click();
      await closed(page, "#object");
      await holds(page, "#object-rows", "cart");
      await holds(page, "#name-object", "Set up…");
      assert.match(await lab.config(), /\[\[object\]\]\nname = "cart"/);

      await page.locator("#add-object").click();
      await page.locator("#object-choice option", { hasText: "cart" }).waitFor({ state: "attached" });
      await page.locator("#object-name").fill("cart");
      await page.locator("#object-roundel").selectOption("coded");
      await page.locator("#object-code").fill("3");
      await page.locator("#object-save").click();
      await holds(page, "#object-name-trouble", "cart");
      await page.locator("#object-name").fill("lift");
      await page.locator("#object-code").fill("300");
      await page.locator("#object-save").click();
      await holds(page, "#object-code-trouble", /./);
      await page.locator("#object-code").fill("3");
      await page.locator("#object-offset-z").fill("-0.2");
      await page.locator("#object-save").click();
      await holds(page, "#object-offset_m-trouble", "Enter all three");
      await page.locator("#object-offset-x").fill("0");
      await page.locator("#object-offset-y").fill("0.1");
      await page.locator("#object-save").click();
      await closed(page, "#object");
      assert.match(await lab.config(), /name = "lift"\n(.*\n)*?offset_m = \[0\.0, 0\.1, -0\.2\]/);
      await holds(page, "#event-rows", 'Object "lift" was added');

      await page.locator("#add-object").click();
      await page.locator("#object-choice").selectOption("lift");
      assert.equal(await page.locator("#object-code").inputValue(), "3");
      await page.locator("#object-motion").selectOption("ground");
      await page.locator("#object-offset-x").fill("");
      await page.locator("#object-offset-y").fill("");
      await page.locator("#object-offset-z").fill("");
      await page.locator("#object-save").click();
      await closed(page, "#object");
      const changed = await lab.config();
      assert.match(changed, /motion = "ground"/);
      assert.doesNotMatch(changed, /offset_m/);

      for (const name of ["lift", "cart"]) {
        await page.locator("#add-object").click();
        await page.locator("#object-choice").selectOption(name);
        await page.locator("#object-remove").click();
        await page.locator("#object-remove", { hasText: `Remove ${name}` }).click();
        await closed(page, "#object");
      }
      assert.doesNotMatch(await lab.config(), /\[\[object\]\]/);
      await page.locator("#name-object", { hasText: "Name…" }).waitFor();
    });
  });
});

describe("objects that carry several roundels", { skip: lacking }, () => {
  /** A field in a row of the form. */
  const field = (page, row, name) => page.locator("#object-mounts li").nth(row).getByLabel(name, { exact: true });

  test("are added, changed and removed, with errors at their fields", async () => {
    await withPage(lab.url, async (page) => {
      await page.locator("#add-object").click();
      await page.locator("#object-roundel option", { hasText: "coded" }).waitFor({ state: "attached" });
      await page.locator("#object-name").fill("tall");
      await page.locator("#object-carries").selectOption("several");
      const rows = page.locator("#object-mounts li");
      assert.equal(await rows.count(), 2, "the form starts with two rows");
      for (const [row, x] of [[0, "0.2"], [1, ""]]) {
        await rows.nth(row).locator("select").selectOption("coded");
        await field(page, row, "code").fill("3");
        await field(page, row, "x").fill(x);
        await field(page, row, "y").fill("0");
        await field(page, row, "z").fill("0.1");
      }
      await page.locator("#object-save").click();
      await rows.nth(1).locator(".trouble", { hasText: "Enter the print's centre" }).waitFor();
      assert.equal(await rows.nth(0).locator(".trouble").isVisible(), false);
      assert.equal(await field(page, 1, "x").getAttribute("aria-invalid"), "true");
      await field(page, 1, "x").fill("-0.2");
      await page.locator("#object-save").click();
      await holds(page, "#object-mounts-trouble", 'carries code 3 twice');
      await field(page, 1, "code").fill("4");
      await field(page, 1, "roll").fill("90");
      await field(page, 1, "yaw").fill("90");
      await field(page, 0, "yaw").fill("30");
      await page.locator("#object-save").click();
      await closed(page, "#object");
      const added = await lab.config();
      assert.match(added, /name = "tall"\nroundel = \[/);
      assert.match(added, /code = 3, position_m = \[0\.2, 0\.0, 0\.1\], yaw_deg = 30\.0/);
      assert.match(added, /code = 4, position_m = \[-0\.2, 0\.0, 0\.1\], right = \[0\.0, 1\.0, 0\.0\], top = \[0\.0, 0\.0, 1\.0\]/);

      await page.locator("#add-object").click();
      await page.locator("#object-choice").selectOption("tall");
      assert.equal(await page.locator("#object-one").isVisible(), false);
      const turn = await Promise.all(["roll", "pitch", "yaw"].map((name) => field(page, 1, name).inputValue()));
      assert.deepEqual(turn, ["90", "0", "90"]);
      await page.locator("#object-mount-add").click();
      await field(page, 2, "code").fill("5");
      for (const name of ["x", "y", "z"]) await field(page, 2, name).fill("0.3");
      await page.locator("#object-save").click();
      await holds(page, "#object-mounts-trouble", /./);
      await page.getByRole("button", { name: "Remove roundel 3" }).click();
      await field(page, 0, "x").fill("0.25");
      await page.locator("#object-save").click();
      await closed(page, "#object");
      const changed = await lab.config();
      assert.match(changed, /code = 3, position_m = \[0\.25, 0\.0, 0\.1\], yaw_deg = 30\.0/);
      assert.match(changed, /code = 4, .*right = \[0\.0, 1\.0, 0\.0\], top = \[0\.0, 0\.0, 1\.0\]/);

      await page.locator("#add-object").click();
      await page.locator("#object-choice").selectOption("tall");
      await page.locator("#object-carries").selectOption("one");
      await page.locator("#object-roundel").selectOption("coded");
      await page.locator("#object-code").fill("6");
      await page.locator("#object-save").click();
      await closed(page, "#object");
      assert.match(await lab.config(), /name = "tall"\nroundel = "coded"\ncode = 6/);
      await page.locator("#add-object").click();
      await page.locator("#object-choice").selectOption("tall");
      await page.locator("#object-remove").click();
      await page.locator("#object-remove", { hasText: "Remove tall" }).click();
      await closed(page, "#object");
      assert.doesNotMatch(await lab.config(), /\[\[object\]\]/);
    });
  });
});

describe("accessibility", { skip: lacking }, () => {
  const openers = { record: "#recording", "print-open": "#print", "add-object": "#object", "history-open": "#history" };
  for (const [words, options] of Object.entries({ light: { colorScheme: "light" }, dark: { colorScheme: "dark" }, "a phone": PHONE })) {
    test(`axe finds nothing serious, and nothing is wider than the screen (${words})`, async () => {
      await withPage(
        lab.url,
        async (page) => {
          for (const [opener, part] of Object.entries(openers)) {
            await page.locator(`#${opener}`).click();
            await page.locator(part).waitFor();
            await assertAccessible(page, part);
            const over = await page.evaluate(() => document.documentElement.scrollWidth - innerWidth);
            assert.ok(over <= 0, `${part} is ${over} px wider than the screen`);
            if (part !== "#history") await page.keyboard.press("Escape");
          }
        },
        options,
      );
    });
  }
});
