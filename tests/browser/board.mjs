/** Renders the page of `roundel print --board` as a pinhole camera sees it while it is moved. */

import { execFileSync } from "node:child_process";
import { mkdir, readFile, writeFile } from "node:fs/promises";
import { join } from "node:path";
import { inflateSync } from "node:zlib";

export const [WIDTH, HEIGHT, FOCAL_PX] = [640, 480, 600];
const DPI = 150;
/** Centre of the board on its A4 page, mm; the printable area is not symmetric. */
const MIDDLE_MM = [145.5, 98.5];

/** Writes each view several times, since views are only taken while the board is still. @param {string} binary @param {string} folder */
export async function writeViews(binary, folder, { views = 26, held = 5 } = {}) {
  const sheet = join(folder, "board.png");
  execFileSync(binary, ["print", "--board", "7x5", "--dpi", String(DPI), sheet], { stdio: "ignore" });
  const page = decode(await readFile(sheet));
  await mkdir(join(folder, "board"));
  for (let view = 0; view < views; view += 1) {
    const picture = photograph(page, pose(view));
    for (let again = 0; again < held; again += 1) {
      await writeFile(join(folder, "board", `${String(view).padStart(3, "0")}-${again}.pgm`), picture);
    }
  }
}

/** Poses that cover the picture, with varying tilts. @param {number} view */
function pose(view) {
  const [x, y] = [(view % 3) - 1, (Math.floor(view / 3) % 3) - 1];
  const lean = [0.5 * Math.cos(2.4 * view), 0.5 * Math.sin(2.4 * view)];
  return { at: [85 * x, 60 * y, 340 + 60 * (view % 2)], lean };
}

/** Renders one view as PGM. @param {{width: number, height: number, pixels: Buffer}} page @param {{at: number[], lean: number[]}} pose */
function photograph(page, { at, lean: [a, b] }) {
  const [ca, sa, cb, sb] = [Math.cos(a), Math.sin(a), Math.cos(b), Math.sin(b)];
  // The page's right and down vectors in the camera frame, rotated about y by a, then about x by b.
  const right = [ca, sa * sb, -sa * cb];
  const down = [0, cb, sb];
  const toPage = inverse([right[0], down[0], at[0], right[1], down[1], at[1], right[2], down[2], at[2]]);
  const scale = DPI / 25.4;
  const level = (u, v) => {
    const ray = [(u - (WIDTH - 1) / 2) / FOCAL_PX, (v - (HEIGHT - 1) / 2) / FOCAL_PX, 1];
    const [x, y, w] = [0, 3, 6].map((row) => toPage[row] * ray[0] + toPage[row + 1] * ray[1] + toPage[row + 2] * ray[2]);
    const [px, py] = [(x / w + MIDDLE_MM[0]) * scale - 0.5, (y / w + MIDDLE_MM[1]) * scale - 0.5];
    if (!(px >= 0 && py >= 0 && px < page.width - 1 && py < page.height - 1)) return 110;
    const [i, j] = [Math.floor(px), Math.floor(py)];
    const [fx, fy] = [px - i, py - j];
    const of = (column, row) => page.pixels[row * page.width + column];
    const upper = of(i, j) * (1 - fx) + of(i + 1, j) * fx;
    const lower = of(i, j + 1) * (1 - fx) + of(i + 1, j + 1) * fx;
    return 25 + (upper * (1 - fy) + lower * fy) * 0.75;
  };
  const pixels = Buffer.alloc(WIDTH * HEIGHT);
  for (let v = 0; v < HEIGHT; v += 1) {
    for (let u = 0; u < WIDTH; u += 1) {
      let sum = 0;
      for (const [du, dv] of [[-0.25, -0.25], [0.25, -0.25], [-0.25, 0.25], [0.25, 0.25]]) sum += level(u + du, v + dv);
      pixels[v * WIDTH + u] = Math.round(sum / 4);
    }
  }
  return Buffer.concat([Buffer.from(`P5 ${WIDTH} ${HEIGHT} 255\n`), pixels]);
}

/** Inverse of a 3x3 matrix, row by row. @param {number[]} m */
function inverse([a, b, c, d, e, f, g, h, i]) {
  const [A, B, C] = [e * i - f * h, f * g - d * i, d * h - e * g];
  const determinant = a * A + b * B + c * C;
  return [A, c * h - b * i, b * f - c * e, B, a * i - c * g, c * d - a * f, C, b * g - a * h, a * e - b * d].map((it) => it / determinant);
}

/** Decodes an 8-bit grey PNG that is not interlaced. @param {Buffer} file */
export function decode(file) {
  let [width, height] = [0, 0];
  const parts = [];
  for (let at = 8; at < file.length; ) {
    const length = file.readUInt32BE(at);
    const kind = file.toString("latin1", at + 4, at + 8);
    const body = file.subarray(at + 8, at + 8 + length);
    if (kind === "IHDR") [width, height] = [body.readUInt32BE(0), body.readUInt32BE(4)];
    if (kind === "IHDR" && (body[8] !== 8 || body[9] !== 0)) throw new Error("expected an 8-bit grey PNG");
    if (kind === "IDAT") parts.push(body);
    at += length + 12;
  }
  const raw = inflateSync(Buffer.concat(parts));
  const pixels = Buffer.alloc(width * height);
  for (let v = 0; v < height; v += 1) {
    const filter = raw[v * (width + 1)];
    for (let u = 0; u < width; u += 1) {
      const left = u > 0 ? pixels[v * width + u - 1] : 0;
      const up = v > 0 ? pixels[(v - 1) * width + u] : 0;
      const corner = u > 0 && v > 0 ? pixels[(v - 1) * width + u - 1] : 0;
      const guess = [0, left, up, (left + up) >> 1, paeth(left, up, corner)][filter];
      pixels[v * width + u] = (raw[v * (width + 1) + 1 + u] + guess) & 255;
    }
  }
  return { width, height, pixels };
}

function paeth(left, up, corner) {
  const [toLeft, toUp, toCorner] = [up - corner, left - corner, left + up - 2 * corner].map(Math.abs);
  if (toLeft <= toUp && toLeft <= toCorner) return left;
  return toUp <= toCorner ? up : corner;
}
