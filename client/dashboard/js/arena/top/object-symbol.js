/**
 * Symbol of an object from above, with velocity and heading.
 *
 * Life stages differ in shape and colour: tracked is a closed ring, predicted a broken one,
 * tentative a diamond, lost a cross.
 */

/** Time of travel that the velocity line shows, s. */
export const VELOCITY_LINE_S = 0.5;

/** @typedef {import("../viewport.js").Viewport} Viewport */
/** @typedef {import("../palette.js").Palette} Palette */
/** @typedef {import("../../state/store.js").Track} Track */

/** Radius of an object's disc, CSS pixels: about 0.3 m in diameter, limited to legible sizes. */
export function discRadius(/** @type {Viewport} */ view) {
  return Math.min(15, Math.max(6.5, 0.13 * view.scale));
}

/**
 * @param {import("../canvas/canvas-layer.js").Context2D} context
 * @param {Viewport} view
 * @param {Palette} palette
 * @param {Track} track
 * @param {{selected: number | null, hovered: number | null}} options
 */
export function drawObject(context, view, palette, { state }, options) {
  const { positionM, velocityMS } = state;
  if (!positionM) return;
  const [px, py] = [view.screenX(positionM.x), view.screenY(positionM.y)];
  const radius = discRadius(view);
  const color = palette.stage[state.stage];
  if (velocityMS && state.stage !== "lost") {
    context.beginPath();
    context.moveTo(px, py);
    context.lineTo(
      px + velocityMS.x * VELOCITY_LINE_S * view.scale,
      py - velocityMS.y * VELOCITY_LINE_S * view.scale,
    );
    context.strokeStyle = color;
    context.lineWidth = 1.25;
    context.stroke();
  }
  if (state.id === options.selected || state.id === options.hovered) {
    context.beginPath();
    context.arc(px, py, radius + 5, 0, 2 * Math.PI);
    context.strokeStyle = palette.accent;
    context.lineWidth = state.id === options.selected ? 2.5 : 1.25;
    context.stroke();
  }
  drawSymbol(context, px, py, radius, state.stage, color, palette.sheet);
  if (state.headingRad !== null && state.stage !== "lost") {
    const [hx, hy] = [Math.cos(state.headingRad), -Math.sin(state.headingRad)];
    context.beginPath();
    for (const side of state.isHeadingAmbiguous ? [1, -1] : [1]) {
      context.moveTo(px + hx * radius * 0.2 * side, py + hy * radius * 0.2 * side);
      context.lineTo(px + hx * radius * 1.5 * side, py + hy * radius * 1.5 * side);
    }
    context.strokeStyle = palette.ink;
    context.lineWidth = 2.5;
    context.stroke();
  }
}

/**
 * Draws the symbol of a life stage; index.html defines the same ones for the lists.
 * @param {import("../canvas/canvas-layer.js").Context2D} context
 * @param {number} px
 * @param {number} py
 * @param {number} radius
 * @param {import("../../state/object-state.js").Stage} stage
 * @param {string} color
 * @param {string} sheet
 */
export function drawSymbol(context, px, py, radius, stage, color, sheet) {
  const width = Math.max(2.5, radius * 0.38);
  context.beginPath();
  context.strokeStyle = color;
  context.fillStyle = sheet;
  if (stage === "lost") {
    const arm = radius * 0.7;
    context.moveTo(px - arm, py - arm);
    context.lineTo(px + arm, py + arm);
    context.moveTo(px + arm, py - arm);
    context.lineTo(px - arm, py + arm);
    context.lineWidth = 2.5;
    context.stroke();
    return;
  }
  if (stage === "tentative") {
    context.moveTo(px, py - radius);
    context.lineTo(px + radius, py);
    context.lineTo(px, py + radius);
    context.lineTo(px - radius, py);
    context.closePath();
    context.lineWidth = 2;
  } else {
    context.arc(px, py, radius - width / 2, 0, 2 * Math.PI);
    context.lineWidth = width;
  }
  context.fill();
  if (stage === "predicted") {
    const sixth = (Math.PI * (2 * radius - width)) / 12;
    context.lineCap = "butt";
    context.setLineDash([sixth * 1.25, sixth * 0.75]);
  }
  context.stroke();
  context.setLineDash([]);
  context.lineCap = "round";
}
