/**
 * Form rows for the roundels of an object that carries several.
 *
 * A row has the print's orientation as roll, pitch and yaw: R = Rz(yaw) Ry(pitch) Rx(roll) from the print's axes (right,
 * top, out of its face) to the object's. With all 0 the print lies flat, face up, with its right along the object's x
 * axis. The server receives the yaw of a flat print, and the directions of right and top of any other.
 */

import { element, find, setText } from "../../base/dom.js";

/** @typedef {{x: number, y: number, z: number}} Vector */
/** @typedef {{kind: string, code: number | null, position_m: Vector | null, yaw_deg: number | null, right: Vector | null, top: Vector | null}} Mount */
/** @typedef {{rollDeg: number, pitchDeg: number, yawDeg: number}} Turn */

/** Numeric fields in the order of the row. */
const NUMBERS = /** @type {const} */ (["x", "y", "z", "roll", "pitch", "yaw"]);
const AXES = /** @type {const} */ (["x", "y", "z"]);
const TURNS = /** @type {const} */ (["roll", "pitch", "yaw"]);
/** Length below which the horizontal part of a unit vector counts as 0. */
const SAME = 1e-9;
const DEGREE = Math.PI / 180;

/** The directions of a print's right and top. @param {Turn} turn @returns {{right: Vector, top: Vector}} */
export function directions({ rollDeg, pitchDeg, yawDeg }) {
  const [sr, cr] = [Math.sin(rollDeg * DEGREE), Math.cos(rollDeg * DEGREE)];
  const [sp, cp] = [Math.sin(pitchDeg * DEGREE), Math.cos(pitchDeg * DEGREE)];
  const [sy, cy] = [Math.sin(yawDeg * DEGREE), Math.cos(yawDeg * DEGREE)];
  const clean = (/** @type {number} */ value) => Math.round(value * 1e12) / 1e12 + 0;
  return {
    right: { x: clean(cy * cp), y: clean(sy * cp), z: clean(-sp) },
    top: { x: clean(cy * sp * sr - sy * cr), y: clean(sy * sp * sr + cy * cr), z: clean(cp * sr) },
  };
}

/** Inverse of `directions`. The vectors need not be of length 1 or exactly perpendicular. @param {Vector} right @param {Vector} top @returns {Turn} */
export function turnOf(right, top) {
  const length = Math.hypot(right.x, right.y, right.z);
  const a = { x: right.x / length, y: right.y / length, z: right.z / length };
  const along = a.x * top.x + a.y * top.y + a.z * top.z;
  const b = { x: top.x - along * a.x, y: top.y - along * a.y, z: top.z - along * a.z };
  // Straight up or down, yaw and roll are about the same axis: only roll is set.
  const isUpright = Math.hypot(a.x, a.y) < SAME;
  const pitch = Math.atan2(-a.z, Math.hypot(a.x, a.y));
  const yaw = isUpright ? 0 : Math.atan2(a.y, a.x);
  const roll = isUpright ? Math.atan2(b.x * Math.sign(-a.z), b.y) : Math.atan2(b.z, a.x * b.y - a.y * b.x);
  const degrees = (/** @type {number} */ rad) => Math.round((rad / DEGREE) * 1e6) / 1e6 + 0;
  return { rollDeg: degrees(roll), pitchDeg: degrees(pitch), yawDeg: degrees(yaw) };
}

export class Mounts {
  constructor() {
    this.list = find("#object-mounts");
    /** @type {string[]} */
    this.kinds = [];
    /** @type {Row[]} */
    this.rows = [];
    find("#object-mount-add").addEventListener("click", () => this.add(null).focus());
  }

  /** @param {Mount[]} mounts */
  fill(mounts) {
    this.rows = [];
    this.list.replaceChildren();
    for (const mount of mounts) this.add(mount);
  }

  /** @param {Mount | null} mount null for a new row */
  add(mount) {
    const row = new Row(this.kinds, mount, () => this.remove(row));
    this.rows.push(row);
    this.list.append(row.root);
    this.number();
    return row;
  }

  /** @param {Row} row */
  remove(row) {
    const at = this.rows.indexOf(row);
    this.rows.splice(at, 1);
    row.root.remove();
    this.number();
    // Keeps the keyboard focus in the form.
    (this.rows[at] ?? this.rows[at - 1])?.focus();
    if (this.rows.length === 0) find("#object-mount-add").focus();
  }

  number() {
    for (const [i, row] of this.rows.entries()) row.call(`Roundel ${i + 1}`);
  }

  /** Reads all rows; null after showing an error at its field. @returns {Mount[] | null} */
  read() {
    const mounts = this.rows.map((row) => row.read());
    const first = mounts.indexOf(null);
    if (first >= 0) this.rows[first].focusTrouble();
    return first >= 0 ? null : /** @type {Mount[]} */ (mounts);
  }
}

class Row {
  /**
   * @param {string[]} kinds
   * @param {Mount | null} mount
   * @param {() => void} onRemove
   */
  constructor(kinds, mount, onRemove) {
    this.kind = /** @type {HTMLSelectElement} */ (element("select", {}, kinds.map((kind) => element("option", { value: kind }, [kind]))));
    this.code = input({ min: "1", step: "1", placeholder: "none" });
    this.numbers = Object.fromEntries(NUMBERS.map((name) => [name, input({ step: "any", placeholder: "0" })]));
    this.trouble = element("p", { class: "trouble", role: "alert", hidden: "" });
    this.button = element("button", { type: "button" }, ["Remove"]);
    this.button.addEventListener("click", onRemove);
    const labelled = (/** @type {string} */ words, /** @type {HTMLElement} */ field) => element("label", {}, [words, " ", field]);
    const fields = (/** @type {readonly string[]} */ names, /** @type {string} */ unit) =>
      element("p", {}, [...names.flatMap((name) => [labelled(name, this.numbers[name]), " "]), unit]);
    this.root = element("li", { role: "group" }, [
      element("p", {}, [labelled("kind", this.kind), " ", labelled("code", this.code), " ", this.button]),
      fields(AXES, "m"),
      fields(TURNS, "°"),
      this.trouble,
    ]);
    this.mount = mount;
    if (mount) this.fill(mount);
    /** Values of the fields before any change. */
    this.filled = this.values();
  }

  /** @param {Mount} mount */
  fill({ kind, code, position_m, yaw_deg, right, top }) {
    this.kind.value = kind;
    this.code.value = code === null ? "" : String(code);
    const turn = right && top ? turnOf(right, top) : { rollDeg: 0, pitchDeg: 0, yawDeg: yaw_deg ?? 0 };
    for (const axis of AXES) this.numbers[axis].value = position_m ? String(position_m[axis]) : "";
    const shown = { roll: turn.rollDeg, pitch: turn.pitchDeg, yaw: turn.yawDeg };
    for (const name of TURNS) this.numbers[name].value = String(shown[name]);
  }

  values() {
    return [this.kind, this.code, ...Object.values(this.numbers)].map(({ value }) => value).join("\n");
  }

  /** @param {string} name accessible name of the row */
  call(name) {
    this.root.setAttribute("aria-label", name);
    this.button.setAttribute("aria-label", `Remove ${name.toLowerCase()}`);
  }

  focus() {
    this.kind.focus();
  }

  focusTrouble() {
    /** @type {HTMLElement | null} */ (this.root.querySelector('[aria-invalid="true"]'))?.focus();
  }

  /** @returns {Mount | null} */
  read() {
    this.clear();
    if (this.code.validity.badInput) return this.showError([this.code], "Enter a code number from 1, or leave it empty for a kind without codes.");
    const bad = Object.values(this.numbers).filter((field) => field.validity.badInput);
    if (bad.length > 0) return this.showError(bad, "Enter numbers: metres from the object's origin, and degrees.");
    const empty = AXES.map((axis) => this.numbers[axis]).filter((field) => field.value === "");
    if (empty.length > 0) return this.showError(empty, "Enter the print's centre: x, y and z from the object's origin, in metres.");
    // An unchanged row is returned as received, since the conversion of angles and back is not exact.
    if (this.mount && this.values() === this.filled) return this.mount;
    const [x, y, z, rollDeg, pitchDeg, yawDeg] = NUMBERS.map((name) => Number(this.numbers[name].value));
    const isFlat = rollDeg === 0 && pitchDeg === 0;
    const { right, top } = isFlat ? { right: null, top: null } : directions({ rollDeg, pitchDeg, yawDeg });
    const yaw_deg = isFlat && yawDeg !== 0 ? yawDeg : null;
    const code = this.code.value === "" ? null : Number(this.code.value);
    return { kind: this.kind.value, code, position_m: { x, y, z }, yaw_deg, right, top };
  }

  /** @param {HTMLElement[]} fields @param {string} words @returns {null} */
  showError(fields, words) {
    for (const field of fields) field.setAttribute("aria-invalid", "true");
    setText(this.trouble, words);
    this.trouble.hidden = false;
    return null;
  }

  clear() {
    this.trouble.hidden = true;
    for (const field of [this.code, ...Object.values(this.numbers)]) field.removeAttribute("aria-invalid");
  }
}

/** @param {Record<string, string>} attributes */
function input(attributes) {
  return /** @type {HTMLInputElement} */ (element("input", { type: "number", ...attributes }));
}
