/** Sign-in, the end of a session, and controls that a role does not permit, with the mock server. */

import assert from "node:assert/strict";
import { after, before, describe, test } from "node:test";

import { assertAccessible, launch, PATIENCE_MS, visit } from "./harness.mjs";
import { startMock } from "./mock.mjs";
import { MockAccess } from "./mock-access.mjs";
import { World } from "./world.mjs";

const USERS = [
  { name: "alice", role: "setup", password: "correct horse" },
  { name: "bob", role: "view", password: "battery", token: "roundel_bob" },
  { name: "olga", role: "operate", password: "staple" },
  { name: "node-1", role: "feed", token: "roundel_node" },
];
const PHONE = { viewport: { width: 390, height: 844 }, hasTouch: true };
/** Controls by the role that they need. */
const OPERATE = ["#record", "#calibrate"];
const SETUP = ["#add-camera", "#add-object", ".card .edit", ".card .find-lens", "#name-object"];

class Recorder extends World {
  info() {
    return { ...super.info(), records: true };
  }
}

let browser;
before(async () => {
  browser = await launch();
});
after(() => browser?.close());

/**
 * Opens the page of a mock server; the page may be waiting for credentials.
 * @param {{access?: MockAccess | null, world?: World, context?: object}} options
 * @param {(page: import("playwright-core").Page, opened: {access: MockAccess, asked: string[], closeStreams: () => void}) => Promise<unknown>} body
 */
async function open({ access = new MockAccess(USERS), world = new Recorder(), context = {} }, body) {
  const server = await startMock({ access, world });
  const opened = await browser.newContext({ viewport: { width: 1440, height: 900 }, ...context });
  const page = await opened.newPage();
  page.setDefaultTimeout(PATIENCE_MS);
  // Without a description, every call counts as offered.
  await opened.route("**/openapi.json", (route) => route.fulfill({ json: {} }));
  await opened.route("**/api/v1/recording", (route) => route.fulfill({ json: { state: "idle" } }));
  /** @type {string[]} */
  const asked = [];
  page.on("request", (request) => asked.push(new URL(request.url()).pathname));
  page.on("websocket", (socket) => asked.push(new URL(socket.url()).pathname));
  try {
    await page.goto(server.url);
    await body(page, { access, asked, closeStreams: server.closeStreams });
  } finally {
    await opened.close();
    await server.close();
  }
}

const live = (page) => page.locator('body[data-phase="live"]').waitFor();
const dialog = (page) => page.getByRole("dialog", { name: "Sign in" });
const closed = (page) => page.locator("#sign-in:not([open])").waitFor({ state: "attached" });

async function signIn(page, name) {
  await page.locator("#sign-in-name").fill(name);
  await page.locator("#sign-in-password").fill(USERS.find((user) => user.name === name).password);
  await page.keyboard.press("Enter");
  await closed(page);
  await live(page);
}

/** Waits until the controls have been shown or hidden by the server's info. */
async function knownControls(page) {
  await page.locator("#print-open").waitFor();
  await page.locator("[data-camera-card]").first().waitFor();
  await page.locator("#object-rows tr").first().waitFor();
  await page.keyboard.press("n");
  await page.locator("#selection").waitFor();
}

/** Ends all sessions when a source is tested: the page's other requests could be refused before. */
async function endAtTest(page, access) {
  const end = (route) => {
    access.sessions.clear();
    return route.continue();
  };
  await page.route("**/sources/test", end, { times: 1 });
}

async function assertShown(page, controls, isShown) {
  for (const control of controls) assert.equal(await page.locator(control).first().isVisible(), isShown, control);
}

describe("a server that needs credentials", () => {
  test("is asked for nothing else before the sign-in, which the keyboard reaches", async () => {
    await open({}, async (page, { access, asked }) => {
      await dialog(page).waitFor();
      assert.equal(await page.locator("#sign-in-name").evaluate((it) => it === document.activeElement), true);
      assert.equal(await page.locator("#sign-in-name").getAttribute("autocomplete"), "username");
      assert.equal(await page.locator("#sign-in-password").getAttribute("autocomplete"), "current-password");
      for (let press = 0; press < 3; press += 1) await page.keyboard.press("Escape");
      await dialog(page).waitFor();
      assert.deepEqual(asked.filter((path) => path.startsWith("/api")), ["/api/v1/session"]);

      await page.keyboard.type("alice");
      await page.keyboard.press("Tab");
      await page.keyboard.type("wrong");
      await page.keyboard.press("Enter");
      await page.getByRole("alert").filter({ hasText: "Name or password is wrong." }).waitFor();
      // The wrong password is selected.
      await page.keyboard.type("correct horse");
      await page.keyboard.press("Enter");
      await live(page);
      await page.locator("#user-name", { hasText: "alice" }).waitFor();
      assert.equal(await page.locator("#user-role").innerText(), "setup");
      assert.deepEqual(access.refused, []);
    });
  });

  test("takes a token, but not one of a program", async () => {
    await open({}, async (page) => {
      await page.getByRole("radio", { name: "Token" }).check();
      await page.locator("#sign-in-token").fill("roundel_node");
      await page.keyboard.press("Enter");
      await page.getByRole("alert").filter({ hasText: "“node-1” has the role “feed”" }).waitFor();
      await page.locator("#sign-in-token").fill("roundel_bob");
      await page.keyboard.press("Enter");
      await live(page);
      await page.locator("#user-name", { hasText: "bob" }).waitFor();
    });
  });

  test("asks again after a sign-out", async () => {
    await open({}, async (page, { access }) => {
      await signIn(page, "bob");
      await page.getByRole("button", { name: "Sign out" }).click();
      await dialog(page).waitFor();
      assert.equal(access.sessions.size, 0);
    });
  });

  for (const [where, context] of Object.entries({ "light": {}, "dark": { colorScheme: "dark" }, "on a phone": PHONE })) {
    test(`has an accessible sign-in and header, ${where}`, async () => {
      await open({ context }, async (page) => {
        await dialog(page).waitFor();
        await assertAccessible(page);
        const { scrollWidth, innerWidth } = await page.evaluate(() => ({ scrollWidth: document.documentElement.scrollWidth, innerWidth }));
        assert.ok(scrollWidth <= innerWidth, `${scrollWidth} pixels wide`);
        await signIn(page, "olga");
        await knownControls(page);
        await assertAccessible(page, ".masthead");
        const box = await page.locator("#sign-out").boundingBox();
        assert.ok(box.x >= 0 && box.x + box.width <= innerWidth, "the button is in view");
      });
    });
  }
});

describe("controls that a role does not permit", () => {
  test("are hidden: a user with the role view changes nothing", async () => {
    await open({}, async (page, { access }) => {
      await signIn(page, "bob");
      await knownControls(page);
      await assertShown(page, [...OPERATE, ...SETUP], false);
      // Its kinds of roundels come from the configuration, which needs the role setup.
      await page.locator("#print-open").click();
      await page.locator("#print[open]").waitFor();
      assert.deepEqual(access.refused, []);
    });
  });

  test("are hidden: operate changes no set-up; and setup sees all", async () => {
    await open({}, async (page) => {
      await signIn(page, "olga");
      await knownControls(page);
      await assertShown(page, OPERATE, true);
      await assertShown(page, SETUP, false);
      await page.getByRole("button", { name: "Sign out" }).click();
      await signIn(page, "alice");
      await knownControls(page);
      await assertShown(page, [...OPERATE, ...SETUP], true);
    });
  });

  test("are hidden in a replay, which still says that it is one", async () => {
    class Replayed extends World {
      info() {
        return { ...super.info(), replays: true };
      }
    }
    await open({ world: new Replayed() }, async (page) => {
      /** @type {string[]} */
      const methods = [];
      await page.route("**/api/v1/replay", (route) => {
        methods.push(route.request().method());
        return route.fulfill({ json: { file: "run.mcap", paused: false, speed: 1, looping: false, position_s: 1, duration_s: 60, begin_time_ns: "0", ended: false, damage: "" } });
      });
      await signIn(page, "bob");
      await page.locator("#replay-file", { hasText: "run.mcap" }).waitFor();
      await page.locator("#replay-pause").waitFor({ state: "hidden" });
      await assertShown(page, ["#replay-pause", "#replay-position", "#replay-speed", "#replay-loop"], false);
      await page.locator("#arena-stage").focus();
      await page.keyboard.press(" ");
      await page.getByRole("button", { name: "Sign out" }).click();
      await signIn(page, "olga");
      await page.locator("#replay-pause").waitFor();
      await page.locator("#arena-stage").focus();
      await page.keyboard.press(" ");
      await page.waitForRequest((request) => request.method() === "GET" && request.url().endsWith("/replay"));
      assert.equal(methods.filter((method) => method === "PATCH").length, 1);
    });
  });
});

describe("the end of a session", () => {
  test("leads to the sign-in, once, and keeps what was typed", async () => {
    await open({}, async (page, { access, asked }) => {
      await signIn(page, "alice");
      await knownControls(page);
      await page.locator("#add-camera").click();
      await page.locator("#setup-name").fill("gate");
      await page.locator("#setup-source").fill("http://10.0.0.2/stream");
      await endAtTest(page, access);
      await page.locator("#setup-try").click();
      await page.getByText("The session has ended. Sign in again.").waitFor();
      assert.equal(await page.locator("dialog[open]").count(), 2);
      // Requests in progress end, and none are sent while the page waits.
      await page.waitForTimeout(1000);
      asked.length = 0;
      await page.waitForTimeout(3000);
      assert.deepEqual(asked, []);
      // The name is still there.
      await page.locator("#sign-in-password:focus").fill("correct horse");
      await page.keyboard.press("Enter");
      await closed(page);
      assert.equal(await page.locator("#setup-name").inputValue(), "gate");
      await page.locator("#setup-trouble", { hasText: "The session had ended. Try again." }).waitFor();
      await page.locator("#setup-try").click();
      await page.locator("#setup-words", { hasText: "640 × 480 pixels" }).waitFor();
    });
  });

  test("closes the forms if another user signs in", async () => {
    await open({}, async (page, { access }) => {
      await signIn(page, "alice");
      await knownControls(page);
      await page.locator("#add-camera").click();
      await page.locator("#setup-source").fill("http://10.0.0.2/secret");
      await endAtTest(page, access);
      await page.locator("#setup-try").click();
      await dialog(page).waitFor();
      await page.locator("#sign-in-name").fill("bob");
      await page.locator("#sign-in-password").fill("battery");
      await page.keyboard.press("Enter");
      await page.locator("#user-name", { hasText: "bob" }).waitFor();
      await page.locator("#setup:not([open])").waitFor({ state: "attached" });
      assert.equal(await page.locator("#setup-source").inputValue(), "");
    });
  });

  test("is noticed when the stream cannot be reopened, and a sign-in in another tab helps", async () => {
    await open({}, async (page, { access, closeStreams }) => {
      await signIn(page, "alice");
      const sessions = [...access.sessions];
      access.sessions.clear();
      closeStreams();
      await page.getByText("The session has ended. Sign in again.").waitFor();
      for (const [id, user] of sessions) access.sessions.set(id, user);
      await closed(page);
      await live(page);
    });
  });
});

describe("a server that needs no credentials", () => {
  test("shows no user, and hides what its clients may not do", async () => {
    await open({ access: new MockAccess([], "operate") }, async (page) => {
      await live(page);
      await knownControls(page);
      await assertShown(page, ["#sign-in", "#user", ...SETUP], false);
      await assertShown(page, OPERATE, true);
    });
  });

  test("may be older, without sessions", async () => {
    const server = await startMock({ access: null });
    try {
      await visit(browser, server.url, {}, async (page) => {
        await page.locator("#add-camera").waitFor();
        await assertShown(page, ["#sign-in", "#user"], false);
      });
    } finally {
      await server.close();
    }
  });
});
