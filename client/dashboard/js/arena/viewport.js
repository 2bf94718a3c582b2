/**
 * Mapping between world metres and CSS pixels in the view from above.
 * World x points right and y up on the screen.
 */

/** Smallest and largest scale, pixels per metre. */
const MIN_SCALE = 1;
const MAX_SCALE = 4000;

/** @typedef {{minX: number, minY: number, maxX: number, maxY: number}} Bounds */
/** @typedef {{left: number, right: number, top: number, bottom: number}} Insets */

export class Viewport {
  constructor() {
    /** World point at the centre of the canvas, metres. */
    this.centerX = 0;
    this.centerY = 0;
    /** Pixels per metre. */
    this.scale = 60;
    /** Size of the canvas, CSS pixels. */
    this.width = 1;
    this.height = 1;
    /** Device pixels per CSS pixel. */
    this.ratio = 1;
  }

  /** @param {number} x metres */
  screenX(x) {
    return this.width / 2 + (x - this.centerX) * this.scale;
  }

  /** @param {number} y metres */
  screenY(y) {
    return this.height / 2 - (y - this.centerY) * this.scale;
  }

  /** @param {number} px */
  worldX(px) {
    return this.centerX + (px - this.width / 2) / this.scale;
  }

  /** @param {number} py */
  worldY(py) {
    return this.centerY - (py - this.height / 2) / this.scale;
  }

  /**
   * @param {number} dx pixels by which the picture moves
   * @param {number} dy
   */
  pan(dx, dy) {
    this.centerX -= dx / this.scale;
    this.centerY += dy / this.scale;
  }

  /**
   * Zooms so that the world point under (px, py) stays there.
   * @param {number} px
   * @param {number} py
   * @param {number} factor above 1: closer
   */
  zoom(px, py, factor) {
    const x = this.worldX(px);
    const y = this.worldY(py);
    this.scale = Math.min(MAX_SCALE, Math.max(MIN_SCALE, this.scale * factor));
    this.centerX = x - (px - this.width / 2) / this.scale;
    this.centerY = y + (py - this.height / 2) / this.scale;
  }

  /**
   * @param {Bounds} bounds metres
   * @param {Insets} insets pixels kept free at the edges
   */
  fit(bounds, insets) {
    const width = Math.max(1, this.width - insets.left - insets.right);
    const height = Math.max(1, this.height - insets.top - insets.bottom);
    const spanX = Math.max(0.5, bounds.maxX - bounds.minX);
    const spanY = Math.max(0.5, bounds.maxY - bounds.minY);
    this.scale = Math.min(MAX_SCALE, Math.max(MIN_SCALE, Math.min(width / spanX, height / spanY)));
    this.centerX = (bounds.minX + bounds.maxX) / 2 - (insets.left - insets.right) / 2 / this.scale;
    this.centerY = (bounds.minY + bounds.maxY) / 2 - (insets.bottom - insets.top) / 2 / this.scale;
  }
}

/**
 * Bounding box of all points; without points, a box of 4 m about the origin.
 * @param {Iterable<{x: number, y: number}>} points
 * @returns {Bounds}
 */
export function boundsOf(points) {
  const bounds = { minX: Infinity, minY: Infinity, maxX: -Infinity, maxY: -Infinity };
  for (const { x, y } of points) {
    bounds.minX = Math.min(bounds.minX, x);
    bounds.maxX = Math.max(bounds.maxX, x);
    bounds.minY = Math.min(bounds.minY, y);
    bounds.maxY = Math.max(bounds.maxY, y);
  }
  if (bounds.minX > bounds.maxX) return { minX: -2, minY: -2, maxX: 2, maxY: 2 };
  return bounds;
}
