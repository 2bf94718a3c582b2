/**
 * State of the page: the newest snapshot, the last minute, cameras, events, selection.
 *
 * Views subscribe to topics and read the state; only the methods here change it.
 */

import { Latencies, FrameCounters } from "./camera-health.js";
import { History, placeIn } from "./history.js";
import { moveWithCarrier } from "./mounted-cameras.js";
import { Track } from "./track.js";

/** Length of a trail, ms. */
export const TRAIL_MS = 5000;
/** Time for which a lost object stays in view, ms of pose time. */
const LOST_SHOWN_MS = 4000;
/** Largest number of stored events. */
const MAX_EVENTS = 200;
/** Time without a report after which the data's age grows with the clock, ms. */
const SILENT_MS = 500;
/** Decrease of the pose time that means a backward seek of a replay, ms. */
const BACK_MS = 500;

/** @typedef {import("./object-state.js").ObjectState} ObjectState */
/** @typedef {import("./history.js").Frame} Frame */
/**
 * A snapshot as worker-runtime.js packs it for the page.
 * @typedef {object} PackedSnapshot
 * @property {string} sourceId
 * @property {Frame} frame
 * @property {Frame} lost recently lost objects that are still shown
 * @property {[number, import("./history.js").Identity][]} identities new or changed identities, by id
 * @property {string[]} cameraNames
 */
/** @typedef {"snapshot" | "report" | "time" | "cameras" | "events" | "selection" | "connection" | "info"} Topic */
/** @typedef {{paused: boolean, ended: boolean}} ReplayState */

export class Store {
  constructor() {
    /** @type {{sourceId: string, poseTimeMs: number} | null} the newest snapshot */
    this.snapshot = null;
    /** @type {Map<number, Track>} objects of the newest snapshot, by id */
    this.live = new Map();
    /** The last minute of all objects. */
    this.history = new History();
    /** Recent frame counts of the cameras. */
    this.frameCounters = new FrameCounters();
    this.latencies = new Latencies();
    /** @type {number | null} pose time of the instant shown; null: now */
    this.pastMs = null;
    /** @type {Map<number, Track>} objects at that instant, by id */
    this.past = new Map();
    /** @type {import("../wire/messages.js").Camera[]} */
    this.cameras = [];
    /** True once the server has sent its list of cameras, even an empty one. */
    this.camerasKnown = false;
    /** @type {(import("../wire/messages.js").Event & {connectionNumber: number})[]} newest first */
    this.events = [];
    /** Number of the current connection, to recognise events of earlier ones. */
    this.connectionNumber = 0;
    /** @type {import("../wire/messages.js").ServerInfo | null} */
    this.info = null;
    /** @type {import("./session.js").Session | null} null: the server has no sessions, or has not answered yet */
    this.session = null;
    /** @type {ReplayState | null} state of the replay; null: live */
    this.replay = null;
    /** @type {import("../wire/connection.js").ConnectionState} */
    this.connection = { phase: "connecting", sinceMs: performance.now(), retryAtMs: null };
    /** @type {import("./stream-statistics.js").StreamReport} */
    this.report = { rateHz: null, ageMs: null, receivedAtMs: null, missed: 0, latenciesMs: [] };
    /** `performance.now()` of the last report. */
    this.reportedAtMs = 0;
    /** @type {number | null} id of the selected object */
    this.selected = null;
    /** @type {ObjectState | null} last values of the selected object, kept after it is gone */
    this.selectedState = null;
    /** True while the arena keeps the selected object centred. */
    this.following = false;
    /** @type {Map<Topic, Set<() => void>>} */
    this.listeners = new Map();
  }

  /** Objects shown: now, or at the past instant. */
  get tracks() {
    return this.pastMs === null ? this.live : this.past;
  }

  /** Pose time shown, ms. */
  get shownMs() {
    return this.pastMs ?? this.snapshot?.poseTimeMs ?? 0;
  }

  /**
   * @param {Topic} topic
   * @param {() => void} listener
   */
  on(topic, listener) {
    const listeners = this.listeners.get(topic) ?? new Set();
    listeners.add(listener);
    this.listeners.set(topic, listeners);
  }

  /** @param {Topic} topic */
  emit(topic) {
    for (const listener of this.listeners.get(topic) ?? []) listener();
  }

  /** @param {import("../wire/messages.js").Message} message */
  take({ snapshot, cameras, event }) {
    if (snapshot) this.takeSnapshot(snapshot);
    if (cameras) {
      this.cameras = cameras;
      this.camerasKnown = true;
      this.frameCounters.take(this.cameras, performance.now());
      this.carryCameras();
      this.emit("cameras");
    }
    if (event) this.takeEvent(event);
  }

  /** @param {import("../wire/messages.js").Snapshot} snapshot */
  takeSnapshot(snapshot) {
    this.begin(snapshot);
    const live = new Set();
    for (const state of snapshot.objects) {
      live.add(state.id);
      this.takeState(state, snapshot.poseTimeMs);
    }
    for (const [id, track] of this.live) {
      if (live.has(id)) continue;
      // The server sends a lost object once. It stays in view for a while; an object that vanishes
      // otherwise is removed at once.
      const shownUntilMs = track.lostAtMs === null ? 0 : track.lostAtMs + LOST_SHOWN_MS;
      if (snapshot.poseTimeMs > shownUntilMs) this.live.delete(id);
    }
    this.history.take(snapshot.poseTimeMs, snapshot.objects);
    this.finish();
  }

  /** Stores a snapshot that the worker has decoded and packed. @param {PackedSnapshot} packed */
  takePackedSnapshot({ sourceId, frame, lost, identities, cameraNames }) {
    this.begin({ sourceId, poseTimeMs: frame.timeMs });
    const { history, live } = this;
    history.cameraNames = cameraNames;
    for (const [id, identity] of identities) history.identities.set(id, identity);
    history.adopt(frame);
    history.forgetGone();
    for (const [id, { place }] of live) if (!isIn(frame, id, place?.at ?? 0) && !isIn(lost, id, 0)) live.delete(id);
    for (const part of [frame, lost]) {
      for (let i = 0; i < part.count; i += 1) {
        const track = live.get(part.ids[i]) ?? new Track(part.ids[i]);
        track.lie(history, part, i);
        live.set(track.id, track);
      }
    }
    const selected = this.selected === null || this.pastMs !== null ? null : live.get(this.selected);
    if (selected) this.selectedState = selected.state;
    this.finish();
  }

  /** @param {{sourceId: string, poseTimeMs: number}} snapshot */
  begin({ sourceId, poseTimeMs }) {
    // A restarted server reuses object ids.
    if (this.snapshot && this.snapshot.sourceId !== sourceId) this.forget();
    else if (this.snapshot && poseTimeMs < this.snapshot.poseTimeMs - BACK_MS) this.clearTracks();
    this.snapshot = { sourceId, poseTimeMs };
  }

  finish() {
    // If the instant shown leaves the history, show the oldest one.
    if (this.pastMs !== null && this.pastMs < (this.history.oldestMs ?? 0)) this.seekTo(this.history.oldestMs);
    this.carryCameras();
    this.emit("snapshot");
  }

  /** Updates the poses of mounted cameras from the newest snapshot. */
  carryCameras() {
    if (!this.cameras.some((camera) => camera.mount)) return;
    const objects = [...this.live.values()].map(({ state }) => state);
    this.cameras = this.cameras.map((camera) => moveWithCarrier(camera, objects));
  }

  /** @param {import("./stream-statistics.js").StreamReport} report */
  takeReport(report) {
    this.report = report;
    this.reportedAtMs = performance.now();
    // Latencies in a replay are not those of this server.
    if (!this.info?.replays) for (const latencyMs of report.latenciesMs) this.latencies.take(latencyMs);
    this.emit("report");
  }

  /**
   * @param {ObjectState} state
   * @param {number} timeMs
   */
  takeState(state, timeMs) {
    let track = this.live.get(state.id);
    if (!track) {
      track = new Track(state.id);
      this.live.set(state.id, track);
    }
    track.held = state;
    if (state.stage === "lost") track.lostAtMs ??= timeMs;
    else track.lostAtMs = null;
    if (state.id === this.selected && this.pastMs === null) this.selectedState = state;
  }

  /**
   * Shows an instant of the last minute; null returns to now.
   * @param {number | null} timeMs
   */
  seekTo(timeMs) {
    const { oldestMs, newestMs } = this.history;
    const there = timeMs !== null && oldestMs !== null && newestMs !== null && timeMs < newestMs;
    this.pastMs = there ? Math.max(timeMs, oldestMs) : null;
    this.past = new Map();
    if (this.pastMs !== null) {
      for (const state of this.history.at(this.pastMs)) this.past.set(state.id, Track.of(state));
    }
    if (this.selected !== null) this.selectedState = this.tracks.get(this.selected)?.state ?? this.selectedState;
    this.emit("time");
  }

  /** @param {import("../wire/messages.js").Event} event */
  takeEvent(event) {
    // Each connection begins with the server's recent events; known ones are replaced.
    const others = this.events.filter((known) => known.sequence !== event.sequence);
    others.push({ ...event, connectionNumber: this.connectionNumber });
    others.sort((a, b) => b.sequence - a.sequence);
    this.events = others.slice(0, MAX_EVENTS);
    this.emit("events");
  }

  /** Clears tracks, history and latencies. */
  clearTracks() {
    this.live.clear();
    this.history.clear();
    this.latencies.clear();
    if (this.pastMs !== null) this.seekTo(null);
  }

  /** Clears everything that belongs to an earlier run of the server. */
  forget() {
    this.clearTracks();
    // The new run's first events arrive before its first snapshot, by which it is recognised.
    this.events = this.events.filter((event) => event.connectionNumber === this.connectionNumber);
    this.select(null);
    this.emit("events");
  }

  /** @param {import("../wire/messages.js").ServerInfo} info */
  setInfo(info) {
    this.info = info;
    this.emit("info");
  }

  /** @param {import("./session.js").Session | null} session */
  setSession(session) {
    this.session = session;
  }

  /** @param {ReplayState | null} replay */
  setReplay(replay) {
    this.replay = replay;
  }

  /** @param {import("../wire/connection.js").ConnectionState} connection */
  setConnection(connection) {
    if (connection.phase !== this.connection.phase && connection.phase === "live") this.connectionNumber += 1;
    this.connection = connection;
    this.emit("connection");
  }

  /** @param {number | null} id */
  select(id) {
    if (id === this.selected) return;
    this.selected = id;
    this.selectedState = id === null ? null : (this.tracks.get(id)?.state ?? null);
    if (id === null) this.following = false;
    this.emit("selection");
  }

  /** @param {boolean} following */
  follow(following) {
    const wanted = following && this.selected !== null;
    if (wanted === this.following) return;
    this.following = wanted;
    this.emit("selection");
  }

  /** Selects the object after (or before) the selected one in the order of the list. @param {1 | -1} step */
  selectNext(step) {
    const ids = this.sortedTracks().map((track) => track.id);
    if (ids.length === 0) return;
    const at = this.selected === null ? -1 : ids.indexOf(this.selected);
    const next = at < 0 ? (step > 0 ? 0 : ids.length - 1) : (at + step + ids.length) % ids.length;
    this.select(ids[next]);
  }

  /** @returns {Track[]} by object id */
  sortedTracks() {
    return [...this.tracks.values()].sort((a, b) => a.id - b.id);
  }

  /** Age of the newest capture shown, ms: as reported, plus the time since the last report if that is long. */
  dataAgeMs() {
    const { ageMs } = this.report;
    const silentMs = performance.now() - this.reportedAtMs;
    return ageMs === null ? null : ageMs + (silentMs > SILENT_MS ? silentMs : 0);
  }
}

/** Whether a frame has an object. @param {Frame} frame @param {number} id @param {number} hint */
function isIn(frame, id, hint) {
  return placeIn(frame, id, hint) >= 0;
}
