/**
 * Converts the server's messages to the page's own types.
 *
 * The messages are those of `proto/roundel/v1`, decoded by the generated module vendor/protobuf.js or parsed from JSON.
 * Both have the field names of the .proto files. JSON has times as decimal strings and enumerations as lower-case words,
 * protobuf has numbers. Unknown fields are ignored, and missing or non-finite values become null, 0 or empty, so that the
 * rest of the page needs no checks.
 */

import { roundel } from "../../vendor/protobuf.js";
import { count, list, milliseconds, number, numbers, quaternion, text, vector } from "../base/validate.js";
import { ObjectState, STAGES } from "../state/object-state.js";

/** @typedef {import("../base/geometry.js").Vector3} Vector3 */
/** @typedef {import("../base/geometry.js").Quaternion} Quaternion */
/** @typedef {import("../state/object-state.js").Stage} Stage */
/** @typedef {import("../state/object-state.js").ObjectState} ObjectState */
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
 * @property {string} poseStatus origin of the pose, or why it is unknown
 * @property {string} poseReason why the pose is unknown and what to do; empty while it is known
 * @property {string} carrier name of the object that it is mounted on; empty for a fixed camera
 * @property {Pose | null} mount object_from_camera of a mounted camera
 * @property {Intrinsics | null} intrinsics
 * @property {number} frames
 * @property {number} dropped
 * @property {number} broken frames that arrived broken
 * @property {number} restarts
 * @property {CaptureClock | null} captureClock null before its first frame
 * @property {Link | null} link sender of a `push:` camera
 * @property {number} rateHz
 * @property {string} rateReason why the rate differs from the promised one; empty while it agrees
 * @property {number} detections
 * @property {number} detectMs
 * @property {number} budgetUsed
 * @property {number} deferred
 * @property {number} latencyMs
 * @property {Clock | null} clock null if its time stamps are exact
 * @property {number | null} blurPx null before it is known
 * @property {number | null} reprojectionPx rms reprojection error against the other cameras; null if none shares its view
 * @property {number} promisedRateHz 0: none
 * @property {Agreement | null} agreement null while its pose is unknown, and for a mounted camera
 */

/** @typedef {{snapshot?: Snapshot, cameras?: Camera[], event?: Event}} Message at most one of them */
/** @typedef {{position: Vector3, orientation: Quaternion}} Pose */
/** @typedef {{base: string, deviationMs: number}} CaptureClock source of the capture times */
/** @typedef {{offsetMs: number, skewPpm: number, deviationMs: number}} Clock delay of its time stamps */
/** @typedef {{state: string, positionErrorM: number, positionDeviationM: number, rotationErrorRad: number, seenErrorM: number}} Agreement with the other cameras */
/** @typedef {{sequence: number, timeMs: number, kind: string, objectId: number, camera: string, message: string}} Event */
/**
 * @typedef {object} ServerInfo
 * @property {string} version
 * @property {string} sourceId
 * @property {string} name
 * @property {number | null} startedTimeMs
 * @property {number} snapshotRateHz
 * @property {boolean} records can make recordings
 * @property {boolean} replays plays a recording; its data is not live
 * @property {boolean} keepsHistory
 * @property {boolean} allowsSetup this page may change cameras and objects
 */

const { AgreementState, CameraStatus, EventKind, PoseStatus, StreamMessage, TimeBase } = roundel.v1;
const WORDS = {
  agreement: wordsOf(AgreementState),
  camera: wordsOf(CameraStatus),
  event: wordsOf(EventKind),
  pose: wordsOf(PoseStatus),
  timeBase: wordsOf(TimeBase),
};
const STATUSES = new Set(["starting", "running", "failed", "finished"]);

/**
 * Names of an enumeration's values by number, as in JSON: CAMERA_STATUS_RUNNING is "running".
 * @param {Record<string, number>} enumeration
 * @returns {Map<number, string>}
 */
function wordsOf(enumeration) {
  const [[unspecified]] = Object.entries(enumeration).filter(([, number]) => number === 0);
  const prefix = unspecified.length - "UNSPECIFIED".length;
  return new Map(Object.entries(enumeration).map(([name, number]) => [number, name.slice(prefix).toLowerCase()]));
}

/** @param {any} raw a number in protobuf, a word in JSON @param {Map<number, string>} words */
function word(raw, words) {
  return typeof raw === "number" ? (words.get(raw) ?? "unspecified") : text(raw);
}

/**
 * Decodes one message of the stream, in protobuf or in JSON.
 * @param {unknown} data
 * @returns {Message | null} null for a message that cannot be read
 */
export function decodeMessage(data) {
  try {
    if (data instanceof ArrayBuffer) {
      const message = StreamMessage.decode(new Uint8Array(data));
      return readMessage({ ...message, cameras: message.cameras?.cameras });
    }
    return typeof data === "string" ? readMessage(JSON.parse(data)) : null;
  } catch {
    return null;
  }
}

/** @param {any} raw @returns {Message} */
function readMessage(raw) {
  if (raw?.snapshot) return { snapshot: readSnapshot(raw.snapshot) };
  if (Array.isArray(raw?.cameras)) return { cameras: readCameras(raw.cameras) };
  return raw?.event ? { event: readEvent(raw.event) } : {};
}

/**
 * @param {any} raw
 * @returns {Snapshot}
 */
export function readSnapshot(raw) {
  const captureMs = milliseconds(raw?.capture_time_ns);
  const sentMs = milliseconds(raw?.sent_time_ns);
  return {
    sequence: count(raw?.sequence),
    sourceId: text(raw?.source_id),
    poseTimeMs: milliseconds(raw?.pose_time_ns) ?? 0,
    // Both times are by the server's clock. 0 means that there was no capture yet.
    latencyMs: captureMs && sentMs ? sentMs - captureMs : null,
    objects: list(raw?.objects).map(readObject),
    missed: count(raw?.missed),
  };
}

/**
 * @param {any} raw
 * @returns {ObjectState}
 */
function readObject(raw) {
  return new ObjectState({
    id: count(raw?.object_id),
    name: text(raw?.name),
    stage: readStage(raw?.stage),
    positionM: vector(raw?.position),
    orientation: quaternion(raw?.orientation),
    yawObserved: raw?.yaw_observed === true,
    isHeadingAmbiguous: raw?.yaw_symmetry === 2,
    velocityMS: vector(raw?.velocity),
    covariance: () => numbers(raw?.covariance, 21),
    cameras: list(raw?.cameras).map(text),
    ageMs: milliseconds(raw?.observation_age_ns),
    residual: number(raw?.residual),
    roundel: text(raw?.roundel),
    code: readCode(raw?.code),
    isUntrusted: raw?.untrusted === true,
  });
}

/** @param {any} raw @returns {import("../state/object-state.js").Stage} */
function readStage(raw) {
  if (typeof raw === "number") return STAGES[raw] ?? "unspecified";
  return STAGES.includes(raw) ? raw : "unspecified";
}

/** @param {any} raw */
function readCode(raw) {
  const bits = number(raw?.bits);
  const code = number(raw?.number);
  return bits && code !== null ? { bits, number: code } : null;
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
    status: readStatus(raw?.status),
    error: text(raw?.error),
    width: count(raw?.width),
    height: count(raw?.height),
    pose: readPose(raw?.pose),
    poseStatus: word(raw?.pose_status, WORDS.pose),
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
    budgetUsed: count(raw?.budget_used),
    deferred: count(raw?.deferred),
    latencyMs: count(raw?.latency_ms),
    clock: readClock(raw?.clock),
    // 0: not fitted.
    blurPx: number(raw?.blur_px) || null,
    // 0: no other camera to compare with.
    reprojectionPx: number(raw?.reprojection_px) || null,
    promisedRateHz: count(raw?.promised_rate_hz),
    agreement: readAgreement(raw?.agreement),
  };
}

/** @param {any} raw @returns {CameraStatus} */
function readStatus(raw) {
  const status = word(raw, WORDS.camera);
  return STATUSES.has(status) ? /** @type {CameraStatus} */ (status) : "unspecified";
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
    state: word(raw.state, WORDS.agreement),
    positionErrorM: count(raw.position_error_m),
    positionDeviationM: count(raw.position_deviation_m),
    rotationErrorRad: count(raw.rotation_error_rad),
    seenErrorM: count(raw.seen_error_m),
  };
}

/** @param {any} raw @returns {CaptureClock | null} */
function readCaptureClock(raw) {
  const base = word(raw?.base, WORDS.timeBase);
  return base ? { base, deviationMs: count(raw?.deviation_ms) } : null;
}

/** @param {any} raw @returns {Pose | null} */
function readPose(raw) {
  const position = vector(raw?.position);
  const orientation = quaternion(raw?.orientation);
  return position && orientation && { position, orientation };
}

/**
 * Returns null for exact time stamps, whose deviation is 0.
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
  return {
    sequence: count(raw?.sequence),
    timeMs: milliseconds(raw?.time_ns) ?? 0,
    kind: word(raw?.kind, WORDS.event),
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
  return {
    version: text(raw?.version),
    sourceId: text(raw?.source_id),
    name: text(raw?.name),
    startedTimeMs: milliseconds(raw?.started_time_ns) || null,
    snapshotRateHz: count(raw?.snapshot_rate_hz),
    records: raw?.records === true,
    replays: raw?.replays === true,
    keepsHistory: raw?.keeps_history === true,
    allowsSetup: raw?.allows_setup === true,
  };
}
