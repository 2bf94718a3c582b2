/**
 * Detects problems of cameras from the states that the server sends twice a second. The server's counts are cumulative,
 * so `FrameCounters` keeps those of the last seconds.
 */

import { duration, fixed, whole } from "../base/format.js";

/** Time over which the growth of counts is measured, ms. */
const WINDOW_MS = 10_000;
/** Shortest time over which it is measured, ms. */
const LEAST_WINDOW_MS = 2000;
/** Shares of dropped and broken frames above which they are a problem. */
const DROPPED_SHARE = 0.2;
const BROKEN_SHARE = 0.02;
/** Latency from capture to fusion above which it is a problem, ms. */
const LATE_MS = 250;
/** Blur above which edges are located less accurately, px. */
const BLURRED_PX = 2.5;
/** Clock uncertainty above which it is a problem, ms: a position error of 2 mm for a robot at 1 m/s. */
const CLOCK_MS = 2;

/** A number that is not part of an address, file or name. */
const NUMBER = /(?<![\w.:/\u2212-])\d+(?:\.\d+)?(?![\w.:/]*[\w:/])/g;

/** @typedef {import("../wire/messages.js").Camera} Camera */
/** @typedef {{isSevere: boolean, why: string}} Problem severe: none of the camera's detections are used */
/** @typedef {{timeMs: number, frames: number, dropped: number, broken: number, missing: number}} Counts */
/** @typedef {{dropped: number, broken: number, missing: number}} Shares of the frames in the last seconds */

export class FrameCounters {
  constructor() {
    /** @type {Map<string, Counts[]>} by camera */
    this.counts = new Map();
  }

  /** @param {Camera[]} cameras @param {number} nowMs */
  take(cameras, nowMs) {
    const names = new Set(cameras.map((camera) => camera.name));
    for (const name of this.counts.keys()) if (!names.has(name)) this.counts.delete(name);
    for (const { name, frames, dropped, broken, link } of cameras) {
      const held = this.counts.get(name) ?? [];
      const fresh = { timeMs: nowMs, frames, dropped, broken, missing: link?.missing ?? 0 };
      // A restarted server counts from zero.
      if (held.some((one) => one.frames > frames)) held.length = 0;
      held.push(fresh);
      while (held.length > 2 && held[1].timeMs <= nowMs - WINDOW_MS) held.shift();
      this.counts.set(name, held);
    }
  }

  /** @param {string} name @returns {Shares | null} null before the shortest time has passed */
  shares(name) {
    const held = this.counts.get(name) ?? [];
    const [first, last] = [held[0], held.at(-1)];
    if (!first || !last || last.timeMs - first.timeMs < LEAST_WINDOW_MS) return null;
    const [frames, dropped, broken, missing] = /** @type {const} */ (["frames", "dropped", "broken", "missing"]).map(
      (key) => Math.max(0, last[key] - first[key]),
    );
    const all = Math.max(1, frames + dropped + broken + missing);
    return { dropped: dropped / all, broken: broken / all, missing: missing / all };
  }
}

/**
 * Returns a camera's problems. A severe one is returned alone.
 * @param {Camera} camera
 * @param {Shares | null} shares
 * @returns {Problem[]}
 */
export function cameraProblems(camera, shares) {
  const severe = severeProblem(camera);
  if (severe) return [{ isSevere: true, why: severe }];
  return [...poseProblems(camera), ...frameProblems(camera, shares), ...pictureProblems(camera)].map((why) => ({ isSevere: false, why }));
}

/** Why none of the camera's detections are used; empty if they are. @param {Camera} camera */
function severeProblem(camera) {
  switch (camera.status) {
    case "failed":
      return `${sentence(camera.error || "The source failed without a message")} Retrying automatically.`;
    case "starting":
      return sentence(camera.error || "Opening the source");
    case "finished":
      return "The source has no more frames.";
    default:
  }
  if (!camera.pose) {
    const why = camera.poseReason ? `Pose unknown: ${camera.poseReason}` : "Pose not known yet";
    return `${sentence(why)} Its detections are not used.`;
  }
  if (camera.link && !camera.link.connected) return "No sender is connected.";
  if (camera.status === "running" && camera.frames > 0 && camera.rateHz === 0) return "No frames are arriving.";
  return "";
}

/** @param {Camera} camera */
function poseProblems({ agreement, clock }) {
  const found = [];
  const off = agreement && `${fixed(agreement.positionErrorM * 1000, 0)} mm and ${fixed((agreement.rotationErrorRad * 180) / Math.PI, 2)}°`;
  if (agreement?.state === "quarantined") found.push("The camera was bumped. It is excluded until its new pose is known.");
  if (agreement?.state === "suspected") found.push(`Disagrees with the other cameras, as if it had moved by ${off}: calibrate, or check whether it was bumped.`);
  if (clock && clock.deviationMs > CLOCK_MS) {
    found.push(`Its clock is known only to ${fixed(clock.deviationMs, 1)} ms, which reduces the accuracy of moving objects. This improves when other cameras see the same robots move.`);
  }
  return found;
}

/** @param {Camera} camera @param {Shares | null} shares */
function frameProblems(camera, shares) {
  const found = [];
  if (camera.rateReason) found.push(sentence(`It ${camera.rateReason}`));
  const percent = (/** @type {number} */ share) => `${fixed(share * 100, 0)} % of frames`;
  if (shares && shares.dropped > DROPPED_SHARE) found.push(`Dropping ${percent(shares.dropped)}: this computer is too slow.`);
  if (shares && shares.broken > BROKEN_SHARE) found.push(`${percent(shares.broken)} arrive broken: check cable, network and power.`);
  if (shares && shares.missing > BROKEN_SHARE) found.push(`${percent(shares.missing)} are lost between sender and server.`);
  if (camera.latencyMs > LATE_MS) found.push(`Detections arrive ${duration(camera.latencyMs)} late.`);
  return found;
}

/** @param {Camera} camera */
function pictureProblems({ blurPx }) {
  return blurPx !== null && blurPx > BLURRED_PX ? [`The picture is blurred by ${fixed(blurPx, 1)} px: focus the lens or shorten the exposure.`] : [];
}

/** @param {string} words */
function sentence(words) {
  return `${words.charAt(0).toUpperCase()}${words.slice(1)}`.replace(/([^.!?])$/, "$1.");
}

/**
 * Summarises all cameras: "1 camera failed, 3 degraded". A camera with a severe problem whose source has not failed is
 * "not in use".
 * @param {{camera: Camera, problems: Problem[]}[]} cameras
 */
export function healthSummary(cameras) {
  if (cameras.length === 0) return "No cameras";
  const states = cameras.map(({ camera, problems }) => {
    if (problems.length === 0) return "OK";
    return camera.status === "failed" ? "failed" : problems[0].isSevere ? "not in use" : "degraded";
  });
  const counts = ["failed", "not in use", "degraded"]
    .map((state) => ({ state, count: states.filter((one) => one === state).length }))
    .filter(({ count }) => count > 0);
  if (counts.length === 0) return cameras.length === 1 ? "Camera OK" : `All ${whole(cameras.length)} cameras OK`;
  const unit = counts[0].count === 1 ? "camera" : "cameras";
  return counts.map(({ state, count }, i) => `${whole(count)} ${i === 0 ? `${unit} ` : ""}${state}`).join(", ");
}

/** Latencies of the snapshots in the last minute. */
export class Latencies {
  constructor() {
    this.values = new Float32Array(3600);
    this.next = 0;
    this.count = 0;
  }

  /** @param {number} ms */
  take(ms) {
    this.values[this.next] = ms;
    this.next = (this.next + 1) % this.values.length;
    this.count = Math.min(this.count + 1, this.values.length);
  }

  clear() {
    this.next = 0;
    this.count = 0;
  }

  /** Quantiles of the latencies. @param {number[]} shares @returns {(number | null)[]} ms */
  quantiles(shares) {
    const sorted = this.values.slice(0, this.count).sort();
    return shares.map((share) => (this.count > 0 ? sorted[Math.min(this.count - 1, Math.floor(share * this.count))] : null));
  }

  /**
   * Histogram with even steps that hold nearly all values; the last step also holds all larger ones.
   * @param {number} steps
   * @returns {{stepMs: number, shares: number[]}}
   */
  histogram(steps) {
    const [most] = this.quantiles([0.98]);
    const stepMs = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].find((step) => step * steps > (most ?? 0)) ?? 2000;
    const shares = new Array(steps).fill(0);
    for (let i = 0; i < this.count; i += 1) shares[Math.min(steps - 1, Math.max(0, Math.floor(this.values[i] / stepMs)))] += 1 / this.count;
    return { stepMs, shares };
  }
}

/**
 * Groups cameras with the same problems. Numbers may differ: "Dropping 39 % of frames" and "Dropping 35 % of frames"
 * become "Dropping 35–39 % of frames".
 * @param {{name: string, problems: Problem[]}[]} cameras
 * @returns {{names: string[], why: string, isSevere: boolean}[]} ordered by each group's first camera
 */
export function groupProblems(cameras) {
  /** @type {Map<string, {names: string[], words: string[], isSevere: boolean}>} */
  const groups = new Map();
  for (const { name, problems } of cameras) {
    const why = problems.map((one) => one.why).join(" ");
    const kind = why.replaceAll(NUMBER, "#");
    const group = groups.get(kind) ?? { names: [], words: [], isSevere: problems[0].isSevere };
    group.names.push(name);
    group.words.push(why);
    groups.set(kind, group);
  }
  return [...groups.values()].map(({ names, words, isSevere }) => ({ names, why: spanned(words), isSevere }));
}

/** Merges texts that differ only in their numbers into one with ranges. @param {string[]} words */
function spanned(words) {
  const numbers = words.map((text) => text.match(NUMBER) ?? []);
  let place = 0;
  return words[0].replaceAll(NUMBER, () => {
    const here = numbers.map((all) => all[place]).sort((a, b) => Number(a) - Number(b));
    place += 1;
    const [least, most] = [here[0], here[here.length - 1]];
    return least === most ? least : `${least}–${most}`;
  });
}
