/**
 * Snapshots from protobuf straight to what the page uses. They are nearly all that comes: with four hundred objects at
 * 60 Hz, even objects made only to be read once would be felt. The numbers are those of schema.js, by which a test
 * compares the two.
 */

import { FIXED64, LENGTH, Reader, VARINT } from "./protobuf.js";
import { ObjectState, STAGES } from "../state/state.js";
import { numbers } from "../base/value.js";

/** @typedef {import("../base/geometry.js").Vector3} Vector3 */
/** @typedef {import("./message.js").Snapshot} Snapshot */

/** Fields' numbers and wire types, as they stand before a field. */
const key = (/** @type {number} */ number, /** @type {number} */ wire) => number * 8 + wire;
const SNAPSHOT = {
  sequence: key(1, VARINT),
  source: key(2, LENGTH),
  pose: key(3, VARINT),
  capture: key(4, VARINT),
  sent: key(6, VARINT),
  object: key(7, LENGTH),
  missed: key(8, VARINT),
};
const STATE = {
  id: key(1, VARINT),
  name: key(2, LENGTH),
  stage: key(3, VARINT),
  position: key(4, LENGTH),
  orientation: key(5, LENGTH),
  yaw: key(6, VARINT),
  velocity: key(7, LENGTH),
  covariance: key(9, LENGTH),
  camera: key(11, LENGTH),
  age: key(12, VARINT),
  residual: key(13, FIXED64),
  roundel: key(14, LENGTH),
  code: key(15, LENGTH),
  symmetry: key(16, VARINT),
};
const COVARIANCE_BYTES = 21 * 8;
const TWO_32 = 4294967296;
/** Names that came before, by a hash of their bytes: the same few come thousands of times a second. */
const names = Array.from({ length: 256 }, () => ({ bytes: new Uint8Array(), text: "" }));

/**
 * @param {Uint8Array} bytes of a StreamMessage
 * @returns {Snapshot | null} null if it holds something else
 * @throws {RangeError} for bytes that are no such message
 */
export function decodeSnapshot(bytes) {
  if (bytes[0] !== key(1, LENGTH)) return null;
  const reader = new Reader(bytes);
  reader.at = 1;
  return snapshot(reader, reader.end());
}

/** @param {Reader} reader @param {number} end @returns {Snapshot} */
function snapshot(reader, end) {
  /** @type {Snapshot} */
  const made = { sequence: 0, sourceId: "", poseTimeMs: 0, latencyMs: null, objects: [], missed: 0 };
  let [capture, sent] = [0n, 0n];
  while (reader.at < end) {
    const field = reader.varint();
    switch (field) {
      case SNAPSHOT.sequence:
        made.sequence = reader.varint();
        break;
      case SNAPSHOT.source:
        made.sourceId = reader.string(reader.end());
        break;
      case SNAPSHOT.pose:
        made.poseTimeMs = Number(nanoseconds(reader) / 1000n) / 1000;
        break;
      case SNAPSHOT.capture:
        capture = nanoseconds(reader);
        break;
      case SNAPSHOT.sent:
        sent = nanoseconds(reader);
        break;
      case SNAPSHOT.object:
        made.objects.push(state(reader, reader.end()));
        break;
      case SNAPSHOT.missed:
        made.missed = reader.varint();
        break;
      default:
        reader.skip(field & 7);
    }
  }
  if (reader.at > end) throw new RangeError("a snapshot ends behind its end");
  // Both times are the server's, so no clock of this machine enters. 0 is "before the first".
  made.latencyMs = capture && sent ? Number(sent - capture) / 1e6 : null;
  return made;
}

/** @param {Reader} reader @param {number} end */
function state(reader, end) {
  const made = new ObjectState({
    id: 0,
    name: "",
    stage: "unspecified",
    positionM: null,
    orientation: null,
    yawObserved: false,
    eitherWay: false,
    velocityMS: null,
    covariance: null,
    cameras: [],
    ageMs: 0,
    residual: 0,
    roundel: "",
    code: null,
  });
  while (reader.at < end) {
    const field = reader.varint();
    switch (field) {
      case STATE.id:
        made.id = reader.varint();
        break;
      case STATE.name:
        made.name = name(reader);
        break;
      case STATE.stage:
        made.stage = STAGES[reader.varint()] ?? "unspecified";
        break;
      case STATE.position:
        made.positionM = vector(reader, reader.end());
        break;
      case STATE.orientation:
        made.orientation = unit(reader, reader.end());
        break;
      case STATE.yaw:
        made.yawObserved = reader.varint() !== 0;
        break;
      case STATE.velocity:
        made.velocityMS = vector(reader, reader.end());
        break;
      case STATE.covariance:
        made.heldCovariance = covariance(reader, reader.end());
        break;
      case STATE.camera:
        made.cameras.push(name(reader));
        break;
      case STATE.age:
        reader.varint();
        // Ages are some milliseconds: doubles hold them.
        made.ageMs = ((reader.high | 0) * TWO_32 + reader.low) / 1e6;
        break;
      case STATE.residual:
        made.residual = finite(reader.double());
        break;
      case STATE.roundel:
        made.roundel = name(reader);
        break;
      case STATE.code:
        made.code = code(reader, reader.end());
        break;
      case STATE.symmetry:
        made.eitherWay = reader.varint() === 2;
        break;
      default:
        reader.skip(field & 7);
    }
  }
  if (reader.at > end) throw new RangeError("an object ends behind its end");
  return made;
}

/** @param {Reader} reader */
function nanoseconds(reader) {
  reader.varint();
  return BigInt.asIntN(64, (BigInt(reader.high) << 32n) | BigInt(reader.low));
}

/** @param {number} value */
function finite(value) {
  return Number.isFinite(value) ? value : null;
}

/** @param {Reader} reader @param {number} end @returns {Vector3 | null} */
function vector(reader, end) {
  let [x, y, z] = [0, 0, 0];
  while (reader.at < end) {
    const field = reader.varint();
    if (field === key(1, FIXED64)) x = reader.double();
    else if (field === key(2, FIXED64)) y = reader.double();
    else if (field === key(3, FIXED64)) z = reader.double();
    else reader.skip(field & 7);
  }
  return Number.isFinite(x + y + z) ? { x, y, z } : null;
}

/** @param {Reader} reader @param {number} end */
function unit(reader, end) {
  let [x, y, z, w] = [0, 0, 0, 0];
  while (reader.at < end) {
    const field = reader.varint();
    if (field === key(1, FIXED64)) x = reader.double();
    else if (field === key(2, FIXED64)) y = reader.double();
    else if (field === key(3, FIXED64)) z = reader.double();
    else if (field === key(4, FIXED64)) w = reader.double();
    else reader.skip(field & 7);
  }
  const norm = Math.sqrt(x * x + y * y + z * z + w * w);
  return norm > 0 && Number.isFinite(norm) ? { x: x / norm, y: y / norm, z: z / norm, w: w / norm } : null;
}

/** Left where it is until somebody asks. @param {Reader} reader @param {number} end */
function covariance(reader, end) {
  const { view, at } = reader;
  const isWhole = end - at === COVARIANCE_BYTES;
  reader.at = end;
  if (!isWhole) return null;
  return () => numbers(Array.from({ length: 21 }, (_, i) => view.getFloat64(at + 8 * i, true)), 21);
}

/** @param {Reader} reader @param {number} end */
function code(reader, end) {
  let [bits, number] = [0, 0];
  while (reader.at < end) {
    const field = reader.varint();
    if (field === key(1, VARINT)) bits = reader.varint();
    else if (field === key(2, VARINT)) number = reader.varint();
    else reader.skip(field & 7);
  }
  return bits > 0 ? { bits, number } : null;
}

/** A text that came before costs no new one. @param {Reader} reader */
function name(reader) {
  const end = reader.end();
  const { bytes, at } = reader;
  let hash = end - at;
  for (let i = at; i < end; i += 1) hash = (hash * 31 + bytes[i]) | 0;
  const held = names[hash & 255];
  let isSame = held.bytes.length === end - at;
  for (let i = 0; isSame && i < held.bytes.length; i += 1) isSame = held.bytes[i] === bytes[at + i];
  if (isSame) {
    reader.at = end;
    return held.text;
  }
  held.bytes = bytes.slice(at, end);
  held.text = reader.string(end);
  return held.text;
}
