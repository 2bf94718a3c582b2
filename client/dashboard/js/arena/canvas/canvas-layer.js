/** Canvases of the arena. */

/** @typedef {OffscreenCanvasRenderingContext2D | CanvasRenderingContext2D} Context2D */

/** A canvas with the screen's resolution, drawn in CSS pixels. */
export class CanvasLayer {
  /** @param {OffscreenCanvas | HTMLCanvasElement} canvas */
  constructor(canvas) {
    const context = /** @type {Context2D | null} */ (canvas.getContext("2d"));
    if (!context) throw new Error("this browser does not support 2D canvases");
    this.canvas = canvas;
    this.context = context;
  }

  /**
   * @param {number} width CSS pixels
   * @param {number} height
   * @param {number} ratio the screen's pixels in one
   */
  resize(width, height, ratio) {
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
  }
}

/**
 * An offscreen canvas for content that is copied often.
 * @param {number} width pixels
 * @param {number} height
 * @returns {{canvas: OffscreenCanvas | HTMLCanvasElement, context: Context2D}}
 */
export function makeCanvas(width, height) {
  // Browsers without OffscreenCanvas run this code in the page.
  const canvas = typeof OffscreenCanvas === "undefined" ? document.createElement("canvas") : new OffscreenCanvas(width, height);
  canvas.width = width;
  canvas.height = height;
  return { canvas, context: /** @type {Context2D} */ (canvas.getContext("2d")) };
}
