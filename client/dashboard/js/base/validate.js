/**
 * Validates values received from the server. Missing and non-finite values become null, 0 or empty.
 */

/** @typedef {import("./geometry.js").Vector3} Vector3 */
/** @typedef {import("./geometry.js").Quaternion} Quaternion */

/** @param {any} raw @returns {number | null} */
export function number(raw) {
  return Number.isFinite(raw) ? raw : null;
}

/** A number; 0 if it is missing. @param {any} raw */
export function count(raw) {
  return number(raw) ?? 0;
}

/** @param {any} raw */
export function text(raw) {
  return typeof raw === "string" ? raw : "";
}

/** @param {any} raw @returns {any[]} */
export function list(raw) {
  return Array.isArray(raw) ? raw : [];
}

/** @param {any} raw @param {number} length @returns {number[] | null} */
export function numbers(raw, length) {
  return Array.isArray(raw) && raw.length === length && raw.every(Number.isFinite) ? raw : null;
}

/** @param {any} raw @returns {Vector3 | null} */
export function vector(raw) {
  if (!raw) return null;
  const { x, y, z } = raw;
  return Number.isFinite(x) && Number.isFinite(y) && Number.isFinite(z) ? { x, y, z } : null;
}

/** @param {any} raw @returns {Quaternion | null} */
export function quaternion(raw) {
  if (!raw) return null;
  const { x, y, z, w } = raw;
  const norm = Math.sqrt(x * x + y * y + z * z + w * w);
  return norm > 0 && Number.isFinite(norm) ? { x: x / norm, y: y / norm, z: z / norm, w: w / norm } : null;
}

/**
 * Converts nanoseconds to milliseconds. JSON has decimal strings, since Unix time in nanoseconds exceeds 2^53; the
 * protobuf decoder returns numbers, exact to 256 ns.
 * @param {any} raw
 * @returns {number | null}
 */
export function milliseconds(raw) {
  if (typeof raw === "number") return Number.isFinite(raw) ? raw / 1e6 : null;
  return typeof raw === "string" && /^-?\d+$/.test(raw) ? Number(BigInt(raw) / 1000n) / 1000 : null;
}
