/**
 * Takes the pictures of all views for the documentation: `npm run pictures`. It uses the real server (ROUNDEL_BINARY, or
 * the debug build) with four simulated cameras, one that fails, a history, and a replay. Each view is taken light and
 * dark, wide and on a phone, into `client/pictures`; arguments select views: `npm run pictures -- top health`.
 */

import { mkdir, readdir, writeFile } from "node:fs/promises";
import { join } from "node:path";
import { fileURLToPath } from "node:url";

import { FOCAL_PX, HEIGHT, WIDTH, writeViews } from "./board.mjs";
import { launch, openDashboard } from "./harness.mjs";
import { BINARY, COMMON_CONFIG, call, cameraFile, startLab, startReplay } from "./lab.mjs";

const FOLDER = fileURLToPath(new URL("../../client/pictures", import.meta.url));
const SCREENS = {
  wide: { viewport: { width: 1440, height: 900 } },
  phone: { viewport: { width: 390, height: 844 }, hasTouch: true, deviceScaleFactor: 1.5 },
};
/** Long enough for trails, plots, the position ten seconds ago, and a recording. */
const WARM_UP_MS = 25_000;

const camera = (place) => `
[[camera]]
name = "${["south-west", "south-east", "north-west", "north-east"][place]}"
source = "sim:?seed=1&robots=12&camera=${place}"
`;
const CONFIG = `name = "Lab 2"
${COMMON_CONFIG}${[0, 1, 2, 3].map(camera).join("")}
[[camera]]
name = "gate"
source = "images:gate/*.png?fps=10&loop=true"
calibration = "camera.yaml"
pose = { position_m = [0.0, -4.5, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }

[[camera]]
name = "bench"
source = "images:board/*.pgm?fps=5&loop=true"
calibration = "bench.yaml"
pose = { position_m = [4.5, 0.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }
`;

/** @typedef {import("playwright-core").Page} Page */

/** Opens each view. @type {Record<string, (page: Page) => Promise<unknown>>} */
const VIEWS = {
  top: (page) => select(page),
  space: async (page) => {
    await select(page);
    await mode(page, "space");
  },
  health: (page) => mode(page, "health"),
  past: async (page) => {
    await select(page);
    await page.locator("#past").fill("-10");
  },
  history: (page) => page.locator("#history-open").click(),
  calibration: (page) => page.locator("#calibrate").click(),
  camera: async (page) => {
    await page.locator("#add-camera").click();
    await page.locator("#setup-name").fill("balcony");
    await page.locator("#setup-source").fill("sim:?seed=1&robots=12&camera=2");
    await page.locator("#setup-try").click();
    await page.waitForTimeout(4000);
  },
  objects: (page) => page.locator("#add-object").click(),
  print: (page) => page.locator("#print-open").click(),
  coverage: async (page) => {
    await page.locator("#plan-open").click();
    await page.waitForTimeout(3000);
  },
  lens: async (page) => {
    await call(lab, "DELETE", "lens");
    await page.getByRole("button", { name: "Calibrate the lens of camera bench" }).click();
    await page.locator("#lens-start").click();
    await page.waitForTimeout(4000);
  },
  recordings: (page) => page.locator("#record").click(),
  help: (page) => page.keyboard.press("?"),
};

async function select(page) {
  await page.keyboard.press("/");
  await page.keyboard.type("7");
  await page.keyboard.press("Enter");
}

const mode = (page, value) => page.locator(`input[name=mode][value=${value}]`).check();

/** Saves a screenshot as WebP, a tenth of the size of a PNG. @param {Page} page @param {string} name */
async function keep(page, name) {
  const png = (await page.screenshot()).toString("base64");
  const blank = await page.context().newPage();
  const webp = await blank.evaluate(async (text) => {
    const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const image = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [image.width, image.height];
    canvas.getContext("2d").drawImage(image, 0, 0);
    return canvas.toDataURL("image/webp", 0.8).split(",")[1];
  }, png);
  await blank.close();
  await writeFile(join(FOLDER, `${name}.webp`), Buffer.from(webp, "base64"));
}

/** @param {string} url @param {string} view @param {(page: Page) => Promise<unknown>} bring */
async function take(url, view, bring) {
  for (const [screen, options] of Object.entries(SCREENS)) {
    const { page, context } = await openDashboard(browser, url, options);
    // The page's own history must be long enough for the time line.
    await page.waitForTimeout(view === "past" ? 13_000 : 4_000);
    await bring(page);
    for (const colorScheme of /** @type {const} */ (["light", "dark"])) {
      await page.emulateMedia({ colorScheme });
      await page.waitForTimeout(2_000);
      await keep(page, `${view}-${screen}-${colorScheme}`);
    }
    await context.close();
  }
}

const wanted = process.argv.slice(2);
const isWanted = (view) => wanted.length === 0 || wanted.includes(view);
await mkdir(FOLDER, { recursive: true });
const lab = await startLab(CONFIG, { "bench.yaml": cameraFile("bench", [WIDTH, HEIGHT], FOCAL_PX), prepare: (folder) => writeViews(BINARY, folder) });
const browser = await launch({ space: true });
await call(lab, "POST", "recording", { name: "docking" });
await new Promise((resolve) => setTimeout(resolve, WARM_UP_MS));
for (const [view, bring] of Object.entries(VIEWS)) if (isWanted(view)) await take(lab.url, view, bring);
if (isWanted("replay")) {
  await call(lab, "DELETE", "recording");
  const [file] = await readdir(join(lab.folder, "recordings"));
  const replay = await startReplay(join(lab.folder, "recordings", file), ["--loop"]);
  await take(replay.url, "replay", async () => {});
  await replay.close();
}
await browser.close();
await lab.close();
