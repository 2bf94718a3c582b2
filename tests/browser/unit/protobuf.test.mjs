/** The page's protobuf decoder, compared with the .proto files, the golden messages and the JSON form. */

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { test } from "node:test";
import { fileURLToPath } from "node:url";

import protobuf from "protobufjs";

import { decodeMessage, readCameras, readEvent, readSnapshot } from "../../../client/dashboard/js/wire/messages.js";
import { roundel } from "../../../client/dashboard/vendor/protobuf.js";
import { loadUsedMessages } from "../protobuf-module.mjs";
import { encode } from "../encode.mjs";
import { World } from "../world.mjs";

const PROTO = new URL("../../../proto/", import.meta.url);

/** A message with every field set to a different value. */
function filled(type) {
  const value = (field) => {
    if (field.resolvedType instanceof protobuf.Enum) return Object.values(field.resolvedType.values).at(-1);
    if (field.resolvedType) return filled(field.resolvedType);
    if (field.type === "string") return `${field.name} ä`;
    return field.type === "bool" ? true : field.type === "double" ? field.id + 0.5 : 1000 * field.id;
  };
  return Object.fromEntries(type.fieldsArray.map((field) => [field.name, field.repeated ? [value(field), value(field)] : value(field)]));
}

/** Removes prototypes. */
const plain = (value) => JSON.parse(JSON.stringify(value));
/** Evaluates the values that an ObjectState computes on demand. */
const withCovariances = (snapshot) => ({
  ...snapshot,
  objects: snapshot.objects.map((state) => ({ ...state, covarianceSource: null, covariance: state.covariance, ellipse: state.ellipse, sigmas: state.sigmaM })),
});
/** @param {Uint8Array} bytes */
const decode = (bytes) => decodeMessage(Uint8Array.from(bytes).buffer);

test("the decoder has every field and value of the .proto files; `npm run vendor` generates it", () => {
  const messages = loadUsedMessages(fileURLToPath(PROTO)).lookup("roundel.v1");
  for (const type of messages.nestedArray) {
    const generated = roundel.v1[type.name];
    if (type instanceof protobuf.Enum) assert.deepEqual({ ...generated }, { ...type.values }, type.name);
    else {
      // Only one field of a oneof can be set.
      const oneofs = new Set(type.oneofsArray.flatMap((oneof) => oneof.fieldsArray));
      const all = filled(type);
      for (const field of type.fieldsArray) {
        const message = oneofs.has(field) ? { [field.name]: all[field.name] } : all;
        const read = generated.decode(type.encode(type.fromObject(message)).finish());
        assert.deepEqual(plain(read[field.name]), plain(message[field.name]), `${type.name}.${field.name}`);
      }
    }
  }
});

test("the golden messages are equal in protobuf and JSON", async () => {
  const { Camera, Event, Snapshot } = roundel.v1;
  for (const [name, type, read] of [
    ["camera", Camera, (raw) => readCameras([raw])],
    ["event", Event, readEvent],
    ["snapshot", Snapshot, readSnapshot],
    ["lean_snapshot", Snapshot, readSnapshot],
  ]) {
    const [hex, json] = await Promise.all(["hex", "json"].map((kind) => readFile(new URL(`golden/${name}.${kind}`, PROTO), "utf8")));
    const decoded = type.decode(Uint8Array.from(Buffer.from(hex.replaceAll(/\s/g, ""), "hex")));
    const [fromProtobuf, fromJson] = [read(decoded), read(JSON.parse(json))];
    if (type !== Snapshot) assert.deepEqual(fromProtobuf, fromJson, name);
    else assert.deepEqual(withCovariances(fromProtobuf), withCovariances(fromJson), name);
  }
});

test("64-bit numbers are exact to a microsecond of Unix time", () => {
  const { snapshot } = decode(encode({ snapshot: { sequence: 2 ** 40 + 5, pose_time_ns: "1700000000123456789", objects: [{ object_id: 3, observation_age_ns: "-31500000" }] } }));
  assert.equal(snapshot.sequence, 2 ** 40 + 5);
  assert.ok(Math.abs(snapshot.poseTimeMs - 1700000000123.457) < 0.001, String(snapshot.poseTimeMs));
  assert.equal(snapshot.latencyMs, null, "times that were not sent");
  assert.equal(snapshot.missed, 0);
  assert.equal(snapshot.objects[0].ageMs, -31.5);
  assert.equal(snapshot.objects[0].velocityMS, null);
});

test("fields and values of a newer server are skipped", () => {
  const { event } = decode(encode({ event: { sequence: 9, message: "well", kind: "camera_failed" } }));
  assert.deepEqual([event.sequence, event.message, event.kind], [9, "well", "camera_failed"]);
  const newer = Uint8Array.from([0x08, 9, 0x18, 99, 0x7a, 2, 1, 2, 0x79, 0, 0, 0, 0, 0, 0, 0, 0, 0x7d, 0, 0, 0, 0]);
  const read = decode(Uint8Array.from([0x1a, newer.length, ...newer])).event;
  assert.deepEqual([read.sequence, read.kind], [9, "unspecified"]);
  assert.deepEqual(decode(Uint8Array.from([0x7a, 2, 1, 2])), {}, "a message of another kind");
});

test("truncated and invalid messages are rejected", () => {
  const whole = encode({ snapshot: new World({ robots: 2 }).snapshot() });
  assert.ok(decode(whole)?.snapshot);
  for (let length = 1; length < whole.length; length += 1) assert.equal(decode(whole.subarray(0, length)), null, `${length} bytes`);
  for (const bytes of [[0x1a, 12, 0x08, ...Array(10).fill(255), 1], [0x1a, 1, 0x7f]]) assert.equal(decode(Uint8Array.from(bytes)), null, String(bytes));
});

test("a snapshot is equal in protobuf and JSON, also with invalid values", () => {
  const raw = new World({ robots: 8 }).snapshot();
  Object.assign(raw.objects[1], { position: null, orientation: null, covariance: [], code: { bits: 8, number: 77 }, yaw_symmetry: 2 });
  Object.assign(raw.objects[2], { covariance: Array(21).fill(NaN), velocity: null, cameras: [], residual: NaN, name: "Gerät" });
  Object.assign(raw.objects[3], { position: { x: Infinity, y: 0, z: 0 }, orientation: { x: 0, y: 0, z: 0, w: 0 }, observation_age_ns: "-5000000" });
  // Multiples of 1024 ns and of 1 µs: exact in both forms.
  for (const name of ["pose_time_ns", "capture_time_ns", "sent_time_ns"]) raw[name] = String((BigInt(raw[name]) / 1_024_000n) * 1_024_000n);
  const { snapshot } = decode(encode({ snapshot: raw }));
  assert.equal(snapshot.objects.length, 8);
  assert.deepEqual(withCovariances(snapshot), withCovariances(readSnapshot(raw)));
});
