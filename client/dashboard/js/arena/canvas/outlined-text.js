/**
 * Draws text with an outline in the background's colour, legible over any content.
 * @param {import("./canvas-layer.js").Context2D} context with its font and alignment
 * @param {import("../palette.js").Palette} palette
 * @param {string} words
 * @param {number} px
 * @param {number} py
 * @param {string} color
 * @param {number} [widthPx] of the outline, both sides together
 */
export function drawOutlinedText(context, palette, words, px, py, color, widthPx = 3) {
  context.lineWidth = widthPx;
  context.lineJoin = "round";
  context.strokeStyle = palette.sheet;
  context.strokeText(words, px, py);
  context.fillStyle = color;
  context.fillText(words, px, py);
}
