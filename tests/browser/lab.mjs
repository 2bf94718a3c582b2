/**
 * Starts the real server with one camera that plays pictures of a moving ring, objects, recordings and a history, in a
 * temporary folder. It needs little CPU time.
 */

import { spawn } from "node:child_process";
import { existsSync } from "node:fs";
import { mkdir, mkdtemp, readFile, rm, writeFile } from "node:fs/promises";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { fileURLToPath } from "node:url";

const TARGET = process.env.CARGO_TARGET_DIR ?? fileURLToPath(new URL("../../target", import.meta.url));
export const BINARY = process.env.ROUNDEL_BINARY ?? join(TARGET, "debug/roundel");
/** Why tests that need the server are skipped; false if it is built, or if ROUNDEL_BINARY requires it. */
export const lacking = !process.env.ROUNDEL_BINARY && !existsSync(BINARY) && `${BINARY} has not been built (cargo build -p roundel-server)`;

const [WIDTH, HEIGHT] = [160, 120];
/** A ring of 160 mm is 40 pixels wide at 3 m. */
const FOCAL_PX = 750;
const FRAMES = 50;

/** Common part of the configurations: address, recordings, history and the robots' roundel. */
export const COMMON_CONFIG = `
[server]
listen = "127.0.0.1:0"

[recording]
folder = "recordings"
min_free_mb = 1.0

[history]
file = "history.sqlite"

[[roundel]]
name = "robot"
outer_mm = 160.0
inner_mm = 64.0
`;

export const CONFIG = `# Ring lab.
name = "Ring lab"
${COMMON_CONFIG}
[[roundel]]
name = "coded"
outer_mm = 122.0
inner_mm = 70.0
code = { bits = 8, min_distance = 2 }

[[camera]]
name = "door"
source = "images:door/*.pgm?fps=25&loop=true"
calibration = "camera.yaml"
pose = { position_m = [0.0, 0.0, 3.0], orientation_xyzw = [1.0, 0.0, 0.0, 0.0] }
`;

/**
 * A camera file without distortion.
 * @param {string} name
 * @param {[number, number]} size columns and rows
 * @param {number} focalPx
 */
export const cameraFile = (name, [width, height], focalPx) => `image_width: ${width}
image_height: ${height}
camera_name: ${name}
camera_matrix: {rows: 3, cols: 3, data: [${focalPx}.0, 0.0, ${(width - 1) / 2}, 0.0, ${focalPx}.0, ${(height - 1) / 2}, 0.0, 0.0, 1.0]}
distortion_model: plumb_bob
distortion_coefficients: {rows: 1, cols: 5, data: [0.0, 0.0, 0.0, 0.0, 0.0]}
`;

/** PGM picture of a black ring on white. */
function picture(frame) {
  const turn = (2 * Math.PI * frame) / FRAMES;
  const [u0, v0] = [79.5 + 34 * Math.cos(turn), 59.5 + 22 * Math.sin(turn)];
  const pixels = Buffer.alloc(WIDTH * HEIGHT);
  for (let v = 0; v < HEIGHT; v += 1) {
    for (let u = 0; u < WIDTH; u += 1) {
      const radius = Math.hypot(u - u0, v - v0);
      const within = (edge) => Math.min(1, Math.max(0, edge - radius));
      pixels[v * WIDTH + u] = Math.round(220 - 190 * (within(20.5) - within(8.5)));
    }
  }
  return Buffer.concat([Buffer.from(`P5 ${WIDTH} ${HEIGHT} 255\n`), pixels]);
}

/**
 * @param {string} [config]
 * @param {{prepare?: (folder: string) => Promise<void>} & Record<string, any>} [more] further files by name; `prepare` runs
 * before the server starts
 */
export async function startLab(config = CONFIG, { prepare, ...files } = {}) {
  const folder = await mkdtemp(join(tmpdir(), "roundel-lab-"));
  await mkdir(join(folder, "door"));
  await mkdir(join(folder, "recordings"));
  for (let frame = 0; frame < FRAMES; frame += 1) await writeFile(join(folder, "door", `${frame}.pgm`), picture(frame));
  await writeFile(join(folder, "camera.yaml"), cameraFile("door", [WIDTH, HEIGHT], FOCAL_PX));
  await writeFile(join(folder, "lab.toml"), config);
  for (const [name, text] of Object.entries(files)) await writeFile(join(folder, name), text);
  await prepare?.(folder);
  const server = await start(["serve", "--config", join(folder, "lab.toml")], folder);
  return {
    ...server,
    folder,
    config: () => readFile(join(folder, "lab.toml"), "utf8"),
    close: async () => {
      await server.close();
      await rm(folder, { recursive: true, force: true });
    },
  };
}

/** Starts `roundel replay`. @param {string} file @param {string[]} [options] */
export function startReplay(file, options = []) {
  return start(["replay", file, "--listen", "127.0.0.1:0", ...options]);
}

/** @param {string[]} words command line @param {string} [cwd] */
async function start(words, cwd) {
  const child = spawn(BINARY, words, { cwd, stdio: ["ignore", "pipe", "pipe"] });
  const ended = new Promise((resolve) => child.once("exit", resolve));
  let output = "";
  const url = await new Promise((resolve, reject) => {
    const listen = (chunk) => {
      output += chunk;
      const address = /https?:\/\/127\.0\.0\.1:\d+/.exec(output)?.[0];
      if (address) resolve(`${address}/`);
    };
    child.stdout.on("data", listen);
    child.stderr.on("data", listen);
    child.once("error", reject);
    void ended.then(() => reject(new Error(`roundel ${words.join(" ")} ended: ${output}`)));
  });
  return {
    url,
    pid: child.pid,
    close: async () => {
      child.kill();
      await ended;
    },
  };
}

/** Calls the server's API. @param {{url: string}} server @param {string} method @param {string} path @param {object} [body] */
export async function call({ url }, method, path, body) {
  const headers = body && { "content-type": "application/json" };
  const response = await fetch(new URL(`api/v1/${path}`, url), { method, headers, body: body && JSON.stringify(body) });
  return { status: response.status, answer: await response.json() };
}
