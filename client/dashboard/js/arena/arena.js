/**
 * The arena's element in the page. Sends the user's input to the stage (stage.js), which draws in a worker, and writes the
 * caption below it.
 */

import { gridStepM, RULER } from "./top/backdrop.js";
import { nearestPoint } from "../state/trajectories.js";
import { find, setText } from "../base/dom.js";
import { fixed, timeOfDay } from "../base/format.js";
import { listenForGestures } from "./gestures.js";
import { readPalette } from "./palette.js";
import { Viewport } from "./viewport.js";

/** Shown by browsers without WebGL. */
const NO_SPACE = "3D is not available (WebGL 2 is missing or disabled); showing the view from above.";
/** Largest distance between pointer and trajectory for its time to be shown, CSS pixels. */
const PASSED_PX = 18;

/** @typedef {import("./stage.js").StageMode} StageMode */

export class Arena {
  /**
   * @param {import("../state/store.js").Store} store
   * @param {import("../worker-client.js").WorkerClient} worker
   * @param {string} url of the stream
   */
  constructor(store, worker, url) {
    this.store = store;
    this.worker = worker;
    this.stage = find("#arena-stage");
    this.caption = find("#arena-caption");
    /** The visible part of the floor, as last reported by the stage. */
    this.view = new Viewport();
    this.stepM = gridStepM(this.view);
    /** @type {StageMode} */
    this.mode = "top";
    /** Why the requested mode is not shown, for the caption. */
    this.excuse = "";
    this.look = { exaggeration: 10, trails: true };
    /** @type {import("../state/trajectories.js").HistoryOverlay | null} */
    this.overlay = null;
    /** @type {[number, number] | null} */
    this.pointer = null;
    /** Whether clicks measure, and the measured distance as text. */
    this.measures = false;
    this.measured = "";
    this.tapeButton = find("#tape");
    /** @type {((mode: StageMode) => void)[]} callers of `show` that wait for the worker */
    this.waiting = [];

    this.open(url);
    store.on("selection", () => worker.send("select", { id: store.selected, following: store.following }));
    store.on("time", () => worker.send("past", store.pastMs));
    document.addEventListener("themechange", () => worker.send("palette", readPalette()));
    document.addEventListener("visibilitychange", () => {
      // The page is visible again: retry at once.
      if (document.visibilityState === "visible") worker.send("retry");
    });
    this.tapeButton.addEventListener("click", () => this.measure(!this.measures));
    new ResizeObserver(() => this.onResize()).observe(this.stage);
    listenForGestures(this.stage, this.gestures());
  }

  /** @param {string} url */
  open(url) {
    const { worker } = this;
    const canvas = (/** @type {string} */ name) => worker.hand(/** @type {HTMLCanvasElement} */ (find(`#arena-${name}`)));
    const canvases = { backdrop: canvas("backdrop"), tracks: canvas("tracks"), space: canvas("space"), labels: canvas("labels") };
    worker.send("open", { url, canvases, palette: readPalette() }, /** @type {Transferable[]} */ (Object.values(canvases)));
    this.onResize();
    worker.on("sight", ({ centerX, centerY, scale, stepM, measured }) => {
      Object.assign(this.view, { centerX, centerY, scale });
      this.stepM = stepM;
      this.measured = measured;
      this.describe();
    });
    worker.on("hovered", (id) => this.stage.classList.toggle("over-object", id !== null));
    worker.on("picked", (id) => this.store.select(id));
    worker.on("shown", (mode) => this.waiting.shift()?.(mode));
  }

  /** @returns {import("./gestures.js").GestureHandlers} */
  gestures() {
    const { worker, store } = this;
    return {
      drag: (dx, dy, isSecond) => {
        if (this.mode === "top" || isSecond) store.follow(false);
        worker.send("drag", [dx, dy, isSecond]);
      },
      zoom: (px, py, factor) => worker.send("zoom", [px, py, factor]),
      pick: (px, py, coarse) => worker.send(this.measures && this.mode === "top" ? "measure" : "pick", { px, py, coarse }),
      hover: (px, py) => {
        this.pointer = px === null || py === null ? null : [px, py];
        worker.send("point", this.pointer);
        this.describe();
      },
    };
  }

  /** Turns the tape measure on or off. @param {boolean} measures */
  measure(measures) {
    this.measures = measures;
    this.tapeButton.setAttribute("aria-pressed", String(measures));
    this.stage.classList.toggle("measuring", measures);
    this.worker.send("tape", measures);
  }

  /** Zooms about the middle. @param {number} factor */
  zoomMiddle(factor) {
    this.worker.send("zoom", [this.view.width / 2, this.view.height / 2, factor]);
  }

  /**
   * Switches the view. Falls back from 3D to the view from above if WebGL is missing.
   * @param {StageMode} wanted
   * @returns {Promise<StageMode>} the mode shown
   */
  async show(wanted) {
    this.onResize();
    this.worker.send("show", wanted);
    this.mode = await new Promise((resolve) => this.waiting.push(resolve));
    this.excuse = this.mode === wanted ? "" : NO_SPACE;
    this.stage.dataset.mode = this.mode;
    this.describe();
    return this.mode;
  }

  /** Fits everything into the view, until the user moves it. */
  fit() {
    this.store.follow(false);
    this.worker.send("fit");
  }

  /** @param {number} exaggeration 0: no ellipses */
  setExaggeration(exaggeration) {
    this.look.exaggeration = exaggeration;
    this.worker.send("look", this.look);
    this.describe();
  }

  /** @param {boolean} trails */
  setTrails(trails) {
    this.look.trails = trails;
    this.worker.send("look", this.look);
  }

  /** @param {import("../state/trajectories.js").HistoryOverlay | null} overlay */
  setOverlay(overlay) {
    this.overlay = overlay;
    this.worker.send("overlay", overlay);
  }

  /** Part of the floor that is visible from above, also in 3D mode. @returns {import("./viewport.js").Bounds} metres */
  inView() {
    const { view } = this;
    return { minX: view.worldX(RULER.left), maxX: view.worldX(view.width), minY: view.worldY(view.height - RULER.bottom), maxY: view.worldY(0) };
  }

  onResize() {
    const { clientWidth: width, clientHeight: height } = this.stage;
    if (width > 0 && height > 0) Object.assign(this.view, { width, height });
    this.worker.send("size", { width, height, ratio: devicePixelRatio || 1 });
  }

  /** Updates the caption: grid, exaggeration of the ellipses, position of the pointer. */
  describe() {
    const isSpace = this.mode === "space";
    const { exaggeration } = this.look;
    const shapes = isSpace ? "ellipsoids" : "ellipses";
    const parts = [this.excuse, this.measured, `Grid ${this.stepM} m`];
    if (exaggeration === 1) parts.push(`95 % ${shapes} to scale`);
    if (exaggeration > 1) parts.push(`95 % ${shapes} drawn ${exaggeration}× larger`);
    parts.push("lines: motion in the next 0.5 s");
    if (isSpace) parts.push("drag to rotate, Shift+drag to pan");
    else if (this.pointer) {
      const [px, py] = this.pointer;
      parts.push(`x ${fixed(this.view.worldX(px), 2)}  y ${fixed(this.view.worldY(py), 2)} m`, this.passedText(px, py));
    }
    setText(this.caption, parts.filter(Boolean).join("  ·  "));
  }

  /** The nearest trajectory at the pointer, with its time. @param {number} px @param {number} py */
  passedText(px, py) {
    const { view, overlay } = this;
    if (!overlay || overlay.heat) return "";
    const passed = nearestPoint(overlay.trajectories, view.worldX(px), view.worldY(py), PASSED_PX / view.scale);
    return passed ? `${passed.trajectory.label} was here at ${timeOfDay(passed.timeMs)}` : "";
  }
}
