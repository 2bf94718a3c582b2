/** The page's reader of protobuf, and its tables against the .proto files. */

import assert from "node:assert/strict";
import { readFile, readdir } from "node:fs/promises";
import { test } from "node:test";

import { readSnapshot } from "../../../client/dashboard/js/wire/message.js";
import { decode, shapes } from "../../../client/dashboard/js/wire/protobuf.js";
import { ENUMERATIONS, SHAPES, TABLES } from "../../../client/dashboard/js/wire/schema.js";
import { decodeSnapshot } from "../../../client/dashboard/js/wire/snapshot.js";
import { encode } from "../wire.mjs";
import { World } from "../world.mjs";

const FOLDER = new URL("../../../proto/roundel/v1/", import.meta.url);
const files = (await readdir(FOLDER)).filter((name) => name.endsWith(".proto"));
const proto = (await Promise.all(files.map((name) => readFile(new URL(name, FOLDER), "utf8"))))
  .join("\n")
  .replaceAll(/\/\/.*$/gm, "");

/** The body of a message or an enumeration. */
function block(keyword, name) {
  const start = proto.indexOf(`${keyword} ${name} {`);
  assert.ok(start >= 0, `the .proto files have no ${keyword} ${name}`);
  let depth = 0;
  for (let at = start; ; at += 1) {
    if (proto[at] === "{") depth += 1;
    if (proto[at] === "}" && (depth -= 1) === 0) return proto.slice(start, at);
  }
}

test("every field of the tables is one of the .proto files, with its number and type", () => {
  for (const [name, table] of Object.entries(TABLES)) {
    const body = block("message", name);
    for (const [number, words] of Object.entries(table)) {
      const [field, ...type] = words.split(" ");
      assert.match(body, new RegExp(`(^|[\\n {])${type.join(" ")} ${field} = ${number};`), `${name}.${field}`);
    }
  }
});

test("every word of the tables is one of the .proto files, with its number", () => {
  for (const [name, words] of Object.entries(ENUMERATIONS)) {
    const body = block("enum", name);
    const prefix = name.replaceAll(/(?<=[a-z])([A-Z])/g, "_$1").toUpperCase();
    for (const [number, word] of words.entries()) {
      if (word === undefined) continue;
      assert.match(body, new RegExp(`${prefix}_${word.toUpperCase()} = ${number};`), `${name} ${word}`);
    }
  }
});

const SNAPSHOT = {
  sequence: 2 ** 40 + 5,
  source_id: "a source whose name is longer than what is read letter by letter: Prüfstand",
  pose_time_ns: "1700000000123456789",
  objects: [
    {
      object_id: 3,
      name: "Gerät 7",
      stage: "predicted",
      position: { x: -1.5, y: 0, z: 0.3 },
      orientation: { x: 0, y: 0, z: 0, w: 1 },
      yaw_observed: true,
      covariance: Array.from({ length: 21 }, (_, i) => i / 7),
      cameras: ["north", ""],
      observation_age_ns: "-31500000",
      code: { bits: 8, number: 200 },
    },
  ],
};

test("what was written is read again, and what was not sent is its default", () => {
  const { snapshot, event } = decode(SHAPES.StreamMessage, encode({ snapshot: SNAPSHOT }));
  assert.equal(event, null);
  assert.equal(snapshot.sequence, 2 ** 40 + 5);
  assert.equal(snapshot.source_id, SNAPSHOT.source_id);
  assert.equal(snapshot.pose_time_ns, 1700000000123456789n);
  assert.equal(snapshot.capture_time_ns, 0n);
  assert.equal(snapshot.missed, 0);
  const [object] = snapshot.objects;
  assert.deepEqual(object.position, { x: -1.5, y: 0, z: 0.3 });
  assert.deepEqual(object.covariance, SNAPSHOT.objects[0].covariance);
  assert.deepEqual(object.cameras, ["north", ""]);
  assert.equal(object.observation_age_ns, -31500000n);
  assert.equal(object.name, "Gerät 7");
  assert.equal(object.stage, "predicted");
  assert.equal(object.velocity, null);
  assert.deepEqual(object.code, { bits: 8, number: 200 });
  // Lists are of this message alone.
  assert.notEqual(decode(SHAPES.ObjectState, new Uint8Array()).cameras, decode(SHAPES.ObjectState, new Uint8Array()).cameras);
});

test("fields and words of a newer server are passed over", () => {
  const both = shapes({ Event: { 1: "sequence uint64" } }, {});
  const { event } = decode(SHAPES.StreamMessage, encode({ event: { sequence: 9, message: "well", kind: "camera_failed" } }));
  assert.equal(event.message, "well");
  const newer = Uint8Array.from([0x08, 9, 0x18, 99, 0x7a, 2, 1, 2, 0x79, 0, 0, 0, 0, 0, 0, 0, 0, 0x7d, 0, 0, 0, 0]);
  assert.deepEqual(decode(SHAPES.Event, newer).kind, "unspecified");
  assert.deepEqual(decode(both.Event, newer), { sequence: 9 });
});

test("no part of a message reads as a message, nor does nonsense", () => {
  const whole = encode({ snapshot: SNAPSHOT });
  for (let length = 1; length < whole.length; length += 1) {
    assert.throws(() => decode(SHAPES.StreamMessage, whole.subarray(0, length)), RangeError, `${length} bytes`);
  }
  assert.throws(() => decode(SHAPES.Event, Uint8Array.from([0x0a, 1, 0])), /sequence: expected wire type 0/);
  assert.throws(() => decode(SHAPES.Event, Uint8Array.from([0x08, ...Array(10).fill(255), 1])), /longer than ten bytes/);
  assert.throws(() => decode(SHAPES.Event, Uint8Array.from([0x7f])), /no wire type 7/);
});

test("the quick reader of snapshots reads what the tables do", () => {
  const world = new World({ robots: 8 });
  const raw = world.snapshot();
  Object.assign(raw.objects[1], { position: null, orientation: null, covariance: [], code: { bits: 8, number: 77 }, yaw_symmetry: 2 });
  Object.assign(raw.objects[2], { covariance: Array(21).fill(NaN), velocity: null, cameras: [], residual: NaN, name: "Gerät" });
  Object.assign(raw.objects[3], { position: { x: Infinity, y: 0, z: 0 }, orientation: { x: 0, y: 0, z: 0, w: 0 }, observation_age_ns: "-5000000" });
  const bytes = encode({ snapshot: raw });
  const plain = (snapshot) => ({
    ...snapshot,
    objects: snapshot.objects.map((state) => ({ ...state, heldCovariance: null, covariance: state.covariance, ellipse: state.ellipse, sigmas: state.sigmaM })),
  });
  const expected = readSnapshot(decode(SHAPES.StreamMessage, bytes).snapshot);
  assert.equal(expected.objects.length, 8);
  assert.deepEqual(plain(decodeSnapshot(bytes)), plain(expected));
  assert.equal(decodeSnapshot(encode({ event: { sequence: 1 } })), null);
  for (let length = 1; length < bytes.length; length += 7) {
    assert.throws(() => decodeSnapshot(bytes.subarray(0, length)), RangeError, `${length} bytes`);
  }
});
