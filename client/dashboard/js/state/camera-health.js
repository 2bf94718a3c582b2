/**
 * Which cameras are unwell, and why: judged from what the server tells of each twice a second. Pure, but for what it
 * remembers of the last seconds, since counts say nothing and their growth does.
 */

import { duration, fixed, whole } from "../base/format.js";

/** Growth of counts is looked at over so long, ms. */
const WINDOW_MS = 10_000;
/** Growth over less says nothing, ms. */
const LEAST_WINDOW_MS = 2000;
/** Shares of frames above which it is said that they are lost. */
const DROPPED_SHARE = 0.2;
const BROKEN_SHARE = 0.02;
/** A camera whose frames are fused later than this after their capture, ms. */
const LATE_MS = 250;
/** Rims blurred more than this lose precision, px. */
const BLURRED_PX = 2.5;
/** A clock that is not known better costs a robot at 1 m/s more than 2 mm, ms. */
const CLOCK_MS = 2;

/** A number that stands for itself: those of addresses and names tell cameras apart. */
const NUMBER = /(?<![\w.:/\u2212-])\d+(?:\.\d+)?(?![\w.:/]*[\w:/])/g;

/** @typedef {import("../wire/messages.js").Camera} Camera */
/** @typedef {{isSevere: boolean, why: string}} Problem grave: nothing it sees is used */
/** @typedef {{timeMs: number, frames: number, dropped: number, broken: number, missing: number}} Counts */
/** @typedef {{dropped: number, broken: number, missing: number}} Shares of the frames of the last seconds */

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

  /** @param {string} name @returns {Shares | null} null before there is enough to say */
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
 * What is the matter with a camera, the gravest first; empty while it is well.
 * @param {Camera} camera
 * @param {Shares | null} shares
 * @returns {Problem[]}
 */
export function cameraProblems(camera, shares) {
  const grave = reasonForNothing(camera);
  if (grave) return [{ isSevere: true, why: grave }];
  return [...ofPlace(camera), ...ofFrames(camera, shares), ...ofPicture(camera)].map((why) => ({ isSevere: false, why }));
}

/** Why nothing of what it sees is used; empty if something is. @param {Camera} camera */
function reasonForNothing(camera) {
  switch (camera.status) {
    case "failed":
      return `${sentence(camera.error || "The source gave no reason")} It is retried automatically.`;
    case "starting":
      return sentence(camera.error || "The source is being opened");
    case "finished":
      return "The source has no more frames.";
    default:
  }
  if (!camera.pose) {
    const why = camera.poseReason ? `: ${camera.poseReason}` : " yet";
    return `${sentence(`Its place is not known${why}`)} What it sees is not used meanwhile.`;
  }
  if (camera.link && !camera.link.connected) return "The program that feeds it is not connected.";
  if (camera.status === "running" && camera.frames > 0 && camera.rateHz === 0) return "No frames come.";
  return "";
}

/** @param {Camera} camera */
function ofPlace({ agreement, clock }) {
  const found = [];
  const off = agreement && `${fixed(agreement.positionErrorM * 1000, 0)} mm and ${fixed((agreement.rotationErrorRad * 180) / Math.PI, 2)}°`;
  if (agreement?.state === "quarantined") found.push("It was bumped and is left out until its new place is known.");
  if (agreement?.state === "suspected") found.push(`Others see elsewhere what it sees, as if it had moved by ${off}: calibrate, or look whether it was bumped.`);
  if (clock && clock.deviationMs > CLOCK_MS) {
    found.push(`Its clock is known to ${fixed(clock.deviationMs, 1)} ms only: what moves is placed less well. It settles once others see the same robots move.`);
  }
  return found;
}

/** @param {Camera} camera @param {Shares | null} shares */
function ofFrames(camera, shares) {
  const found = [];
  if (camera.rateReason) found.push(sentence(`It ${camera.rateReason}`));
  const percent = (/** @type {number} */ share) => `${fixed(share * 100, 0)} % of its frames`;
  if (shares && shares.dropped > DROPPED_SHARE) found.push(`${percent(shares.dropped)} are left out, since this machine does not keep up.`);
  if (shares && shares.broken > BROKEN_SHARE) found.push(`${percent(shares.broken)} arrive broken: look at cable, network or power.`);
  if (shares && shares.missing > BROKEN_SHARE) found.push(`${percent(shares.missing)} are lost on the way from the program that feeds it.`);
  if (camera.latencyMs > LATE_MS) found.push(`What it sees comes ${duration(camera.latencyMs)} late.`);
  return found;
}

/** @param {Camera} camera */
function ofPicture({ blurPx }) {
  return blurPx !== null && blurPx > BLURRED_PX ? [`Its picture is blurred by ${fixed(blurPx, 1)} px: focus it, or shorten its exposure.`] : [];
}

/** @param {string} words */
function sentence(words) {
  return `${words.charAt(0).toUpperCase()}${words.slice(1)}`.replace(/([^.!?])$/, "$1.");
}

/**
 * All cameras in a sentence.
 * @param {number} all
 * @param {number} ill
 */
export function healthSummary(all, ill) {
  if (all === 0) return "No cameras";
  if (ill === 0) return all === 1 ? "Camera well" : `All ${whole(all)} cameras well`;
  return `${whole(ill)} of ${whole(all)} ${all === 1 ? "camera" : "cameras"} unwell`;
}

/** How late snapshots are, over the last minute. */
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

  /** So much of all are below. @param {number[]} shares @returns {(number | null)[]} ms */
  quantiles(shares) {
    const sorted = this.values.slice(0, this.count).sort();
    return shares.map((share) => (this.count > 0 ? sorted[Math.min(this.count - 1, Math.floor(share * this.count))] : null));
  }

  /**
   * Shares by lateness, in even steps up to where nearly all lie; the last one holds what is beyond.
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
 * Groups cameras with the same problems. Numbers may differ: "39 % of its frames" and "35 % of its frames" are combined
 * as "35 to 39 %".
 * @param {{name: string, problems: Problem[]}[]} cameras
 * @returns {{names: string[], why: string, isSevere: boolean}[]} in the order of the first of each
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

/** Texts that differ in their numbers alone, as one. @param {string[]} words */
function spanned(words) {
  const numbers = words.map((text) => text.match(NUMBER) ?? []);
  let place = 0;
  return words[0].replaceAll(NUMBER, () => {
    const here = numbers.map((all) => all[place]).sort((a, b) => Number(a) - Number(b));
    place += 1;
    const [least, most] = [here[0], here[here.length - 1]];
    return least === most ? least : `${least} to ${most}`;
  });
}
