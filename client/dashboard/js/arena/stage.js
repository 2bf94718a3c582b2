/**
 * The arena from above or in 3D, redrawn after changes and at most once per animation frame. The view from above has two
 * canvases, the static backdrop below the moving objects; the 3D view has a WebGL canvas below one with labels.
 *
 * It runs in a worker (worker-runtime.js) without access to the page, and receives the user's input from arena.js.
 */

import { cameraFootprint, drawBackdrop, gridStepM, RULER } from "./top/backdrop.js";
import { CanvasLayer } from "./canvas/canvas-layer.js";
import { discRadius } from "./top/object-symbol.js";
import { drawTracks } from "./top/tracks.js";
import { drawTape, TapeMeasure } from "./top/tape-measure.js";
import { boundsOf, Viewport } from "./viewport.js";

/** Margin around the fitted area, CSS pixels, in addition to the rulers. */
const FIT_MARGIN_PX = 26;
/** Margin around an object if there are no fixed cameras, metres. */
const OBJECT_MARGIN_M = 2;
/** Distance from the disc at which a click or a touch still selects it, CSS pixels. */
const REACH_PX = 6;
const REACH_COARSE_PX = 18;
/** Shortest interval between two reports of the visible area, ms. It changes each frame while an object is followed. */
const REPORT_MS = 100;

/** Drawing time after which drawing pauses, ms. */
const LONG_MS = 25;

/** @typedef {"top" | "space"} StageMode */
/** @typedef {{backdrop: Canvas, tracks: Canvas, space: Canvas, labels: Canvas}} Canvases */
/** @typedef {OffscreenCanvas | HTMLCanvasElement} Canvas */
/** @typedef {{centerX: number, centerY: number, scale: number, stepM: number, measured: string}} VisibleArea the viewport's centre and scale, the grid's step, and the measured distance in words */

export class Stage {
  /**
   * @param {import("../state/store.js").Store} store
   * @param {Canvases} canvases
   * @param {import("./palette.js").Palette} palette
   * @param {(sight: VisibleArea) => void} onVisibleArea receives each change of the visible area
   */
  constructor(store, canvases, palette, onVisibleArea) {
    this.store = store;
    this.onVisibleArea = onVisibleArea;
    this.view = new Viewport();
    this.canvases = canvases;
    this.layers = {
      backdrop: new CanvasLayer(canvases.backdrop),
      tracks: new CanvasLayer(canvases.tracks),
      labels: new CanvasLayer(canvases.labels),
    };
    /** @type {import("./space/space-view.js").SpaceView | null} created on demand, since three.js is half a megabyte */
    this.space = null;
    /** @type {StageMode} */
    this.mode = "top";
    this.palette = palette;
    /** Whether the arena has a size. */
    this.isShown = true;
    this.exaggeration = 10;
    this.trails = true;
    /** @type {import("../state/trajectories.js").HistoryOverlay | null} */
    this.overlay = null;
    /** @type {number | null} */
    this.hovered = null;
    /** True until the user moves the view: the view fits itself to cameras and objects. */
    this.fitsItself = true;
    /** Key of the backdrop's cameras, to detect changes. */
    this.camerasDrawn = "";
    this.boundsFitted = "";
    this.bounds = boundsOf([]);
    this.tape = new TapeMeasure();
    this.backdropStale = true;
    this.frameAsked = false;
    /** Earliest time of the next redraw, `performance.now()`. */
    this.restUntilMs = 0;
    this.reportedSight = "";
    this.sightTimer = 0;

    store.on("snapshot", () => this.onSnapshot());
    store.on("time", () => this.onSnapshot());
    store.on("cameras", () => this.onCameras());
    store.on("selection", () => this.onSelection());
  }

  /** @param {import("./palette.js").Palette} palette */
  setPalette(palette) {
    this.palette = palette;
    this.refresh();
  }

  /**
   * @param {number} dx CSS pixels by which the picture goes with the hand
   * @param {number} dy
   * @param {boolean} isSecond in 3D: moves, where it turns otherwise
   */
  drag(dx, dy, isSecond) {
    this.fitsItself = false;
    if (this.mode === "top") this.view.pan(dx, dy);
    else if (isSecond) this.space?.orbit.slide(dx, dy);
    else this.space?.orbit.turn(dx, dy);
    this.refresh();
  }

  /**
   * @param {number} px
   * @param {number} py
   * @param {number} factor
   */
  zoom(px, py, factor) {
    this.fitsItself = false;
    // While following, zooming keeps the object in place.
    if (this.mode === "space") this.space?.orbit.zoom(factor);
    else if (this.store.following) this.view.zoom(this.view.width / 2, this.view.height / 2, factor);
    else this.view.zoom(px, py, factor);
    this.refresh();
  }

  /**
   * Switches the view. Falls back from 3D to the view from above if WebGL is missing.
   * @param {StageMode} mode
   * @returns {Promise<StageMode>} the mode shown
   */
  async show(mode) {
    if (mode === "space" && !this.space) this.space = await this.makeSpace();
    this.mode = mode === "space" && this.space ? "space" : "top";
    this.boundsFitted = "";
    if (this.mode === "space") this.space?.resize(this.view.width, this.view.height, this.view.ratio);
    this.fitNow();
    this.refresh();
    return this.mode;
  }

  async makeSpace() {
    const canvas = this.canvases.space;
    // Antialiasing only with a GPU: in software it would take most of the time.
    const context = /** @type {WebGL2RenderingContext | null} */ (
      canvas.getContext("webgl2", { alpha: false, antialias: true, failIfMajorPerformanceCaveat: true }) ??
      canvas.getContext("webgl2", { alpha: false, antialias: false })
    );
    if (!context) return null;
    try {
      const { SpaceView } = await import("./space/space-view.js");
      return new SpaceView(canvas, context);
    } catch {
      // three.js could not be loaded, or the GPU failed: fall back to the view from above.
      return null;
    }
  }

  /** Fits everything into the view, until the user moves it. */
  fit() {
    this.fitsItself = true;
    this.boundsFitted = "";
    this.fitNow();
    this.refresh();
  }

  /** @param {{exaggeration: number, trails: boolean}} look exaggeration 0: no ellipses */
  setLook({ exaggeration, trails }) {
    this.exaggeration = exaggeration;
    this.trails = trails;
    this.askFrame();
  }

  /** @param {import("../state/trajectories.js").HistoryOverlay | null} overlay */
  setOverlay(overlay) {
    this.overlay = overlay;
    this.refresh();
  }

  onSnapshot() {
    if (this.fitsItself && (this.boundsFitted === "" || this.isLeft())) {
      this.fitNow();
      this.backdropStale = true;
    }
    this.centerOnFollowed();
    this.askFrame();
  }

  /** Whether an object has left the view, if no fixed camera determines the area to show. */
  isLeft() {
    if (this.standing().some((camera) => camera.pose)) return false;
    const { view } = this;
    return [...this.store.tracks.values()].some(({ state: { positionM } }) => {
      if (!positionM) return false;
      const [px, py] = [view.screenX(positionM.x), view.screenY(positionM.y)];
      return px < RULER.left || px > view.width || py < 0 || py > view.height - RULER.bottom;
    });
  }

  onCameras() {
    const look = JSON.stringify(
      this.standing().map(({ name, status, pose, intrinsics, width, height }) => [
        name, status === "failed", pose, intrinsics, width, height,
      ]),
    );
    if (look === this.camerasDrawn) return;
    this.camerasDrawn = look;
    if (this.fitsItself) this.fitNow();
    this.refresh();
  }

  /** Fixed cameras. */
  standing() {
    return this.store.cameras.filter((camera) => !camera.mount);
  }

  onSelection() {
    this.tape.reach(this.store.selected);
    this.centerOnFollowed();
    this.askFrame();
  }

  /** A size of zero hides it. @param {{width: number, height: number, ratio: number}} size CSS pixels, and the screen's pixels in one */
  resize({ width, height, ratio }) {
    this.isShown = width > 0 && height > 0;
    if (!this.isShown) return;
    Object.assign(this.view, { width, height, ratio });
    for (const layer of Object.values(this.layers)) layer.resize(width, height, ratio);
    if (this.mode === "space") this.space?.resize(width, height, ratio);
    this.boundsFitted = "";
    if (this.fitsItself) this.fitNow();
    // Redraw at once, since a resized canvas is empty and would flash.
    this.backdropStale = true;
    this.draw();
  }

  centerOnFollowed() {
    if (!this.store.following || this.store.selected === null) return;
    const position = this.store.tracks.get(this.store.selected)?.state.positionM;
    if (!position) return;
    this.fitsItself = false;
    if (this.space) this.space.orbit.target = position;
    this.view.centerX = position.x;
    this.view.centerY = position.y;
    this.backdropStale = true;
  }

  /** Fits the view to the fixed cameras and their footprints, or to the objects if no fixed camera has a pose. */
  fitNow() {
    const { tracks } = this.store;
    const places = this.standing().flatMap((camera) =>
      camera.pose ? [camera.pose.position, ...cameraFootprint(camera)] : [],
    );
    if (places.length === 0) {
      for (const { state } of tracks.values()) {
        if (!state.positionM) continue;
        const { x, y } = state.positionM;
        places.push({ x: x - OBJECT_MARGIN_M, y: y - OBJECT_MARGIN_M }, { x: x + OBJECT_MARGIN_M, y: y + OBJECT_MARGIN_M });
      }
    }
    if (places.length === 0) this.boundsFitted = "";
    const bounds = boundsOf(places);
    const wanted = places.length > 0 ? JSON.stringify(bounds) : "";
    if (wanted !== "" && wanted === this.boundsFitted) return;
    this.boundsFitted = wanted;
    this.bounds = bounds;
    if (this.space) {
      this.space.lay(this.palette, this.standing(), bounds, this.overlay);
      this.space.fit(bounds);
    }
    this.view.fit(bounds, {
      left: RULER.left + FIT_MARGIN_PX,
      right: FIT_MARGIN_PX,
      top: FIT_MARGIN_PX,
      bottom: RULER.bottom + FIT_MARGIN_PX,
    });
  }

  /** @param {[number, number] | null} at CSS pixels; null: it has left */
  point(at) {
    const hovered = at && this.objectAt(...at, false);
    this.tape.pointer = at && [this.view.worldX(at[0]), this.view.worldY(at[1])];
    if (hovered === this.hovered && !this.tape.isOut) return;
    this.hovered = hovered;
    this.askFrame();
  }

  /** @param {boolean} isOut */
  takeTape(isOut) {
    this.tape.take(isOut, this.store.selected);
    this.askFrame();
  }

  /** @param {number} px @param {number} py @param {boolean} coarse */
  measureAt(px, py, coarse) {
    const id = this.objectAt(px, py, coarse);
    this.tape.set(id === null ? { id, x: this.view.worldX(px), y: this.view.worldY(py) } : { id });
    this.askFrame();
  }

  /**
   * @param {number} px
   * @param {number} py
   * @param {boolean} coarse
   * @returns {number | null} id of the nearest object within reach
   */
  objectAt(px, py, coarse) {
    if (this.mode === "space") return this.space?.objectAt(px, py, coarse ? REACH_COARSE_PX : REACH_PX) ?? null;
    let nearest = null;
    let nearestPx = discRadius(this.view) + (coarse ? REACH_COARSE_PX : REACH_PX);
    for (const [id, { state }] of this.store.tracks) {
      if (!state.positionM) continue;
      const dx = this.view.screenX(state.positionM.x) - px;
      const dy = this.view.screenY(state.positionM.y) - py;
      const distancePx = Math.hypot(dx, dy);
      if (distancePx > nearestPx) continue;
      nearest = id;
      nearestPx = distancePx;
    }
    return nearest;
  }

  /** Requests a redraw of all layers. */
  refresh() {
    this.backdropStale = true;
    this.askFrame();
  }

  askFrame() {
    if (this.frameAsked) return;
    this.frameAsked = true;
    const restMs = this.restUntilMs - performance.now();
    if (restMs > 1) setTimeout(() => requestAnimationFrame(() => this.drawAndRest()), restMs);
    else requestAnimationFrame(() => this.drawAndRest());
  }

  /** If drawing is slow, as in 3D without a GPU, leaves as much time again for the stream. */
  drawAndRest() {
    this.frameAsked = false;
    const begunMs = performance.now();
    this.draw();
    // The canvas does its work after this function and before the next task.
    setTimeout(() => {
      const tookMs = performance.now() - begunMs;
      this.restUntilMs = tookMs > LONG_MS ? begunMs + 2 * tookMs : 0;
    });
  }

  draw() {
    const { view, palette, store } = this;
    // Hidden behind the health table. The change of its size triggers a redraw when it is shown again.
    if (!this.isShown) return;
    const space = this.mode === "space" ? this.space : null;
    if (this.backdropStale) {
      this.backdropStale = false;
      if (space) space.lay(palette, this.standing(), this.bounds, this.overlay);
      else drawBackdrop(this.layers.backdrop.context, view, palette, this.standing(), this.overlay);
    }
    this.reportVisibleArea();
    const tracks = [...store.tracks.values()];
    if (space) space.draw(this.layers.labels.context, palette, tracks, store.cameras, this.plotOptions());
    else drawTracks(this.layers.tracks.context, view, palette, tracks, this.plotOptions());
    const measured = space ? null : this.tape.places(store.tracks);
    if (measured) drawTape(this.layers.tracks.context, view, palette, measured);
  }

  /** @returns {import("./top/tracks.js").PlotOptions} */
  plotOptions() {
    const { store } = this;
    return {
      exaggeration: this.exaggeration,
      trails: this.trails,
      selected: store.selected,
      hovered: this.hovered,
      timeMs: store.shownMs,
      history: store.history,
      cameras: store.cameras.filter((camera) => camera.mount),
    };
  }

  /** Reports at once, or after REPORT_MS if the last report is recent. */
  reportVisibleArea() {
    if (this.sightTimer) return;
    const { centerX, centerY, scale } = this.view;
    const stepM = (this.mode === "space" ? this.space?.stepM : null) ?? gridStepM(this.view);
    const sight = { centerX, centerY, scale, stepM, measured: this.mode === "top" ? this.tape.words(this.store.tracks) : "" };
    const report = JSON.stringify(sight);
    if (report === this.reportedSight) return;
    this.reportedSight = report;
    this.onVisibleArea(sight);
    this.sightTimer = setTimeout(() => {
      this.sightTimer = 0;
      this.reportVisibleArea();
    }, REPORT_MS);
  }
}
