/**
 * The dashboard in headless Chromium, with the real server at ROUNDEL_URL if it is set, else with
 * the mock server. Tests wait for conditions and do not depend on timing.
 */

import assert from "node:assert/strict";
import { after, before, describe, test } from "node:test";

import {
  assertAccessible,
  assertChanges,
  assertPicture,
  assertReturns,
  canvasSum,
  launch,
  readObjects,
  startLine,
  target,
  visitObjects,
} from "./harness.mjs";

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

const withPage = (options, body, url = server.url) => visitObjects(browser, url, options, body);

describe("the page", () => {
  test("opens without errors and sends requests to its server only", async () => {
    await withPage({}, async (page, { complaints, foreign }) => {
      await page.waitForFunction(() => document.querySelector("#installation").textContent !== "–");
      const info = await (await fetch(new URL("api/v1/info", server.url))).json();
      assert.equal(await page.locator("h1").textContent(), info.name || "Unnamed installation");
      // On a busy machine, snapshots may pause for a moment.
      await page.locator("#link-text", { hasText: /^Live$/ }).waitFor();
      await page.waitForFunction(() => Number(document.querySelector("#rate").textContent) > 0);
      assert.deepEqual(complaints, []);
      assert.deepEqual(foreign, []);
    });
  });

  test("shows the server's objects as they move", async () => {
    await withPage({}, async (page) => {
      const first = await readObjects(page);
      const truth = await (await fetch(new URL("api/v1/snapshot", server.url))).json();
      const known = truth.objects.filter((object) => first.has(object.object_id) && object.position);
      assert.ok(known.length >= truth.objects.length / 2, `${known.length} of ${truth.objects.length} are listed`);
      for (const { object_id: id, position } of known) {
        const shown = first.get(id);
        // Robots move between the two reads, so the bound is wide.
        const distance = Math.hypot(shown.x - position.x, shown.y - position.y, shown.z - position.z);
        assert.ok(distance < 3, `object ${id} is shown ${distance.toFixed(2)} m from its position`);
      }
      await page.waitForFunction(
        (before) => {
          const rows = [...document.querySelectorAll("#object-rows tr")];
          const moved = rows.filter((row) => {
            const was = before[row.dataset.objectId];
            return was && was !== row.children[1].textContent + row.children[2].textContent;
          });
          return moved.length >= Object.keys(before).length / 2;
        },
        await page.locator("#object-rows tr").evaluateAll((rows) =>
          Object.fromEntries(
            rows.map((row) => [row.dataset.objectId, row.children[1].textContent + row.children[2].textContent]),
          ),
        ),
      );
    });
  });

  test("counts the objects by life stage", async () => {
    await withPage({}, async (page) => {
      await page.waitForFunction(() => {
        const tracked = document.querySelectorAll('#object-rows tr[data-stage="tracked"]').length;
        return tracked > 0 && Number(document.querySelector('[data-stage="tracked"] b').textContent) === tracked;
      });
    });
  });

  test("draws the arena, and redraws it as objects move", async () => {
    await withPage({}, async (page) => {
      await assertPicture(page, "arena-tracks", (sum) => sum !== 0, "stays empty");
      const before = await canvasSum(page, "arena-tracks");
      await assertChanges(page, "arena-tracks", before);
    });
  });

  test("draws the arena in the page if the browser cannot draw in a worker", async () => {
    const context = await browser.newContext();
    const page = await context.newPage();
    try {
      await page.addInitScript(() => delete HTMLCanvasElement.prototype.transferControlToOffscreen);
      await page.goto(server.url);
      await page.locator("#object-rows tr").first().waitFor();
      assert.equal(page.workers().length, 0);
      await assertPicture(page, "arena-tracks", (sum) => sum !== 0, "stays empty");
      const before = await canvasSum(page, "arena-tracks");
      await assertChanges(page, "arena-tracks", before);
      await page.locator("#object-rows button").first().click();
      await page.locator("#selection").waitFor();
    } finally {
      await context.close();
    }
  });

  test("has a card for each camera, with its figures and its picture", async () => {
    const { cameras } = await (await fetch(new URL("api/v1/cameras", server.url))).json();
    assert.ok(cameras.length > 0, "the server has cameras");
    await withPage({}, async (page) => {
      for (const { name } of cameras) {
        const card = page.locator(`[data-camera-card="${name}"]`);
        await card.waitFor();
        await card.scrollIntoViewIfNeeded();
        await page.waitForFunction(
          (wanted) => {
            const found = [...document.querySelectorAll("[data-camera-card]")].find((c) => c.dataset.cameraCard === wanted);
            const figure = (key) => Number(found.querySelector(`[data-figure=${key}]`).textContent);
            const image = found.querySelector("img");
            return (
              found.dataset.status === "running" &&
              figure("rate") > 0 &&
              figure("latency") > 0 &&
              figure("detect") > 0 &&
              image.naturalWidth > 0 &&
              Number(image.dataset.pictures) >= 2
            );
          },
          name,
        );
      }
    });
  });

  test("requests one picture of a camera at a time, and none out of view", async () => {
    await withPage({ viewport: { width: 390, height: 500 } }, async (page) => {
      const open = new Map();
      let most = 0;
      let asked = 0;
      const camera = (request) => /cameras\/([^/]+)\/frame\.jpg/.exec(request.url())?.[1];
      const ended = (request) => {
        const name = camera(request);
        if (name) open.set(name, (open.get(name) ?? 1) - 1);
      };
      page.on("request", (request) => {
        const name = camera(request);
        if (!name) return;
        asked += 1;
        open.set(name, (open.get(name) ?? 0) + 1);
        most = Math.max(most, open.get(name));
      });
      page.on("requestfinished", ended);
      page.on("requestfailed", ended);
      await page.waitForTimeout(1000);
      assert.equal(asked, 0, "the cameras are below the fold");
      await page.locator("[data-camera-card]").first().scrollIntoViewIfNeeded();
      await page.waitForFunction(() => Number(document.querySelector("img[data-camera]").dataset.pictures) >= 4);
      assert.equal(most, 1);
    });
  });

  test("enlarges a picture and keeps it live", async () => {
    await withPage({}, async (page) => {
      // The first camera's picture need not arrive first.
      await page.locator(".frame:has(img.loaded)").first().click();
      const picture = page.locator("#viewer-picture");
      await picture.waitFor();
      const first = await picture.getAttribute("src");
      await page.waitForFunction((src) => document.querySelector("#viewer-picture").src !== src, first);
      await page.keyboard.press("Escape");
      await picture.waitFor({ state: "hidden" });
    });
  });
});

/** Id of the fastest object. */
async function fastest(page) {
  const speeds = await page.locator("#object-rows tr").evaluateAll((rows) =>
    rows.map((row) => ({ id: row.dataset.objectId, speed: Number(row.children[4].textContent) || 0 })),
  );
  return speeds.reduce((best, each) => (each.speed > best.speed ? each : best)).id;
}

const rowOf = (page, id) => page.locator(`#object-rows tr[data-object-id="${id}"]`);

describe("selection", () => {
  test("from the list shows all values of an object as they change", async () => {
    await withPage({}, async (page) => {
      const id = await fastest(page);
      await rowOf(page, id).locator("button").click();
      const panel = page.locator("#selection");
      await panel.waitFor();
      assert.match(await panel.locator("h2").textContent(), new RegExp(`\\b${id}\\b`));
      const value = (key) => panel.locator(`[data-value="${key}"]`).textContent();
      for (const key of ["x", "y", "z", "sigma-x", "sigma-y", "sigma-z", "velocity-x"]) {
        assert.match(await value(key), /^\u2212?\d+\.\d+$/, key);
      }
      assert.match(await value("speed"), /^\d+\.\d+ m\/s$/);
      assert.match(await value("ellipse"), /^± [\d.]+ × [\d.]+ mm$/);
      assert.match(await value("age"), /\d/);
      assert.match(await value("residual"), /^\d+\.\d+/);
      const { cameras } = await (await fetch(new URL("api/v1/cameras", server.url))).json();
      const names = cameras.map((camera) => camera.name);
      const seenBy = (await value("cameras")).split(", ");
      assert.ok(seenBy.every((name) => names.includes(name) || name === "none now"), seenBy.join());
      assert.doesNotMatch(await panel.textContent(), /NaN|undefined|null/);
      const x = await value("x");
      const y = await value("y");
      await page.waitForFunction(
        (was) => ["x", "y"].map((k) => document.querySelector(`[data-value="${k}"]`).textContent).join() !== was,
        [x, y].join(),
      );
      await page.keyboard.press("Tab");
      await page.locator("#deselect").click();
      await panel.waitFor({ state: "hidden" });
    });
  });

  test("of an object with a coded roundel shows its code", async () => {
    await withPage({}, async (page) => {
      const { objects } = await (await fetch(new URL("api/v1/snapshot", server.url))).json();
      const coded = objects.filter((each) => each.code);
      for (const { object_id: id, code } of objects) {
        const row = rowOf(page, id);
        // The object may have been lost meanwhile.
        if ((await row.count()) === 0) continue;
        assert.equal(await row.locator(".code").textContent(), code ? `#${code.number}` : "", `object ${id}`);
      }
      for (const { object_id: id, code } of coded.slice(0, 1)) {
        await rowOf(page, id).locator("button").click();
        const shown = await page.locator('#selection [data-value="code"]').textContent();
        assert.ok(shown.endsWith(`, code ${code.number} of ${code.bits} bits`), shown);
      }
    });
  });

  test("works by a click in the arena, and a click beside an object clears it", async () => {
    const line = await startLine(server.url);
    try {
      await withPage(
        {},
        async (page) => {
          const id = await fastest(page);
          await rowOf(page, id).locator("button").click();
          await page.locator("#follow").click();
          assert.equal(await page.locator("#follow").getAttribute("aria-pressed"), "true");
          // Zoomed in, so that no other object is within reach of the click.
          for (let i = 0; i < 6; i += 1) await page.locator("#zoom-in").click();
          // The followed object is at the centre; with the connection frozen it stays there.
          line.freeze();
          await page.locator('body[data-phase="lost"]').waitFor();
          const panel = page.locator("#selection");
          await page.locator("#deselect").click();
          await panel.waitFor({ state: "hidden" });
          const box = await page.locator("#arena-stage").boundingBox();
          const middle = [box.x + box.width / 2, box.y + box.height / 2];
          await page.mouse.click(...middle);
          await panel.waitFor();
          const selected = await page.locator("#object-rows tr.selected").getAttribute("data-object-id");
          assert.equal(selected, id);
          await page.mouse.click(middle[0] + 60, middle[1] + 60);
          await panel.waitFor({ state: "hidden" });
        },
        line.url,
      );
    } finally {
      await line.close();
    }
  });

  test("works with the keyboard only", async () => {
    await withPage({}, async (page) => {
      await page.locator("#arena-stage").focus();
      await page.keyboard.press("n");
      const first = await page.locator("#object-rows tr.selected").getAttribute("data-object-id");
      await page.keyboard.press("n");
      const second = await page.locator("#object-rows tr.selected").getAttribute("data-object-id");
      assert.notEqual(first, second);
      await page.keyboard.press("p");
      assert.equal(await page.locator("#object-rows tr.selected").getAttribute("data-object-id"), first);
      await page.keyboard.press("f");
      assert.equal(await page.locator("#follow").getAttribute("aria-pressed"), "true");
      // Panning stops following.
      await page.keyboard.press("ArrowLeft");
      await page.waitForFunction(() => document.querySelector("#follow").getAttribute("aria-pressed") === "false");
      await page.keyboard.press("Escape");
      await page.locator("#selection").waitFor({ state: "hidden" });
    });
  });
});

describe("the view", () => {
  const grid = async (page) => /Grid ([\d.]+) m/.exec(await page.locator("#arena-caption").textContent())[1];

  test("zooms with the wheel, pans by dragging, and fits with a key", async () => {
    await withPage({}, async (page) => {
      const box = await page.locator("#arena-stage").boundingBox();
      // The view fits itself to the cameras, which may arrive after the objects.
      await page.locator("[data-camera-card]").first().waitFor();
      await page.locator("#fit").click();
      await page.waitForTimeout(500);
      const fitted = await canvasSum(page, "arena-backdrop");
      const step = Number(await grid(page));
      await page.mouse.move(box.x + box.width / 2, box.y + box.height / 2);
      await page.mouse.wheel(0, -1200);
      await page.waitForFunction(
        (was) => Number(/Grid ([\d.]+) m/.exec(document.querySelector("#arena-caption").textContent)[1]) < was,
        step,
      );
      await page.locator("#fit").click();
      await assertReturns(page, "arena-backdrop", fitted);
      await page.mouse.move(box.x + 300, box.y + 300);
      await page.mouse.down();
      await page.mouse.move(box.x + 380, box.y + 340, { steps: 4 });
      await page.mouse.up();
      await assertChanges(page, "arena-backdrop", fitted);
      await page.locator("#arena-stage").focus();
      await page.keyboard.press("0");
      await assertReturns(page, "arena-backdrop", fitted);
    });
  });

  test("measures between objects and between clicks", async () => {
    await withPage({}, async (page) => {
      await page.locator("#object-rows button").first().click();
      await page.keyboard.press("m");
      assert.equal(await page.locator("#tape").getAttribute("aria-pressed"), "true");
      const caption = page.locator("#arena-caption");
      await caption.filter({ hasText: /^Measure: from .+ to …/ }).waitFor();
      await page.keyboard.press("n");
      await caption.filter({ hasText: /^\S+ to \S+: [\d.]+ m/ }).waitFor();
      const box = await page.locator("#arena-stage").boundingBox();
      for (const [x, y] of [[box.x + 60, box.y + 20], [box.x + 60, box.y + 120]]) await page.mouse.click(x, y);
      await caption.filter({ hasText: /^\(.+, .+\) to \(.+, .+\): [\d.]+ m/ }).waitFor();
      await page.keyboard.press("Escape");
      assert.equal(await page.locator("#tape").getAttribute("aria-pressed"), "false");
      await caption.filter({ hasText: /^Grid/ }).waitFor();
      assert.ok(await page.locator("#selection").isVisible(), "the selection stays");
    });
  });

  test("shows the exaggeration of the error ellipses", async () => {
    await withPage({}, async (page) => {
      for (const [value, words] of [
        ["100", "95 % ellipses drawn 100× larger"],
        ["1", "95 % ellipses to scale"],
        ["10", "95 % ellipses drawn 10× larger"],
      ]) {
        await page.locator(`input[name=exaggeration][value='${value}']`).check();
        await page.locator("#arena-caption", { hasText: words }).waitFor();
      }
      await page.locator("input[name=exaggeration][value='0']").check();
      await page.waitForFunction(() => !document.querySelector("#arena-caption").textContent.includes("ellipses"));
    });
  });
});

describe("a lost connection", () => {
  /** Opens the page over a proxied connection, breaks it, and checks the loss and the recovery. */
  async function seeThroughLoss(breakLine) {
    const line = await startLine(server.url);
    try {
      await withPage(
        {},
        async (page) => {
          const banner = page.locator("#banner");
          assert.equal(await banner.isVisible(), false);
          breakLine(line);
          await banner.waitFor();
          assert.match(await banner.textContent(), /Connection lost\..* ago\./);
          assert.equal(await page.locator("body").getAttribute("data-phase"), "lost");
          assert.ok((await page.locator("#object-rows tr").count()) > 0, "objects stay in view");
          const greyed = await page.locator("#arena-tracks").evaluate((canvas) => getComputedStyle(canvas).filter);
          assert.match(greyed, /grayscale/);
          line.mend();
          await page.locator('body[data-phase="live"]').waitFor();
          await banner.waitFor({ state: "hidden" });
          const before = await canvasSum(page, "arena-tracks");
          await assertChanges(page, "arena-tracks", before);
          await page.waitForFunction(() => document.querySelector("#link-text").textContent === "Live");
        },
        line.url,
      );
    } finally {
      await line.close();
    }
  }

  test("is shown and reopened automatically", () => seeThroughLoss((line) => line.cut()));

  test("is detected when the network is silent", () => seeThroughLoss((line) => line.freeze()));

  test("is reopened at once by the button", async () => {
    const line = await startLine(server.url);
    try {
      await withPage(
        {},
        async (page) => {
          line.cut();
          await page.locator("#banner").waitFor();
          // The next automatic attempt is far enough away that the button causes the reconnection.
          await page.waitForFunction(() =>
            /Next attempt in ([4-9]|\d\d) s/.test(document.querySelector("#banner").textContent),
          );
          line.mend();
          await page.locator("#retry").click();
          await page.locator('body[data-phase="live"]').waitFor();
        },
        line.url,
      );
    } finally {
      await line.close();
    }
  });
});

describe("accessibility", () => {
  for (const options of [{ colorScheme: "light" }, { colorScheme: "dark" }, { viewport: { width: 390, height: 844 } }]) {
    test(`axe finds nothing serious with ${JSON.stringify(options)}`, async () => {
      await withPage(options, async (page) => {
        await page.locator("#object-rows button").first().click();
        await page.locator("[data-camera-card]").first().waitFor();
        await assertAccessible(page);
      });
    });
  }
});

describe("the theme", () => {
  const ground = (page) => page.evaluate(() => getComputedStyle(document.body).backgroundColor);
  const luma = (color) => color.match(/\d+/g).slice(0, 3).reduce((sum, part) => sum + Number(part), 0) / 3;

  test("follows the system", async () => {
    await withPage({ colorScheme: "light" }, async (page) => assert.ok(luma(await ground(page)) > 200));
    await withPage({ colorScheme: "dark" }, async (page) => {
      assert.ok(luma(await ground(page)) < 50);
      await page.emulateMedia({ colorScheme: "light" });
      await page.waitForFunction(() => document.documentElement.dataset.theme === "light");
    });
  });

  test("can be chosen, survives a reload, and applies to the arena", async () => {
    await withPage({ colorScheme: "light" }, async (page) => {
      const before = await canvasSum(page, "arena-backdrop");
      await page.locator("#theme").click();
      assert.ok(luma(await ground(page)) < 50);
      await assertChanges(page, "arena-backdrop", before);
      await page.reload();
      await page.locator('body[data-phase="live"]').waitFor();
      assert.ok(luma(await ground(page)) < 50);
      assert.equal(await page.locator("#theme").getAttribute("aria-label"), "Switch to the light theme");
    });
  });
});

describe("a phone", () => {
  for (const width of [320, 390]) {
    test(`${width} px wide has everything without horizontal scrolling`, async () => {
      await withPage({ viewport: { width, height: 800 }, hasTouch: true, isMobile: true }, async (page) => {
        await page.locator("#object-rows button").first().tap();
        for (const section of ["#arena-stage", "#selection", "#objects", ".cameras", ".events"]) {
          const box = await page.locator(section).boundingBox();
          assert.ok(box && box.width > 0 && box.height > 0, `${section} is visible`);
          assert.ok(box.x >= 0 && box.x + box.width <= width, `${section} fits into the width`);
        }
        const [name, link] = await Promise.all(["#installation", "#link"].map((it) => page.locator(it).boundingBox()));
        assert.ok(name && link && name.width >= 24 && name.x + name.width <= link.x, "the installation's name is beside the lamp");
        const wide = await page.evaluate(() => document.documentElement.scrollWidth);
        assert.ok(wide <= width, `the page is ${wide} px wide`);
        const table = await page.locator("#objects .scroll").evaluate((box) => box.scrollWidth - box.clientWidth);
        assert.ok(table <= 0, `the table is ${table} px too wide`);
      });
    });
  }
});
