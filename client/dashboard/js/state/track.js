/** Current state of an object: decoded, or its place in a packed frame, which is decoded on demand. */

import { STAGES } from "./object-state.js";

/** @typedef {import("./object-state.js").ObjectState} ObjectState */
/** @typedef {import("./history.js").Frame} Frame */

export class Track {
  /** @param {number} id */
  constructor(id) {
    this.id = id;
    /** @type {number | null} pose time when it was lost, ms */
    this.lostAtMs = null;
    /** @type {ObjectState | null} */
    this.held = null;
    /** @type {{history: import("./history.js").History, frame: Frame, at: number} | null} */
    this.place = null;
  }

  /** @param {ObjectState} state */
  static of(state) {
    const track = new Track(state.id);
    track.held = state;
    return track;
  }

  /** Sets its place in a packed frame. @param {import("./history.js").History} history @param {Frame} frame @param {number} at */
  lie(history, frame, at) {
    this.held = null;
    this.place = { history, frame, at };
  }

  /** @returns {ObjectState} */
  get state() {
    const { place } = this;
    if (!this.held && place) this.held = place.history.read(place.frame, place.at);
    return /** @type {ObjectState} */ (this.held);
  }

  /** @returns {import("./object-state.js").Stage} */
  get stage() {
    return this.held || !this.place ? this.state.stage : STAGES[this.place.frame.flags[this.place.at] & 7];
  }
}
