/** Messages of the stream, whichever way they are written. */

import { readSnapshot } from "./message.js";
import { decode } from "./protobuf.js";
import { SHAPES } from "./schema.js";
import { decodeSnapshot } from "./snapshot.js";

/**
 * A message that cannot be read is left out: the next one stands for itself.
 * @param {unknown} data
 * @returns {any} null for one that cannot be read
 */
export function parse(data) {
  try {
    if (data instanceof ArrayBuffer) {
      const bytes = new Uint8Array(data);
      const snapshot = decodeSnapshot(bytes);
      if (snapshot) return { snapshot };
      const message = decode(SHAPES.StreamMessage, bytes);
      // JSON has the list by itself.
      return { ...message, cameras: message.cameras?.cameras };
    }
    const message = typeof data === "string" ? JSON.parse(data) : null;
    return message?.snapshot ? { snapshot: readSnapshot(message.snapshot) } : message;
  } catch {
    return null;
  }
}
