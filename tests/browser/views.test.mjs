/** 3D, health, time line, search and keys, with the real server at ROUNDEL_URL if it is set, else with the mock server. */

import assert from "node:assert/strict";
import { after, before, describe, test } from "node:test";

import { PATIENCE_MS, assertAccessible, countDraws, drawingWorker, launch, startLine, target, visitObjects } from "./harness.mjs";
import { startMock } from "./mock.mjs";
import { World } from "./world.mjs";

let server;
let browser;
let spaceBrowser;
before(async () => {
  server = await target();
  browser = await launch();
  spaceBrowser = await launch({ space: true });
});
after(async () => {
  await browser?.close();
  await spaceBrowser?.close();
  await server?.close();
});

const withPage = (options, body, url = server.url, within = browser) => visitObjects(within, url, options, body);

/** Runs a test with its own mock server. */
async function withWorld(world, options, body, within = browser, mock = {}) {
  const own = await startMock({ world, ...mock });
  try {
    return await withPage(options, body, own.url, within);
  } finally {
    await own.close();
  }
}

const choose = (page, mode) => page.locator(`input[name=mode][value=${mode}]`).check();
const shows = (page, mode) => page.locator(`.arena[data-shows="${mode}"]`).waitFor();
const value = (page, key) => page.locator(`#selection [data-value="${key}"]`).textContent();

describe("the view in 3D", () => {
  test("draws the arena, rotates with mouse and keys, and zooms", async () => {
    await withPage({}, async (page, { complaints, foreign }) => {
      await choose(page, "space");
      await page.locator('#arena-stage[data-mode="space"]').waitFor();
      const stage = page.locator("#arena-stage");
      await page.locator("#arena-caption", { hasText: "drag to rotate" }).waitFor();
      // Objects are frozen, so that only user input changes the picture.
      await page.waitForTimeout(1500);
      await page.keyboard.press(",");
      const look = async () => (await stage.screenshot()).toString("base64");
      let last = await look();
      const box = await stage.boundingBox();
      const middle = [box.x + box.width / 2, box.y + box.height / 2];
      const changes = async (act, what) => {
        await act();
        const until = Date.now() + PATIENCE_MS;
        for (let now = await look(); ; now = await look()) {
          if (now !== last) {
            last = now;
            return;
          }
          assert.ok(Date.now() < until, `${what} changes nothing`);
        }
      };
      const drag = async (button) => {
        await page.mouse.move(...middle);
        await page.mouse.down({ button });
        await page.mouse.move(middle[0] + 90, middle[1] + 30, { steps: 3 });
        await page.mouse.up({ button });
      };
      await changes(() => drag("left"), "dragging");
      await changes(() => drag("right"), "dragging with the right button");
      await changes(() => page.mouse.wheel(0, -400), "the wheel");
      await stage.focus();
      await changes(() => page.keyboard.press("ArrowLeft"), "an arrow key");
      await changes(() => page.keyboard.press("Shift+ArrowUp"), "Shift and an arrow key");
      await changes(() => page.keyboard.press("0"), "fitting");
      assert.deepEqual(complaints, []);
      assert.deepEqual(foreign, []);
    }, server.url, spaceBrowser);
  });

  test("selects the clicked object", async () => {
    const line = await startLine(server.url);
    try {
      await withPage({}, async (page) => {
        await choose(page, "space");
        await page.locator('#arena-stage[data-mode="space"]').waitFor();
        await page.locator("#object-rows button").first().click();
        const id = await page.locator("#object-rows tr.selected").getAttribute("data-object-id");
        await page.locator("#follow").click();
        // The followed object is at the centre; with the connection frozen it stays there.
        await page.waitForTimeout(1000);
        line.freeze();
        await page.locator('body[data-phase="lost"]').waitFor();
        await page.locator("#deselect").click();
        const box = await page.locator("#arena-stage").boundingBox();
        await page.mouse.click(box.x + box.width / 2, box.y + box.height / 2);
        await page.locator("#selection").waitFor();
        assert.equal(await page.locator("#object-rows tr.selected").getAttribute("data-object-id"), id);
        await page.mouse.click(box.x + 6, box.y + 6);
        await page.locator("#selection").waitFor({ state: "hidden" });
      }, line.url, spaceBrowser);
    } finally {
      await line.close();
    }
  });

  test("takes at most 50 draws for 400 objects and 16 cameras", async () => {
    class Unpictured extends World {
      // Encoding sixteen pictures would take too much of this process.
      picture() {
        return null;
      }
    }
    await withWorld(new Unpictured({ robots: 400, cameras: 16 }), {}, async (page) => {
      const drawsOfAFrame = await countDraws(page);
      await choose(page, "space");
      await page.locator('#arena-stage[data-mode="space"]').waitFor();
      await page.waitForTimeout(2000);
      const draws = await drawsOfAFrame();
      assert.ok(draws > 5 && draws <= 50, `${draws} draws a frame`);
      // Draws are counted and not timed, so few snapshots are enough.
    }, spaceBrowser, { mostHz: 4 });
  });

  test("falls back to the view from above without WebGL, and says so", async () => {
    await withPage({}, async (page, { complaints }) => {
      const worker = await drawingWorker(page);
      await worker.evaluate(() => {
        const plain = OffscreenCanvas.prototype.getContext;
        OffscreenCanvas.prototype.getContext = function (kind, ...rest) {
          return kind === "webgl2" ? null : plain.call(this, kind, ...rest);
        };
      });
      await page.keyboard.press("2");
      await page.locator("#arena-caption", { hasText: "3D is not available" }).waitFor();
      assert.equal(await page.locator("#arena-stage").getAttribute("data-mode"), "top");
      assert.equal(await page.locator("input[name=mode][value=top]").isChecked(), true);
      assert.deepEqual(complaints, []);
    });
  });

  test("axe finds nothing serious", async () => {
    await withPage({ colorScheme: "dark" }, async (page) => {
      await choose(page, "space");
      await page.locator('#arena-stage[data-mode="space"]').waitFor();
      await assertAccessible(page);
    }, server.url, spaceBrowser);
  });
});

describe("health", () => {
  test("shows the figures of all cameras, and the latency of snapshots", async () => {
    const { cameras } = await (await fetch(new URL("api/v1/cameras", server.url))).json();
    await withPage({}, async (page, { complaints }) => {
      await page.locator("#verdict", { hasText: "camera" }).click();
      await shows(page, "health");
      await page.waitForFunction((count) => document.querySelectorAll("#health-rows tr").length === count, cameras.length);
      const names = await page.locator("#health-rows th").allTextContents();
      assert.deepEqual(names.map((name) => name.trim()).sort(), cameras.map((camera) => camera.name).sort());
      await page.waitForFunction(() => [...document.querySelectorAll("#health-rows [data-figure=rate]")].every((cell) => parseFloat(cell.textContent) > 0));
      await page.waitForFunction(() => /^\d+ \/ \d+ \/ \d+ ms$/.test(document.querySelector("#health-late").textContent));
      await page.waitForFunction(() => [...document.querySelectorAll("#health-bars span")].some((bar) => bar.style.height === "100%"));
      await page.locator("#print-size-rows tr", { hasText: /configured/ }).first().waitFor();
      assert.deepEqual(complaints, []);
    });
  });

  test("names the camera with a problem first, until it has recovered", async () => {
    const world = new World();
    await withWorld(world, {}, async (page) => {
      await page.locator("#verdict-text", { hasText: "All 4 cameras OK" }).waitFor();
      assert.equal(await page.locator("#unwell").isVisible(), false);
      world.failCamera("north-west", "no images in frames/north-west");
      await page.locator("#verdict-text", { hasText: "1 camera failed" }).waitFor();
      assert.equal(await page.locator("#verdict").getAttribute("data-health"), "grave");
      const item = page.locator("#unwell li");
      assert.match(await item.textContent(), /^north-west No images in frames\/north-west\. Retrying automatically\.$/);
      await item.getByRole("button").click();
      await page.waitForFunction(() => document.activeElement?.closest("[data-camera-card]")?.dataset.cameraCard === "north-west");
      await page.keyboard.press("3");
      await shows(page, "health");
      await page.locator('#health-rows tr:first-child[data-name="north-west"][data-health="grave"]').waitFor();
      // A problem of two cameras is listed once.
      world.failCamera("north-east", "no images in frames/north-west");
      await page.locator("#verdict-text", { hasText: "2 cameras failed" }).waitFor();
      await page.waitForFunction(() => document.querySelectorAll("#unwell li").length === 1 && document.querySelectorAll("#unwell button").length === 2);
      world.restoreCamera("north-east");
      world.restoreCamera("north-west");
      await page.locator("#verdict-text", { hasText: "All 4 cameras OK" }).waitFor();
      await page.locator("#unwell").waitFor({ state: "hidden" });
    });
  });

  test("shows reprojection errors, now and at the newest calibration", async () => {
    await withWorld(new World(), {}, async (page) => {
      await page.route("**/api/v1/calibration", (route) =>
        route.fulfill({ json: { stage: "done", recorded: [], report: { cameras: [{ camera: "north-east", reprojection_px: 0.37 }] } } }),
      );
      await page.keyboard.press("3");
      await page.locator('#health-rows tr[data-name="north-east"] [data-figure=reprojection]', { hasText: /^(0\.2\d|–) \(0\.37\)$/ }).waitFor();
      // A camera that shares no view with another has no reprojection error.
      const figures = await page.locator("#health-rows [data-figure=reprojection]").allTextContents();
      assert.equal(figures.filter((text) => text.startsWith("–")).length, 1, figures.join());
      assert.equal(figures.filter((text) => /^0\.2\d/.test(text)).length, 3, figures.join());
    });
  });

  test("works if the request for the calibration fails", async () => {
    await withWorld(new World(), {}, async (page) => {
      await page.route("**/api/v1/calibration", (route) => route.abort());
      await page.keyboard.press("3");
      await page.locator('#health-rows tr[data-name="north-east"] [data-figure=reprojection]', { hasText: /^(0\.2\d|–)$/ }).waitFor();
      await page.locator('#health-rows tr[data-name="north-east"] .why', { hasText: "OK" }).waitFor();
    });
  });

  for (const options of [{ colorScheme: "light" }, { colorScheme: "dark", viewport: { width: 390, height: 844 } }]) {
    test(`axe finds nothing serious with ${JSON.stringify(options)}`, async () => {
      const world = new World();
      world.failCamera("north-west", "no images");
      await withWorld(world, options, async (page) => {
        await choose(page, "health");
        await page.locator("#unwell li").waitFor();
        await assertAccessible(page);
      });
    });
  }
});

describe("the time line", () => {
  test("shows past instants with slider and keys, and returns to now", async () => {
    await withPage({}, async (page) => {
      const moving = await page.locator("#object-rows tr").evaluateAll((rows) =>
        rows.map((row) => ({ id: row.dataset.objectId, speed: Number(row.children[4].textContent) || 0 })).sort((a, b) => b.speed - a.speed),
      );
      await page.locator(`#object-rows tr[data-object-id="${moving[0].id}"] button`).click();
      await page.waitForTimeout(3500);
      await page.keyboard.press(",");
      await page.locator("body.past").waitFor();
      assert.match(await page.locator("#past-words").textContent(), /^\d+\.\d s ago, /);
      const then = [await value(page, "x"), await value(page, "y")];
      await page.waitForTimeout(800);
      assert.deepEqual([await value(page, "x"), await value(page, "y")], then, "past values do not change");
      await page.keyboard.press(",");
      await page.waitForFunction(([x, y]) => ["x", "y"].map((key) => document.querySelector(`[data-value="${key}"]`).textContent).join() !== `${x},${y}`, then);
      await page.keyboard.press("l");
      await page.locator("body:not(.past)").waitFor();
      await page.locator("#past").fill("-2");
      await page.locator("#past-words", { hasText: "s ago" }).waitFor();
      await page.locator("#live").click();
      await page.locator("#past-words", { hasText: "Now" }).waitFor();
      // The panel shows the position ten seconds earlier once the history is long enough.
      await page.waitForFunction(() => document.querySelector('[data-value="before-x"]').textContent !== "–");
      await page.waitForFunction(() => document.querySelectorAll(".plot small").length === 4 && [...document.querySelectorAll(".plot small")].every((range) => / to /.test(range.textContent)));
    });
  });

  test("shows the instant of a click in a plot", async () => {
    await withWorld(new World(), {}, async (page) => {
      await page.locator('#object-rows tr[data-object-id="7"] button').click();
      await page.waitForTimeout(4000);
      const plot = page.locator('[data-plot="speed"] .u-over');
      const box = await plot.boundingBox();
      await page.mouse.click(box.x + box.width - 4, box.y + box.height / 2);
      await page.locator("body.past").waitFor();
      assert.match(await page.locator("#past-words").textContent(), /^[1-4]\.\d s ago/);
    });
  });

  test("says if the object was not in view, and ends with another run of the server", async () => {
    const world = new World({ robots: 3 });
    const first = await startMock({ world });
    const line = await startLine(first.url);
    const second = await startMock({ world: new World({ robots: 2 }) });
    second.world.sourceId = "mock-2";
    try {
      await withPage({}, async (page) => {
        await page.waitForTimeout(2500);
        const { id } = world.robots[2];
        world.robots.push({ ...world.robots[2], id: id + 1, y: 0 });
        await page.locator(`#object-rows tr[data-object-id="${id + 1}"] button`).click();
        await page.locator("#past").fill("-2");
        await page.locator(".stage-words", { hasText: "Not in view at that time" }).waitFor();
        line.cut();
        await page.locator("#banner").waitFor();
        line.mend(second.url);
        await page.locator("body:not(.past)").waitFor();
        await page.waitForFunction(() => document.querySelectorAll("#object-rows tr").length === 2);
      }, line.url);
    } finally {
      await line.close();
      await Promise.all([first.close(), second.close()]);
    }
  });
});

describe("search", () => {
  test("finds objects by number and name", async () => {
    await withWorld(new World(), {}, async (page) => {
      await page.keyboard.press("/");
      await page.keyboard.type("fork");
      await page.waitForFunction(() => document.querySelectorAll("#object-rows tr").length === 1);
      await page.keyboard.press("Enter");
      await page.locator("#selection h2", { hasText: "Forklift" }).waitFor();
      assert.match(await value(page, "precision"), /^Accuracy [\d.]+ mm \(95 %\), seen by (one camera|\d cameras), \d+ ms ago$/);
      await page.locator("#search").fill("2");
      await page.keyboard.press("Enter");
      await page.locator("#selection h2", { hasText: "Object 2" }).waitFor();
      assert.ok((await page.locator("#object-rows tr").count()) > 1, "20 to 24 match, too");
      await page.locator("#search").fill("unknown");
      await page.locator("#objects-empty", { hasText: "No matching objects" }).waitFor();
      await page.keyboard.press("Escape");
      await page.waitForFunction(() => document.querySelectorAll("#object-rows tr").length === 24);
    });
  });
});

describe("the coverage map", () => {
  test("is requested from the server, with errors at their fields", async () => {
    await withWorld(new World(), {}, async (page) => {
      const asked = [];
      await page.route("**/openapi.json", (route) => route.fulfill({ json: { paths: { "/api/v1/plan": { get: {} } } } }));
      await page.route("**/api/v1/configuration", (route) => route.fulfill({ json: { roundels: [{ name: "robot" }, { name: "cart" }] } }));
      await page.route("**/api/v1/plan?*", (route) => {
        const query = new URL(route.request().url()).searchParams;
        asked.push(Object.fromEntries(query));
        if (query.get("roundel") === "cart") {
          return route.fulfill({ status: 400, json: { error: { code: "invalid_argument", message: "roundel: the configured kinds are robot" } } });
        }
        return route.fulfill({ contentType: "image/svg+xml", body: '<svg xmlns="http://www.w3.org/2000/svg" width="40" height="30"><rect width="40" height="30"/></svg>' });
      });
      await page.reload();
      await page.locator("#plan-open").click();
      const isThere = () => page.waitForFunction(() => document.querySelector("#plan-picture").naturalWidth === 40);
      await isThere();
      assert.deepEqual(asked[0], { format: "svg", show: "precision", roundel: "robot" });
      assert.deepEqual(await page.locator("#plan-roundel option").allInnerTexts(), ["robot", "cart"]);
      await page.locator("#plan-roundel").selectOption("cart");
      await page.locator("#plan-roundel-trouble", { hasText: "the configured kinds are robot" }).waitFor();
      assert.equal(await page.locator("#plan-picture").isVisible(), false);
      await page.locator("#plan-roundel").selectOption("robot");
      await page.locator("#plan-height").fill("1.5");
      const last = page.waitForRequest((request) => request.url().includes("show=cameras"));
      await page.locator("#plan-show").selectOption("cameras");
      await last;
      await page.locator("#plan-picture").waitFor();
      assert.deepEqual(asked.at(-1), { format: "svg", show: "cameras", roundel: "robot", height: "1.5" });
      await page.keyboard.press("Escape");
      await page.waitForFunction(() => !document.querySelector("#plan-picture").src);
    });
  });
});

describe("a list of hundreds of objects", () => {
  test("has rows only for objects in view, scrolled to, or found", async () => {
    await withWorld(new World({ robots: 400, cameras: 1 }), {}, async (page) => {
      await page.locator('[data-object-id="1"]').waitFor();
      const rows = page.locator("#object-rows tr");
      assert.ok((await rows.count()) < 100, `${await rows.count()} rows`);
      // The list is as long as with all rows.
      const scroller = page.locator(".objects .scroll");
      const { long, rowHeight } = await scroller.evaluate((it) => ({ long: it.scrollHeight, rowHeight: it.querySelector("#object-rows tr").offsetHeight }));
      assert.ok(Math.abs(long - 400 * rowHeight) < 4 * rowHeight, `${long} px for rows of ${rowHeight}`);
      await scroller.evaluate((it) => (it.scrollTop = it.scrollHeight));
      await page.locator('[data-object-id="400"]').waitFor();
      await page.locator('[data-object-id="1"]').waitFor({ state: "detached" });
      await page.locator("#search").fill("200");
      await page.keyboard.press("Enter");
      await page.locator('[data-object-id="200"].selected').waitFor();
      assert.equal(await rows.count(), 1);
      // The search is cleared; the selection stays.
      await page.keyboard.press("Escape");
      await page.locator("#arena-stage").focus();
      await page.keyboard.press("n");
      const shown = page.locator('[data-object-id="201"].selected');
      await shown.waitFor();
      const inside = await shown.evaluate((row) => {
        const [box, frame] = [row.getBoundingClientRect(), row.closest(".scroll").getBoundingClientRect()];
        return box.top >= frame.top - 1 && box.bottom <= frame.bottom + 1;
      });
      assert.ok(inside);
    });
  });
});

describe("keyboard shortcuts", () => {
  test("are listed, and work everywhere except in text fields and dialogs", async () => {
    await withPage({}, async (page) => {
      await page.keyboard.press("?");
      await page.locator("#help[open]").waitFor();
      await assertAccessible(page);
      await page.keyboard.press("3");
      assert.equal(await page.locator('.arena[data-shows="health"]').count(), 0, "no shortcuts while a dialog is open");
      await page.keyboard.press("Escape");
      await page.locator("#help:not([open])").waitFor({ state: "attached" });
      await page.keyboard.press("3");
      await shows(page, "health");
      await page.keyboard.press("1");
      await shows(page, "top");
      const theme = await page.evaluate(() => document.documentElement.dataset.theme);
      await page.keyboard.press("t");
      await page.waitForFunction((was) => document.documentElement.dataset.theme !== was, theme);
      await page.locator("#search").focus();
      await page.keyboard.type("3t");
      assert.equal(await page.locator("#search").inputValue(), "3t");
      await page.locator("#help-open").click();
      await page.locator("#help[open]").waitFor();
    });
  });
});

describe("a control of a feature that the server does not offer", () => {
  test("is hidden, and is shown if the server has no description", async () => {
    await withWorld(new World(), {}, async (page) => {
      await page.locator("#add-camera").waitFor();
      await page.locator("#calibrate").waitFor();
      // Not in its OpenAPI description.
      for (const control of ["#record", "#replay", "#history-open", "#print-open", "#add-object"]) {
        assert.equal(await page.locator(control).isVisible(), false, control);
      }
      await page.route("**/openapi.json", (route) => route.fulfill({ json: { paths: { "/api/v1/cameras": { get: {} } } } }));
      await page.reload();
      await page.locator("#add-camera").waitFor({ state: "hidden" });
      await page.locator("#calibrate").waitFor({ state: "hidden" });
      await page.locator("[data-camera-card]").first().waitFor();
      await page.locator("body.no-edits").waitFor();
      assert.equal(await page.getByRole("button", { name: /^Edit camera/ }).count(), 0);
      await page.route("**/openapi.json", (route) => route.fulfill({ status: 500, body: "no" }));
      await page.reload();
      await page.locator("#calibrate").waitFor();
      // Features that its info excludes stay hidden.
      await page.locator("#print-open").waitFor();
      assert.equal(await page.locator("#record").isVisible(), false);
    });
  });

  test("is hidden if the server has the call but refuses it", async () => {
    class Closed extends World {
      info() {
        return { ...super.info(), allows_setup: false };
      }
    }
    await withWorld(new Closed(), {}, async (page) => {
      await page.locator("#calibrate").waitFor();
      await page.locator("body.no-edits").waitFor();
      assert.equal(await page.locator("#add-camera").isVisible(), false);
    });
  });
});

describe("the page's files", () => {
  test("take less than 1.5 MB with everything opened, under a policy without exceptions", async () => {
    const opened = await spaceBrowser.newContext({ viewport: { width: 1440, height: 900 } });
    const page = await opened.newPage();
    const sizes = new Map();
    const bodies = [];
    let policy = "";
    page.on("response", (response) => {
      const { pathname } = new URL(response.url());
      if (pathname.startsWith("/api/") || response.url().startsWith("blob:")) return;
      if (pathname === "/") policy = response.headers()["content-security-policy"] ?? "";
      bodies.push(response.body().then((body) => sizes.set(pathname, body.length)));
    });
    await page.goto(server.url);
    await page.locator('body[data-phase="live"]').waitFor();
    await choose(page, "space");
    await page.locator('#arena-stage[data-mode="space"]').waitFor();
    await Promise.all(bodies);
    const whole = [...sizes.values()].reduce((sum, size) => sum + size, 0);
    assert.ok(sizes.has("/vendor/three.js") && sizes.has("/vendor/uplot.js") && sizes.has("/app.css"), [...sizes.keys()].join());
    assert.ok(whole < 1_500_000, `${whole} bytes`);
    assert.match(policy, /default-src 'none'/);
    assert.doesNotMatch(policy, /unsafe|\*|data:|https?:|wss?:/);
    await opened.close();
  });
});
