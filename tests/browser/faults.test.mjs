/** Faults that only the mock server can produce: failing cameras, empty arenas, messages of another version. */

import assert from "node:assert/strict";
import { after, before, describe, test } from "node:test";

import { launch, openDashboard, startLine, visit } from "./harness.mjs";
import { startMock } from "./mock.mjs";
import { World } from "./world.mjs";

let browser;
before(async () => {
  browser = await launch();
});
after(() => browser?.close());

/** Runs a test with its own mock server. */
async function withWorld(world, body, mock = {}) {
  const server = await startMock({ world, ...mock });
  try {
    await visit(browser, server.url, {}, body);
  } finally {
    await server.close();
  }
}

describe("a camera with a problem", () => {
  test("shows why it failed and that it is retried, until it is back", async () => {
    const world = new World();
    await withWorld(world, async (page) => {
      const card = page.locator('[data-camera-card="north-west"]');
      await page.locator('[data-camera-card="north-west"][data-status="running"]').waitFor();
      world.failCamera("north-west", "no images in frames/north-west");
      await page.locator('[data-camera-card="north-west"][data-status="failed"]').waitFor();
      const words = await card.textContent();
      assert.match(words, /Failed/);
      assert.match(words, /No images in frames\/north-west\. Retrying automatically\./);
      await page.locator("#cameras-summary", { hasText: "1 of 4 failed" }).waitFor();
      await page.locator(".event.sign-failed", { hasText: "north-west" }).waitFor();
      world.restoreCamera("north-west");
      await page.locator('[data-camera-card="north-west"][data-status="running"]').waitFor();
      await page.locator(".event.sign-running", { hasText: "running again" }).waitFor();
      assert.equal(await card.locator(".trouble").isVisible(), false);
    });
  });

  test("shows that it is not used without a pose", async () => {
    class Unplaced extends World {
      cameras() {
        return super.cameras().map((camera) => ({ ...camera, pose: null, intrinsics: null }));
      }
    }
    await withWorld(new Unplaced(), async (page, { complaints }) => {
      await page.locator(".trouble", { hasText: "not known yet" }).first().waitFor();
      assert.deepEqual(complaints, []);
    });
  });
});

describe("a mounted camera", () => {
  /** One more camera, under the forklift, whose pose from the server does not change. */
  class Mounted extends World {
    state(robot, t) {
      const state = super.state(robot, t);
      return robot.name === "Forklift" ? { ...state, yaw_observed: true } : state;
    }

    cameras() {
      const cameras = super.cameras();
      const mount = { position: { x: 0, y: 0, z: 1 }, orientation: { x: 1, y: 0, z: 0, w: 0 } };
      const rides = { name: "aboard", carrier: "Forklift", mount, pose_status: "riding", pose: mount };
      const away = { pose: null, pose_status: "carrier_unseen", pose_reason: "\"Forklift\" is not followed now" };
      return [...cameras, { ...cameras[0], ...rides, ...(this.away ? away : {}) }];
    }
  }

  test("follows its carrier, and shows why its pose is unknown", async () => {
    const world = new Mounted({ robots: 7 });
    await withWorld(world, async (page, { complaints }) => {
      const place = page.locator('[data-camera-card="aboard"] .place');
      await page.waitForFunction(() => /on Forklift, at/.test(document.querySelector('[data-camera-card="aboard"] .place').textContent));
      const first = await place.textContent();
      // The server's pose is constant; the page moves the camera with the forklift.
      await page.waitForFunction(
        (before) => document.querySelector('[data-camera-card="aboard"] .place').textContent !== before,
        first,
      );
      world.away = true;
      await page.locator(".trouble", { hasText: 'Pose unknown: "Forklift" is not followed now.' }).waitFor();
      assert.equal(await place.textContent(), "on Forklift");
      world.tell({ kind: "camera_unplaced", camera: "aboard", message: "Camera aboard has no place." });
      await page.locator(".event.sign-predicted", { hasText: "aboard has no place" }).waitFor();
      assert.deepEqual(complaints, []);
    });
  });
});

describe("a page without its worker", () => {
  test("says so, and can be reloaded", async () => {
    await withWorld(new World(), async (page) => {
      await page.context().route("**/js/worker.js", (route) => route.abort());
      await page.reload();
      await page.locator("#banner-title", { hasText: "could not be loaded" }).waitFor();
      await page.context().unroute("**/js/worker.js");
      await page.getByRole("button", { name: "Reload the page" }).click();
      await page.locator('body[data-phase="live"]').waitFor();
    });
  });
});

describe("an arena without fixed cameras", () => {
  test("has a view that follows a robot that would leave it", async () => {
    class Leaving extends World {
      cameras() {
        return [];
      }

      state(robot, t) {
        const state = super.state(robot, t);
        return { ...state, position: { x: this.away ? 40 : 0, y: 0, z: 0.3 } };
      }
    }
    const world = new Leaving({ robots: 1, cameras: 0 });
    await withWorld(world, async (page) => {
      await page.locator("#object-rows tr").waitFor();
      // A trail would still be in view.
      await page.locator("#trails").uncheck();
      world.away = true;
      await page.locator("#object-rows td", { hasText: "40.000" }).waitFor();
      await page.waitForFunction(() => {
        const canvas = document.querySelector("#arena-tracks");
        const copy = new OffscreenCanvas(canvas.width, canvas.height).getContext("2d");
        copy.drawImage(canvas, 0, 0);
        const { data } = copy.getImageData(0, 0, canvas.width, canvas.height);
        return data.some((value) => value > 0);
      }, null, { timeout: 10_000 });
    });
  });
});

describe("an empty arena", () => {
  test("says that there are no objects", async () => {
    await withWorld(new World({ robots: 0 }), async (page, { complaints }) => {
      await page.locator("#arena-note", { hasText: "No objects in view" }).waitFor();
      assert.ok(await page.locator("#objects-empty").isVisible());
      assert.deepEqual(complaints, []);
    });
  });

  test("says that there are no cameras", async () => {
    await withWorld(new World({ robots: 0, cameras: 0 }), async (page, { complaints }) => {
      await page.locator("#arena-note", { hasText: "No cameras are configured" }).waitFor();
      assert.ok(await page.locator("#cameras-empty").isVisible());
      assert.deepEqual(complaints, []);
    });
  });
});

describe("a page that stays open", () => {
  test("marks a lost object, then removes it, and keeps its last values in the panel", async () => {
    class Leaving extends World {
      state(robot, t) {
        const state = super.state(robot, t);
        return robot.id === 2 && this.leaving ? { ...state, stage: "lost" } : state;
      }

      snapshot() {
        const snapshot = super.snapshot();
        if (this.gone) snapshot.objects = snapshot.objects.filter((object) => object.object_id !== 2);
        this.gone = this.leaving;
        return snapshot;
      }
    }
    const world = new Leaving({ robots: 3 });
    await withWorld(world, async (page) => {
      await page.locator('#object-rows tr[data-object-id="2"] button').click();
      world.leaving = true;
      await page.locator('#object-rows tr[data-object-id="2"][data-stage="lost"]').waitFor();
      await page.locator('#object-rows tr[data-object-id="2"]').waitFor({ state: "detached" });
      assert.match(await page.locator(".stage-words").textContent(), /last known values/);
      assert.equal(await page.locator("#object-rows tr").count(), 2);
    });
  });

  test("ignores unknown and broken values in messages", async () => {
    class Odd extends World {
      snapshot() {
        const snapshot = super.snapshot();
        Object.assign(snapshot.objects[0], { stage: "hibernating", position: null, orientation: null });
        Object.assign(snapshot.objects[1], { covariance: [], velocity: null, cameras: null, residual: null });
        delete snapshot.objects[2].name;
        return snapshot;
      }

      cameras() {
        const cameras = super.cameras();
        Object.assign(cameras[0], { status: "dreaming", rate_hz: null, intrinsics: { lens: "spiral" } });
        return cameras;
      }
    }
    const world = new Odd({ robots: 4 });
    await withWorld(world, async (page, { complaints }) => {
      await page.locator('#object-rows tr[data-object-id="4"]').waitFor();
      world.tell({ kind: "moon_rose", message: "" });
      await page.locator(".event", { hasText: "moon rose" }).waitFor();
      for (const id of [1, 2, 3]) {
        await page.locator(`#object-rows tr[data-object-id="${id}"] button`).click();
        await page.locator("#selection h2", { hasText: String(id) }).waitFor();
        assert.doesNotMatch(await page.locator("#selection").textContent(), /NaN|undefined|null/);
      }
      assert.doesNotMatch(await page.locator("main").textContent(), /NaN|undefined/);
      assert.deepEqual(complaints, []);
      // Only JSON can have unknown names; protobuf has numbers.
    }, { protocols: ["roundel.v1.json"] });
  });

  test("shows the message of an event of an unknown kind", async () => {
    const world = new World({ robots: 1 });
    await withWorld(world, async (page) => {
      await page.locator("#object-rows tr").waitFor();
      world.tell({ kind: "moon_rose", message: "The moon rose." });
      world.tell({ kind: "moon_set", message: "" });
      await page.locator(".event", { hasText: "The moon rose." }).waitFor();
      await page.locator(".event", { hasText: /Unknown event/ }).waitFor();
    });
  });

  test("drops all objects and events of an earlier run of the server", async () => {
    const first = await startMock({ world: new World({ robots: 3 }) });
    const line = await startLine(first.url);
    const second = await startMock({ world: new World({ robots: 2 }) });
    second.world.sourceId = "mock-2";
    try {
      const { page, context } = await openDashboard(browser, line.url);
      await page.locator('#object-rows tr[data-object-id="3"] button').click();
      for (const id of [7, 8]) first.world.tell({ kind: "object_lost", object_id: id, message: `Object ${id} is lost.` });
      await page.locator(".event", { hasText: "Object 8" }).waitFor();
      line.cut();
      await page.locator("#banner").waitFor();
      // The first event has the number of an event of the first run.
      second.world.tell({ kind: "camera_running", camera: "south-west", message: "Camera south-west is running." });
      line.mend(second.url);
      await page.locator('#object-rows tr[data-object-id="3"]').waitFor({ state: "detached" });
      await page.locator("#selection").waitFor({ state: "hidden" });
      assert.equal(await page.locator(".event", { hasText: "Object 7" }).count(), 0);
      assert.equal(await page.locator(".event", { hasText: "Object 8" }).count(), 0);
      assert.equal(await page.locator(".event", { hasText: "south-west is running" }).count(), 1);
      await context.close();
    } finally {
      await line.close();
      await Promise.all([first.close(), second.close()]);
    }
  });
});
