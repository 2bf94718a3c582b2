/** Canvases of the arena. */

/** A canvas as sharp as the screen, with a context that counts in CSS pixels. */
export class Layer {
  /** @param {HTMLElement} canvas */
  constructor(canvas) {
    if (!(canvas instanceof HTMLCanvasElement)) throw new Error(`#${canvas.id} is no canvas`);
    const context = canvas.getContext("2d");
    if (!context) throw new Error("this browser has no 2D canvas");
    this.canvas = canvas;
    this.context = context;
  }

  /**
   * @param {number} width CSS pixels
   * @param {number} height
   */
  resize(width, height) {
    const ratio = devicePixelRatio || 1;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
  }
}
