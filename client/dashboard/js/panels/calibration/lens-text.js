/** Texts about a lens calibration. */

import { fixed } from "../../base/format.js";

/** @typedef {{columns: number, rows: number, zones: number[], visited_from: number, share: number}} Coverage */
/** @typedef {{name: string, value: number, deviation: number, unit: string}} Parameter */
/** @typedef {{distortion_model: string, parameters: Parameter[], rms_px: number, views: number, views_left_out: number, outliers: number, width_warning: string}} Report */
/**
 * @typedef {object} Lens
 * @property {"idle" | "gathering" | "solving" | "done" | "failed"} stage
 * @property {string} camera
 * @property {string} source
 * @property {string} board
 * @property {number} width
 * @property {number} height
 * @property {number} frames
 * @property {number} taken
 * @property {number} enough
 * @property {number} least
 * @property {number} most
 * @property {string} newest
 * @property {boolean} newest_taken
 * @property {Coverage} coverage
 * @property {[number, number][][]} outlines
 * @property {[number, number][]} outline
 * @property {string[]} missing
 * @property {string} left_out
 * @property {string} error
 * @property {Report | null} report
 * @property {boolean} can_apply
 * @property {string} applied
 */

/** @param {Lens} it */
export function isRunning(it) {
  return it.stage === "gathering" || it.stage === "solving";
}

/** Camera or source that is calibrated. @param {Lens} it */
export function subjectOf(it) {
  return it.camera || it.source;
}

/** State, and what to do. @param {Lens} it */
export function stageText(it) {
  switch (it.stage) {
    case "gathering":
      return it.frames === 0 ? "Waiting for the first picture." : `${viewsText(it.taken)} of ${it.enough}, ${percent(it.coverage.share)} of the picture covered. ${sentence(it.newest)}`;
    case "solving":
      return "Calculating. You can put the board down.";
    case "done":
      return it.applied ? `Finished. Saved as ${it.applied}${it.camera ? ` and used by camera ${it.camera}` : ""}.` : "Finished. Not assigned to a camera yet.";
    case "failed":
      return "Lens calibration failed.";
    default:
      return "Print the board (Print…, Calibration board) and fix it to something flat. Start, then move it in front of the camera and hold it still at each position.";
  }
}

/** Missing views, as list items. @param {Lens} it @returns {string[]} */
export function missingText(it) {
  if (it.stage !== "gathering" || it.frames === 0) return [];
  if (it.missing.length > 0) return it.missing.map(sentence);
  return it.taken < it.enough ? ["Good coverage; add a few more views."] : [];
}

/** Progress by number of views, 0 to 1; below 1 while views are missing. @param {Lens} it */
export function progressOf(it) {
  if (it.stage !== "gathering") return it.stage === "idle" ? 0 : 1;
  const share = Math.min(1, it.taken / Math.max(1, it.enough));
  return it.missing.length > 0 ? Math.min(share, 0.95) : share;
}

/** Whether there are enough views to estimate a lens. @param {Lens} it */
export function canFinish(it) {
  return it.stage === "gathering" && it.taken >= it.least;
}

/** Value and deviation, rounded to two significant digits of the deviation. @param {Parameter} it */
export function parameterCells(it) {
  const decimals = it.deviation > 0 ? Math.min(8, Math.max(0, 1 - Math.floor(Math.log10(it.deviation)))) : 6;
  const unit = it.unit ? ` ${it.unit}` : "";
  return [`${fixed(it.value, decimals)}${unit}`, `± ${fixed(it.deviation, decimals)}${unit}`];
}

/** Summary of the result. @param {Report} it */
export function reportText(it) {
  const left = it.views_left_out > 0 ? `, ${it.views_left_out} excluded as inconsistent` : "";
  return `${it.distortion_model}, from ${viewsText(it.views)}${left}; rms reprojection error ${fixed(it.rms_px, 3)} px.${it.width_warning ? ` ${sentence(it.width_warning)}` : ""}`;
}

/** Parses "1920x1080". @param {string} text @returns {{width: number, height: number} | null} */
export function sizeOf(text) {
  const [, width, height] = /^(\d+)\s*[x×]\s*(\d+)$/iu.exec(text.trim()) ?? [];
  return height === undefined ? null : { width: Number(width), height: Number(height) };
}

/** @param {string} text */
export function sentence(text) {
  return `${text.charAt(0).toUpperCase()}${text.slice(1)}`.replace(/([^.!?])$/, "$1.");
}

/** @param {number} count */
function viewsText(count) {
  return count === 1 ? "1 view" : `${count} views`;
}

/** @param {number} share */
function percent(share) {
  return `${fixed(share * 100, 0)} %`;
}
