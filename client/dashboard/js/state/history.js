/**
 * The last minute of all objects, ten frames a second, for trails, plots and the time line.
 *
 * Values are stored in typed arrays that are reused, so that the memory of a page that stays open does not grow. Between
 * two frames a position is interpolated by the cubic through both positions and velocities (Hermite); at 10 Hz its error
 * for a robot that accelerates at 2 m/s² is a hundredth of a millimetre.
 */

import { ObjectState, STAGES } from "./object-state.js";

/** Length of the history, ms. */
export const HISTORY_MS = 60_000;
/** Interval between two frames, ms. */
export const FRAME_MS = 100;
/** Frames further apart than this are not interpolated, ms. */
export const GAP_MS = 500;
/** Time for which a frame is valid if no other follows, as after a lost connection, ms. */
const HELD_MS = 2500;
/** Numbers stored for an object: position, velocity, quaternion, upper triangle of the position's covariance, variances
 * of the rotation, age, residual. Unknown values are NaN. */
const WIDTH = 21;
const [VELOCITY, TURN, COVARIANCE, ROTATION, AGE, RESIDUAL] = [3, 6, 10, 16, 19, 20];
/** Indices of the stored values in the 21 numbers of a covariance. */
const POSITION_ENTRIES = [0, 1, 2, 6, 7, 11];
const ROTATION_ENTRIES = [15, 18, 20];
/** 32-bit words of an object's camera bits. Further cameras are not stored. */
const CAMERA_WORDS = 4;

/** @typedef {{timeMs: number, count: number, ids: Float64Array, values: Float32Array, cameras: Int32Array, flags: Uint8Array}} Frame */
/** @typedef {{name: string, roundel: string, code: {bits: number, number: number} | null}} Identity */

export class History {
  constructor() {
    /** @type {Frame[]} ring buffer */
    this.frames = [];
    /** Index of the next frame, and number of frames. */
    this.next = 0;
    this.count = 0;
    /** @type {Map<number, Identity>} values that do not change from frame to frame */
    this.identities = new Map();
    /** @type {string[]} by bit */
    this.cameraNames = [];
  }

  clear() {
    this.count = 0;
    this.identities.clear();
    this.cameraNames = [];
  }

  /** Frame by age: 0 is the newest. @param {number} back */
  frame(back) {
    const size = this.frames.length;
    return this.frames[(this.next - 1 - back + 2 * size) % size];
  }

  get newestMs() {
    return this.count > 0 ? this.frame(0).timeMs : null;
  }

  get oldestMs() {
    return this.count > 0 ? this.frame(this.count - 1).timeMs : null;
  }

  /**
   * Stores a snapshot if the last frame is old enough.
   * @param {number} timeMs
   * @param {ObjectState[]} objects
   */
  take(timeMs, objects) {
    // The tolerance is for rounding: six snapshots at 60 Hz are 100 ms.
    if (this.newestMs !== null && timeMs - this.newestMs < FRAME_MS - 5) return;
    const frame = this.slot(objects.length);
    frame.timeMs = timeMs;
    frame.count = objects.length;
    const sorted = objects.every((state, i) => i === 0 || objects[i - 1].id < state.id)
      ? objects
      : [...objects].sort((a, b) => a.id - b.id);
    for (const [i, state] of sorted.entries()) this.write(frame, i, state);
    this.advance();
    this.forgetGone();
  }

  /** Makes the frame at `next` the newest. */
  advance() {
    this.next = (this.next + 1) % this.frames.length;
    this.count = Math.min(this.count + 1, this.frames.length);
  }

  /** Returns the frame to write next, with capacity for the objects. @param {number} objects @returns {Frame} */
  slot(objects) {
    if (this.frames.length === 0) {
      const length = HISTORY_MS / FRAME_MS + 1;
      this.frames = Array.from({ length }, () => makeFrame(0));
    }
    if (this.frames[this.next].ids.length < objects) this.frames[this.next] = makeFrame(Math.ceil(objects * 1.25));
    return this.frames[this.next];
  }

  /** @param {Frame} frame @param {number} i @param {ObjectState} state */
  write(frame, i, state) {
    const { values } = frame;
    const at = i * WIDTH;
    const { positionM: p, velocityMS: v, orientation: q, covariance } = state;
    frame.ids[i] = state.id;
    frame.flags[i] = STAGES.indexOf(state.stage) | (state.yawObserved ? 8 : 0) | (state.isHeadingAmbiguous ? 16 : 0);
    this.writeCameras(frame.cameras, i * CAMERA_WORDS, state.cameras);
    values[at] = p ? p.x : NaN;
    values[at + 1] = p ? p.y : NaN;
    values[at + 2] = p ? p.z : NaN;
    values[at + VELOCITY] = v ? v.x : NaN;
    values[at + VELOCITY + 1] = v ? v.y : NaN;
    values[at + VELOCITY + 2] = v ? v.z : NaN;
    values[at + TURN] = q ? q.x : NaN;
    values[at + TURN + 1] = q ? q.y : NaN;
    values[at + TURN + 2] = q ? q.z : NaN;
    values[at + TURN + 3] = q ? q.w : NaN;
    for (let k = 0; k < 6; k += 1) values[at + COVARIANCE + k] = covariance ? covariance[POSITION_ENTRIES[k]] : NaN;
    for (let k = 0; k < 3; k += 1) values[at + ROTATION + k] = covariance ? covariance[ROTATION_ENTRIES[k]] : NaN;
    values[at + AGE] = state.ageMs ?? NaN;
    values[at + RESIDUAL] = state.residual ?? NaN;
    if (!this.identities.has(state.id)) this.identities.set(state.id, { name: "", roundel: "", code: null });
    const identity = /** @type {Identity} */ (this.identities.get(state.id));
    identity.name = state.name;
    identity.roundel = state.roundel;
    identity.code = state.code;
  }

  /** @param {Int32Array} words @param {number} from @param {string[]} names */
  writeCameras(words, from, names) {
    words.fill(0, from, from + CAMERA_WORDS);
    for (const name of names) {
      let at = this.cameraNames.indexOf(name);
      if (at < 0 && this.cameraNames.length < CAMERA_WORDS * 32) at = this.cameraNames.push(name) - 1;
      if (at >= 0) words[from + (at >> 5)] |= 1 << (at & 31);
    }
  }

  /** Packs objects into a frame of exactly their size, without storing it. @param {number} timeMs @param {ObjectState[]} objects by id @returns {Frame} */
  pack(timeMs, objects) {
    const frame = makeFrame(objects.length);
    frame.timeMs = timeMs;
    frame.count = objects.length;
    for (const [i, state] of objects.entries()) this.write(frame, i, state);
    return frame;
  }

  /** Stores a frame that another history has packed. @param {Frame} frame */
  adopt(frame) {
    this.slot(0);
    this.frames[this.next] = frame;
    this.advance();
  }

  /** Removes identities of objects that are in no frame any more. Does nothing until there are many, since it is slow. */
  forgetGone() {
    if (this.identities.size <= 2 * this.frame(0).count + 100) return;
    const kept = new Set();
    for (let back = 0; back < this.count; back += 1) {
      const { ids, count } = this.frame(back);
      for (let i = 0; i < count; i += 1) kept.add(ids[i]);
    }
    for (const id of this.identities.keys()) if (!kept.has(id)) this.identities.delete(id);
  }

  /** Age, in frames, of the newest frame that is not newer than `timeMs`; `count` if there is none. @param {number} timeMs */
  backTo(timeMs) {
    let [newer, older] = [0, this.count];
    while (newer < older) {
      const middle = (newer + older) >> 1;
      if (this.frame(middle).timeMs > timeMs) newer = middle + 1;
      else older = middle;
    }
    return newer;
  }

  /**
   * All objects at a time in the history.
   * @param {number} timeMs
   * @returns {ObjectState[]} by id; empty before the first frame and in a gap
   */
  at(timeMs) {
    const back = this.backTo(timeMs);
    if (back >= this.count) return [];
    const from = this.frame(back);
    const to = back > 0 ? this.frame(back - 1) : null;
    if (timeMs - from.timeMs > HELD_MS) return [];
    /** @type {ObjectState[]} */
    const states = [];
    for (let i = 0; i < from.count; i += 1) states.push(this.between(from, i, to, timeMs));
    return states;
  }

  /** One object at a time in the history; null if it was not there. @param {number} id @param {number} timeMs @returns {ObjectState | null} */
  one(id, timeMs) {
    const back = this.backTo(timeMs);
    if (back >= this.count || timeMs - this.frame(back).timeMs > HELD_MS) return null;
    const i = placeIn(this.frame(back), id, 0);
    return i < 0 ? null : this.between(this.frame(back), i, back > 0 ? this.frame(back - 1) : null, timeMs);
  }

  /** @param {Frame} from @param {number} i @param {Frame | null} to @param {number} timeMs */
  between(from, i, to, timeMs) {
    const state = this.read(from, i);
    const other = to && to.timeMs - from.timeMs <= GAP_MS ? placeIn(to, state.id, i) : -1;
    if (!to || other < 0) return state;
    const spanMs = to.timeMs - from.timeMs;
    const part = (timeMs - from.timeMs) / spanMs;
    const [a, b] = [i * WIDTH, other * WIDTH];
    const axis = (/** @type {number} */ k) => hermite(from.values, a + k, to.values, b + k, part, spanMs / 1000);
    if (state.positionM) state.positionM = { x: axis(0), y: axis(1), z: axis(2) };
    state.ageMs = state.ageMs === null ? null : state.ageMs + part * (to.values[b + AGE] - state.ageMs);
    return state;
  }

  /** @param {Frame} frame @param {number} i @returns {ObjectState} */
  read(frame, i) {
    const { values } = frame;
    const at = i * WIDTH;
    const three = (/** @type {number} */ k) =>
      Number.isNaN(values[at + k]) ? null : { x: values[at + k], y: values[at + k + 1], z: values[at + k + 2] };
    const turn = three(TURN);
    const id = frame.ids[i];
    const known = this.identities.get(id);
    return new ObjectState({
      id,
      name: known?.name ?? "",
      roundel: known?.roundel ?? "",
      code: known?.code ?? null,
      stage: STAGES[frame.flags[i] & 7],
      yawObserved: (frame.flags[i] & 8) !== 0,
      isHeadingAmbiguous: (frame.flags[i] & 16) !== 0,
      positionM: three(0),
      velocityMS: three(VELOCITY),
      orientation: turn && { ...turn, w: values[at + TURN + 3] },
      covariance: covarianceOf(values, at),
      cameras: this.cameraNames.filter((_, bit) => (frame.cameras[i * CAMERA_WORDS + (bit >> 5)] & (1 << (bit & 31))) !== 0),
      ageMs: orNull(values[at + AGE]),
      residual: orNull(values[at + RESIDUAL]),
    });
  }

  /**
   * Visits an object's positions from old to new.
   * @param {number} id
   * @param {number} fromMs
   * @param {number} toMs
   * @param {number} stride in frames
   * @param {(timeMs: number, x: number, y: number, z: number) => void} visit
   */
  trace(id, fromMs, toMs, stride, visit) {
    const newest = this.backTo(toMs);
    let hint = 0;
    // Strides are counted in indices of the ring buffer, so that consecutive snapshots visit the same frames.
    for (let back = Math.min(this.backTo(fromMs), this.count - 1); back >= newest; back -= 1) {
      if (stride > 1 && (this.next - 1 - back + this.frames.length) % stride !== 0) continue;
      const frame = this.frame(back);
      if (frame.timeMs < fromMs) continue;
      const i = placeIn(frame, id, hint);
      if (i < 0) continue;
      hint = i;
      const at = i * WIDTH;
      if (!Number.isNaN(frame.values[at])) visit(frame.timeMs, frame.values[at], frame.values[at + 1], frame.values[at + 2]);
    }
  }

  /**
   * An object's states as received, from old to new.
   * @param {number} id
   * @param {number} [sinceMs] only states after this time
   * @returns {{timeMs: number, state: ObjectState}[]}
   */
  of(id, sinceMs = -Infinity) {
    const states = [];
    let hint = 0;
    for (let back = this.backTo(sinceMs) - 1; back >= 0; back -= 1) {
      const frame = this.frame(back);
      const i = placeIn(frame, id, hint);
      if (i < 0) continue;
      hint = i;
      states.push({ timeMs: frame.timeMs, state: this.read(frame, i) });
    }
    return states;
  }
}

/** @param {number} capacity in objects @returns {Frame} */
function makeFrame(capacity) {
  return {
    timeMs: 0,
    count: 0,
    ids: new Float64Array(capacity),
    values: new Float32Array(capacity * WIDTH),
    cameras: new Int32Array(capacity * CAMERA_WORDS),
    flags: new Uint8Array(capacity),
  };
}

/** Index of an object in a frame, or -1. `hint` is tried first. @param {Frame} frame @param {number} id @param {number} hint */
export function placeIn(frame, id, hint) {
  if (hint < frame.count && frame.ids[hint] === id) return hint;
  let [low, high] = [0, frame.count];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (frame.ids[middle] < id) low = middle + 1;
    else high = middle;
  }
  return low < frame.count && frame.ids[low] === id ? low : -1;
}

/**
 * Cubic Hermite interpolation; linear if a velocity is unknown.
 * @param {Float32Array} from
 * @param {number} a
 * @param {Float32Array} to
 * @param {number} b
 * @param {number} t 0 to 1
 * @param {number} spanS
 */
function hermite(from, a, to, b, t, spanS) {
  const [p, q, u, v] = [from[a], to[b], from[a + VELOCITY] * spanS, to[b + VELOCITY] * spanS];
  if (Number.isNaN(u) || Number.isNaN(v)) return p + t * (q - p);
  const [t2, t3] = [t * t, t * t * t];
  return (2 * t3 - 3 * t2 + 1) * p + (t3 - 2 * t2 + t) * u + (3 * t2 - 2 * t3) * q + (t3 - t2) * v;
}

/** Expands the stored values to 21 numbers; the others are 0. @param {Float32Array} values @param {number} at */
function covarianceOf(values, at) {
  if (Number.isNaN(values[at + COVARIANCE])) return null;
  const covariance = new Array(21).fill(0);
  for (let k = 0; k < 6; k += 1) covariance[POSITION_ENTRIES[k]] = values[at + COVARIANCE + k];
  for (let k = 0; k < 3; k += 1) covariance[ROTATION_ENTRIES[k]] = values[at + ROTATION + k];
  return covariance;
}

/** @param {number} value */
function orNull(value) {
  return Number.isNaN(value) ? null : value;
}
