/**
 * The arena from above or in 3D, drawn when something has changed and at most once per frame of the screen. From above
 * it is two canvases, what stands still below what moves; in 3D one of WebGL, with labels on another above it.
 */

import { cameraFootprint, drawBackdrop, gridStepM, RULER } from "./backdrop.js";
import { nearestPlace } from "./courses.js";
import { find, setText } from "./dom.js";
import { fixed, timeOfDay } from "./format.js";
import { listenForGestures } from "./gesture.js";
import { Layer } from "./layer.js";
import { readPalette } from "./palette.js";
import { discRadius, drawTracks } from "./plot.js";
import { boundsOf, View } from "./view.js";

/** What a browser without WebGL is told. */
const NO_SPACE = "This browser draws no 3D (WebGL 2 is missing or switched off): here is the view from above.";

/** Kept free round what is fitted, CSS pixels; the rulers come on top. */
const FIT_MARGIN_PX = 26;
/** Kept in view round an object where no camera stands, metres: it will move. */
const ROOM_M = 2;
/** Reach of a click beyond the disc, CSS pixels; fingers are thicker. */
const REACH_PX = 6;
const REACH_COARSE_PX = 18;

export class Arena {
  /** @param {import("./store.js").Store} store */
  constructor(store) {
    this.store = store;
    this.view = new View();
    this.stage = find("#arena-stage");
    this.layers = {
      backdrop: new Layer(find("#arena-backdrop")),
      tracks: new Layer(find("#arena-tracks")),
      labels: new Layer(find("#arena-labels")),
    };
    /** @type {import("./space.js").SpaceView | null} made when it is first wanted: half a megabyte that most phones never load */
    this.space = null;
    /** @type {"top" | "space"} */
    this.mode = "top";
    /** Said below the arena, of a wish that could not be met. */
    this.excuse = "";
    this.caption = find("#arena-caption");
    this.palette = readPalette();
    this.exaggeration = 10;
    this.trails = true;
    /** @type {import("./courses.js").Overlay | null} what the history tells */
    this.overlay = null;
    /** @type {number | null} */
    this.hovered = null;
    /** @type {[number, number] | null} */
    this.pointer = null;
    /** True until the person moves the view: it then no longer fits itself to what there is. */
    this.fitsItself = true;
    /** What the backdrop's cameras look like, to see whether they have changed. */
    this.camerasDrawn = "";
    this.boundsFitted = "";
    this.bounds = boundsOf([]);
    this.backdropStale = true;
    this.frameAsked = false;

    store.on("snapshot", () => this.onSnapshot());
    store.on("time", () => this.onSnapshot());
    store.on("cameras", () => this.onCameras());
    store.on("selection", () => this.onSelection());
    document.addEventListener("themechange", () => {
      this.palette = readPalette();
      this.refresh();
    });
    new ResizeObserver(() => this.onResize()).observe(this.stage);
    listenForGestures(this.stage, this.gestures());
  }

  /** @returns {import("./gesture.js").GestureHandlers} */
  gestures() {
    return {
      drag: (dx, dy, isSecond) => {
        this.fitsItself = false;
        if (this.mode === "space" && this.space && !isSecond) this.space.orbit.turn(dx, dy);
        else {
          this.store.follow(false);
          if (this.mode === "space") this.space?.orbit.slide(dx, dy);
          else this.view.pan(dx, dy);
        }
        this.refresh();
      },
      zoom: (px, py, factor) => this.zoom(px, py, factor),
      pick: (px, py, coarse) => this.store.select(this.objectAt(px, py, coarse)),
      hover: (px, py) => this.hover(px, py),
    };
  }

  /**
   * @param {number} px
   * @param {number} py
   * @param {number} factor
   */
  zoom(px, py, factor) {
    this.fitsItself = false;
    // While following, the object is what stays in place.
    if (this.mode === "space") this.space?.orbit.zoom(factor);
    else if (this.store.following) this.view.zoom(this.view.width / 2, this.view.height / 2, factor);
    else this.view.zoom(px, py, factor);
    this.refresh();
  }

  /** Zooms about the middle. @param {number} factor */
  zoomMiddle(factor) {
    this.zoom(this.view.width / 2, this.view.height / 2, factor);
  }

  /**
   * From above, or in 3D if this browser can.
   * @param {"top" | "space"} mode
   * @returns {Promise<"top" | "space">} what it is now
   */
  async show(mode) {
    this.excuse = "";
    if (mode === "space" && !this.space) this.space = await this.makeSpace();
    this.mode = mode === "space" && this.space ? "space" : "top";
    if (mode !== this.mode) this.excuse = NO_SPACE;
    this.stage.dataset.mode = this.mode;
    this.boundsFitted = "";
    this.onResize();
    this.fitNow();
    this.refresh();
    return this.mode;
  }

  async makeSpace() {
    const canvas = find("#arena-space");
    if (!(canvas instanceof HTMLCanvasElement)) throw new Error("#arena-space is no canvas");
    // Smooth edges are for those who have a card: drawn by the processor, they would take most of its time.
    const context =
      canvas.getContext("webgl2", { alpha: false, antialias: true, failIfMajorPerformanceCaveat: true }) ??
      canvas.getContext("webgl2", { alpha: false, antialias: false });
    if (!context) return null;
    try {
      const { SpaceView } = await import("./space.js");
      return new SpaceView(canvas, context);
    } catch {
      // The file could not be loaded, or the card gave up: the view from above is always there.
      return null;
    }
  }

  /** Shows everything, and keeps showing it until the view is moved. */
  fit() {
    this.fitsItself = true;
    this.boundsFitted = "";
    this.store.follow(false);
    this.fitNow();
    this.refresh();
  }

  /** @param {number} exaggeration 0: no ellipses */
  setExaggeration(exaggeration) {
    this.exaggeration = exaggeration;
    this.refresh();
  }

  /** @param {boolean} trails */
  setTrails(trails) {
    this.trails = trails;
    this.askFrame();
  }

  /** @param {import("./courses.js").Overlay | null} overlay */
  setOverlay(overlay) {
    this.overlay = overlay;
    this.refresh();
  }

  /** What of the floor is seen from above; in 3D, what would be. @returns {import("./view.js").Bounds} metres */
  inView() {
    const { view } = this;
    return { minX: view.worldX(RULER.left), maxX: view.worldX(view.width), minY: view.worldY(view.height - RULER.bottom), maxY: view.worldY(0) };
  }

  onSnapshot() {
    if (this.fitsItself && (this.boundsFitted === "" || this.isLeft())) {
      this.fitNow();
      this.backdropStale = true;
    }
    this.centerOnFollowed();
    this.askFrame();
  }

  /** Whether an object has gone out of sight where no camera that stands says what there is to see. */
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

  /** Cameras that stay where they are. */
  standing() {
    return this.store.cameras.filter((camera) => !camera.mount);
  }

  onSelection() {
    this.centerOnFollowed();
    this.askFrame();
  }

  onResize() {
    const { clientWidth, clientHeight } = this.stage;
    if (clientWidth === 0 || clientHeight === 0) return;
    this.view.width = clientWidth;
    this.view.height = clientHeight;
    for (const layer of Object.values(this.layers)) layer.resize(clientWidth, clientHeight);
    if (this.mode === "space") this.space?.resize(clientWidth, clientHeight);
    this.boundsFitted = "";
    if (this.fitsItself) this.fitNow();
    // Drawn at once: a resized canvas is empty, and would flash until the next frame.
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

  /** Fits to the cameras that stand and what they see; to the objects where no such camera's place is known. */
  fitNow() {
    const { tracks } = this.store;
    const places = this.standing().flatMap((camera) =>
      camera.pose ? [camera.pose.position, ...cameraFootprint(camera)] : [],
    );
    if (places.length === 0) {
      for (const { state } of tracks.values()) {
        if (!state.positionM) continue;
        const { x, y } = state.positionM;
        places.push({ x: x - ROOM_M, y: y - ROOM_M }, { x: x + ROOM_M, y: y + ROOM_M });
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

  /**
   * @param {number | null} px
   * @param {number | null} py
   */
  hover(px, py) {
    this.pointer = px === null || py === null ? null : [px, py];
    const hovered = this.pointer ? this.objectAt(...this.pointer, false) : null;
    this.stage.classList.toggle("over-object", hovered !== null);
    if (hovered !== this.hovered) {
      this.hovered = hovered;
      this.askFrame();
    }
    this.describe();
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

  /** Draws all anew with the next frame. */
  refresh() {
    this.backdropStale = true;
    this.askFrame();
  }

  askFrame() {
    if (this.frameAsked) return;
    this.frameAsked = true;
    requestAnimationFrame(() => {
      this.frameAsked = false;
      this.draw();
    });
  }

  draw() {
    const { view, palette, store } = this;
    // Behind the table of health nobody sees it; it is drawn anew when it comes back, since its size changes then.
    if (this.stage.clientWidth === 0) return;
    const space = this.mode === "space" ? this.space : null;
    if (this.backdropStale) {
      this.backdropStale = false;
      if (space) space.lay(palette, this.standing(), this.bounds, this.overlay);
      else drawBackdrop(this.layers.backdrop.context, view, palette, this.standing(), this.overlay);
      this.describe();
    }
    const tracks = [...store.tracks.values()];
    if (space) space.draw(this.layers.labels.context, palette, tracks, store.cameras, this.plotOptions());
    else drawTracks(this.layers.tracks.context, view, palette, tracks, this.plotOptions());
  }

  /** @returns {import("./plot.js").PlotOptions} */
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

  /** Says the scale, how far the ellipses are exaggerated, and where the pointer is. */
  describe() {
    const isSpace = this.mode === "space";
    const shapes = isSpace ? "ellipsoids" : "ellipses";
    const parts = [this.excuse, `Grid ${isSpace ? this.space?.stepM : gridStepM(this.view)} m`].filter(Boolean);
    if (this.exaggeration === 1) parts.push(`95 % ${shapes} to scale`);
    if (this.exaggeration > 1) parts.push(`95 % ${shapes} drawn ${this.exaggeration}× larger`);
    parts.push("lines reach 0.5 s ahead");
    if (isSpace) parts.push("drag turns, Shift and drag moves");
    else if (this.pointer) {
      const [px, py] = this.pointer;
      parts.push(`x ${fixed(this.view.worldX(px), 2)}  y ${fixed(this.view.worldY(py), 2)} m`, this.passedWords(px, py));
    }
    setText(this.caption, parts.filter(Boolean).join("  ·  "));
  }

  /** Who passed the pointer when, of the history's courses. @param {number} px @param {number} py */
  passedWords(px, py) {
    const { view, overlay } = this;
    if (!overlay || overlay.heat) return "";
    const passed = nearestPlace(overlay.courses, view.worldX(px), view.worldY(py), REACH_COARSE_PX / view.scale);
    return passed ? `${passed.course.label} was here at ${timeOfDay(passed.timeMs)}` : "";
  }
}
