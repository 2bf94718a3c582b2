/**
 * From the wire's messages to the page's own values.
 *
 * The server's messages are those of `proto/roundel/v1`, with field names as there, times as nanoseconds (in JSON
 * decimal strings), enumerations as lower-case words and absent messages as null. Everything
 * the page uses passes here once: what is unknown is left out, what is missing or not finite becomes
 * null, and nothing behind this module has to ask again.
 */

import { readObject } from "../state/state.js";
import { count, list, milliseconds, nanoseconds, number, quaternion, text, vector } from "../base/value.js";

/** @typedef {import("../base/geometry.js").Vector3} Vector3 */
/** @typedef {import("../base/geometry.js").Quaternion} Quaternion */
/** @typedef {import("../state/state.js").Stage} Stage */
/** @typedef {import("../state/state.js").ObjectState} ObjectState */
/** @typedef {"starting" | "running" | "failed" | "finished" | "unspecified"} CameraStatus */
/** @typedef {{lens: string, fxPx: number, fyPx: number, cxPx: number, cyPx: number}} Intrinsics */
/** @typedef {{sender: string, address: string, connected: boolean, missing: number, roundTripMs: number}} Link */

/**
 * @typedef {object} Snapshot
 * @property {number} sequence
 * @property {string} sourceId
 * @property {number} poseTimeMs since the Unix epoch
 * @property {number | null} latencyMs from the newest capture used to the sending of this message
 * @property {ObjectState[]} objects
 * @property {number} missed
 */

/**
 * @typedef {object} Camera
 * @property {string} name
 * @property {string} source
 * @property {CameraStatus} status
 * @property {string} error
 * @property {number} width
 * @property {number} height
 * @property {Pose | null} pose world_from_camera
 * @property {string} poseStatus how the pose is known, or why not
 * @property {string} poseReason why it is not known and what to do; empty while it is
 * @property {string} carrier name of the object that it rides on; empty of one that stands
 * @property {Pose | null} mount object_from_camera of one that rides
 * @property {Intrinsics | null} intrinsics
 * @property {number} frames
 * @property {number} dropped
 * @property {number} broken frames that arrived broken
 * @property {number} restarts
 * @property {CaptureClock | null} captureClock null before its first frame
 * @property {Link | null} link null of a camera that no program feeds
 * @property {number} rateHz
 * @property {string} rateReason how that is not what was promised; empty while it is
 * @property {number} detections
 * @property {number} detectMs
 * @property {number} latencyMs
 * @property {Clock | null} clock null while its stamps are trusted
 * @property {number | null} blurPx null before it is known
 * @property {number | null} reprojectionPx how far from where the others have objects it sees them; null where no other camera sees them
 * @property {number} promisedRateHz 0: none
 * @property {Agreement | null} agreement null while its place is not known, and of one that rides
 */

/** @typedef {{position: Vector3, orientation: Quaternion}} Pose */
/** @typedef {{base: string, deviationMs: number}} CaptureClock which clock its capture times come from */
/** @typedef {{offsetMs: number, skewPpm: number, deviationMs: number}} Clock how late its stamps are */
/** @typedef {{state: string, positionErrorM: number, positionDeviationM: number, rotationErrorRad: number, seenErrorM: number}} Agreement with the other cameras */
/** @typedef {{sequence: number, timeMs: number, kind: string, objectId: number, camera: string, message: string}} Event */
/**
 * @typedef {object} ServerInfo
 * @property {string} version
 * @property {string} sourceId
 * @property {string} name
 * @property {number | null} startedTimeMs
 * @property {number} snapshotRateHz
 * @property {boolean} records recordings can be made
 * @property {boolean} replays it plays a recording: nothing here is of now
 * @property {boolean} keepsHistory
 * @property {boolean} allowsSetup of cameras and objects, by this page
 */

const STATUSES = new Set(["starting", "running", "failed", "finished"]);

/**
 * @param {any} raw
 * @returns {Snapshot}
 */
export function readSnapshot(raw) {
  const capture = nanoseconds(raw?.capture_time_ns);
  const sent = nanoseconds(raw?.sent_time_ns);
  const pose = nanoseconds(raw?.pose_time_ns);
  return {
    sequence: count(raw?.sequence),
    sourceId: text(raw?.source_id),
    poseTimeMs: pose === null ? 0 : milliseconds(pose),
    // Both times are the server's, so no clock of this machine enters. 0 is "before the first".
    latencyMs: capture && sent ? Number(sent - capture) / 1e6 : null,
    objects: list(raw?.objects).map(readObject),
    missed: count(raw?.missed),
  };
}

/**
 * @param {any} raw
 * @returns {Camera[]}
 */
export function readCameras(raw) {
  return list(raw).map(readCamera);
}

/**
 * @param {any} raw
 * @returns {Camera}
 */
function readCamera(raw) {
  return {
    name: text(raw?.name),
    source: text(raw?.source),
    status: STATUSES.has(raw?.status) ? raw.status : "unspecified",
    error: text(raw?.error),
    width: count(raw?.width),
    height: count(raw?.height),
    pose: readPose(raw?.pose),
    poseStatus: text(raw?.pose_status),
    poseReason: text(raw?.pose_reason),
    carrier: text(raw?.carrier),
    mount: readPose(raw?.mount),
    intrinsics: readIntrinsics(raw?.intrinsics),
    frames: count(raw?.frames),
    dropped: count(raw?.dropped),
    broken: count(raw?.broken),
    restarts: count(raw?.restarts),
    captureClock: readCaptureClock(raw?.capture_clock),
    link: readLink(raw?.link),
    rateHz: count(raw?.rate_hz),
    rateReason: text(raw?.rate_reason),
    detections: count(raw?.detections),
    detectMs: count(raw?.detect_ms),
    latencyMs: count(raw?.latency_ms),
    clock: readClock(raw?.clock),
    // 0 is "not fitted".
    blurPx: number(raw?.blur_px) || null,
    // 0 is "nothing to compare with".
    reprojectionPx: number(raw?.reprojection_px) || null,
    promisedRateHz: count(raw?.promised_rate_hz),
    agreement: readAgreement(raw?.agreement),
  };
}

/** @param {any} raw @returns {Link | null} */
function readLink(raw) {
  if (!raw) return null;
  return {
    sender: text(raw.sender),
    address: text(raw.address),
    connected: raw.connected === true,
    missing: count(raw.missing),
    roundTripMs: count(raw.round_trip_ms),
  };
}

/** @param {any} raw @returns {Agreement | null} */
function readAgreement(raw) {
  if (!raw) return null;
  return {
    state: text(raw.state),
    positionErrorM: count(raw.position_error_m),
    positionDeviationM: count(raw.position_deviation_m),
    rotationErrorRad: count(raw.rotation_error_rad),
    seenErrorM: count(raw.seen_error_m),
  };
}

/** @param {any} raw @returns {CaptureClock | null} */
function readCaptureClock(raw) {
  const base = text(raw?.base);
  return base ? { base, deviationMs: count(raw?.deviation_ms) } : null;
}

/** @param {any} raw @returns {Pose | null} */
function readPose(raw) {
  const position = vector(raw?.position);
  const orientation = quaternion(raw?.orientation);
  return position && orientation && { position, orientation };
}

/**
 * Only of a camera whose clock is not simply trusted.
 *
 * @param {any} raw
 * @returns {Clock | null}
 */
function readClock(raw) {
  const deviationMs = number(raw?.deviation_ms) ?? 0;
  if (deviationMs <= 0) return null;
  return { offsetMs: number(raw?.offset_ms) ?? 0, skewPpm: number(raw?.skew_ppm) ?? 0, deviationMs };
}

/**
 * @param {any} raw
 * @returns {Intrinsics | null}
 */
function readIntrinsics(raw) {
  const [fxPx, fyPx] = [number(raw?.fx_px), number(raw?.fy_px)];
  const [cxPx, cyPx] = [number(raw?.cx_px), number(raw?.cy_px)];
  if (!fxPx || !fyPx || cxPx === null || cyPx === null) return null;
  return { lens: text(raw.lens), fxPx, fyPx, cxPx, cyPx };
}

/**
 * @param {any} raw
 * @returns {Event}
 */
export function readEvent(raw) {
  const time = nanoseconds(raw?.time_ns);
  return {
    sequence: count(raw?.sequence),
    timeMs: time === null ? 0 : milliseconds(time),
    kind: text(raw?.kind),
    objectId: count(raw?.object_id),
    camera: text(raw?.camera),
    message: text(raw?.message),
  };
}

/**
 * @param {any} raw
 * @returns {ServerInfo}
 */
export function readInfo(raw) {
  const started = nanoseconds(raw?.started_time_ns);
  return {
    version: text(raw?.version),
    sourceId: text(raw?.source_id),
    name: text(raw?.name),
    startedTimeMs: started ? milliseconds(started) : null,
    snapshotRateHz: count(raw?.snapshot_rate_hz),
    records: raw?.records === true,
    replays: raw?.replays === true,
    keepsHistory: raw?.keeps_history === true,
    allowsSetup: raw?.allows_setup === true,
  };
}
