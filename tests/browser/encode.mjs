/** Encodes messages of the mock server in protobuf, from their JSON form and the .proto files. */

import { fileURLToPath } from "node:url";

import protobuf from "protobufjs";

import { loadMessages } from "./protobuf-module.mjs";

const root = loadMessages(fileURLToPath(new URL("../../proto", import.meta.url)));
const StreamMessage = root.lookupType("roundel.v1.StreamMessage");

/** Fields that hold an enumeration at some depth, by message type. */
const withEnums = new Map();

function enumFields(type) {
  const known = withEnums.get(type);
  if (known) return known;
  const fields = type.fieldsArray.filter(({ resolvedType: of }) => of instanceof protobuf.Enum || (of && enumFields(of).length > 0));
  withEnums.set(type, fields);
  return fields;
}

/** Replaces lower-case names of enumeration values by their numbers. */
function withNumbers(type, json) {
  const fields = enumFields(type);
  if (fields.length === 0) return json;
  const made = { ...json };
  for (const { name, resolvedType, repeated } of fields) {
    const value = json[name];
    if (value === undefined || value === null) continue;
    const convert = (one) => (resolvedType instanceof protobuf.Enum ? numberOf(resolvedType, one) : withNumbers(resolvedType, one));
    made[name] = repeated ? value.map(convert) : convert(value);
  }
  return made;
}

/** Number of LIFE_STAGE_TRACKED for "tracked"; 0 for an unknown name. */
function numberOf(enumeration, word) {
  const prefix = enumeration.valuesById[0].slice(0, -"UNSPECIFIED".length);
  return enumeration.values[prefix + word.toUpperCase()] ?? 0;
}

/** A StreamMessage: {snapshot}, {cameras: […]}, {event} or {error}. @returns {Uint8Array} */
export function encode(message) {
  const json = Array.isArray(message.cameras) ? { cameras: { cameras: message.cameras } } : message;
  return StreamMessage.encode(withNumbers(StreamMessage, json)).finish();
}
