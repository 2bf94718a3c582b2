/**
 * Values of the wire, checked: what is missing or not finite becomes null, 0 or empty, as the reader says.
 */

/** @typedef {import("./geometry.js").Vector3} Vector3 */
/** @typedef {import("./geometry.js").Quaternion} Quaternion */

/** @param {any} raw @returns {number | null} */
export function number(raw) {
  return typeof raw === "number" && Number.isFinite(raw) ? raw : null;
}

/** A number that counts or measures something; 0 where it is missing. @param {any} raw */
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
  const [x, y, z] = [number(raw?.x), number(raw?.y), number(raw?.z)];
  return x === null || y === null || z === null ? null : { x, y, z };
}

/** @param {any} raw @returns {Quaternion | null} */
export function quaternion(raw) {
  const v = vector(raw);
  const w = number(raw?.w);
  if (!v || w === null) return null;
  const norm = Math.hypot(v.x, v.y, v.z, w);
  return norm > 0 ? { x: v.x / norm, y: v.y / norm, z: v.z / norm, w: w / norm } : null;
}

/** Exact: Unix time in nanoseconds exceeds 2^53. @param {any} raw @returns {bigint | null} */
export function nanoseconds(raw) {
  if (typeof raw === "bigint") return raw;
  return typeof raw === "string" && /^-?\d+$/.test(raw) ? BigInt(raw) : null;
}

/** @param {bigint} ns */
export function milliseconds(ns) {
  return Number(ns / 1000n) / 1000;
}
