/** Writes the protobuf that the page reads, by the page's own tables, for mock.mjs. A unit test holds those tables to the .proto files. */

import { ENUMERATIONS, TABLES } from "../../client/dashboard/js/wire/schema.js";

const [VARINT, FIXED64, LENGTH] = [0, 1, 2];

/** Grows as it is written. */
class Writer {
  constructor() {
    this.bytes = Buffer.alloc(1 << 16);
    this.at = 0;
  }

  room(bytes) {
    if (this.at + bytes <= this.bytes.length) return;
    this.bytes = Buffer.concat([this.bytes, Buffer.alloc(this.bytes.length + bytes)]);
  }

  varint(value) {
    this.room(10);
    if (typeof value === "bigint") {
      let rest = BigInt.asUintN(64, value);
      for (; rest > 127n; rest >>= 7n) this.bytes[this.at++] = Number(rest & 127n) | 128;
      this.bytes[this.at++] = Number(rest);
      return;
    }
    let rest = value;
    for (; rest > 127; rest = Math.floor(rest / 128)) this.bytes[this.at++] = (rest % 128) | 128;
    this.bytes[this.at++] = rest;
  }

  double(value) {
    this.room(8);
    this.at = this.bytes.writeDoubleLE(value, this.at);
  }

  /** What `write` writes, with its length before it, in the five bytes that are always enough. */
  measured(write) {
    this.room(5);
    const start = this.at;
    this.at += 5;
    write();
    let length = this.at - start - 5;
    for (let i = 0; i < 5; i += 1, length >>>= 7) this.bytes[start + i] = (length & 127) | (i < 4 ? 128 : 0);
  }

  message(name, value) {
    for (const [number, words] of Object.entries(TABLES[name])) {
      const [field, ...type] = words.split(" ");
      const isList = type[0] === "repeated";
      const kind = type[isList ? 1 : 0];
      const held = value[field];
      if (held === undefined || held === null) continue;
      const key = (wire) => this.varint(Number(number) * 8 + wire);
      if (isList && kind === "double") {
        key(LENGTH);
        this.measured(() => held.forEach((one) => this.double(one)));
      } else for (const one of isList ? held : [held]) this.field(kind, one, key, isList);
    }
  }

  field(kind, value, key, isListed) {
    if (TABLES[kind]) {
      key(LENGTH);
      this.measured(() => this.message(kind, value));
    } else if (kind === "string") {
      if (value === "" && !isListed) return;
      key(LENGTH);
      this.measured(() => {
        this.room(4 * value.length);
        this.at += this.bytes.write(value, this.at);
      });
    } else if (kind === "double") {
      if (value === 0) return;
      key(FIXED64);
      this.double(value);
    } else {
      const number = ENUMERATIONS[kind] ? Math.max(0, ENUMERATIONS[kind].indexOf(value)) : kind === "int64" ? BigInt(value) : Number(value);
      if (!number) return;
      key(VARINT);
      this.varint(number);
    }
  }
}

/** A StreamMessage: {snapshot}, {cameras: […]}, {event} or {error}. */
export function encode(message) {
  const writer = new Writer();
  writer.message("StreamMessage", Array.isArray(message.cameras) ? { cameras: { cameras: message.cameras } } : message);
  return writer.bytes.subarray(0, writer.at);
}
