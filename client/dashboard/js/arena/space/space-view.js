/**
 * The arena in 3D: objects with orientations, trails and error ellipsoids, and cameras with their footprints. Each kind of
 * shape is one buffer that is rewritten for each frame, so that a frame takes about fifteen draw calls for any number of
 * objects.
 *
 * Symbols, colours and labels are those of the view from above (tracks.js); labels have their own canvas.
 */

import { BoxGeometry, CircleGeometry, Color, Matrix4, PerspectiveCamera, Quaternion, RingGeometry, Scene, SphereGeometry, Vector3, WebGLRenderer } from "../../../vendor/three.js";
import { cholesky } from "../../base/geometry.js";
import { drawOutlinedText } from "../canvas/outlined-text.js";
import { FRAME_MS, GAP_MS } from "../../state/history.js";
import { drawLabels } from "../canvas/labels.js";
import { VELOCITY_LINE_S } from "../top/object-symbol.js";
import { OrbitCamera, VIEW_RAD } from "./orbit-camera.js";
import { addOverlay } from "../history-overlay.js";
import { MANY_OBJECTS, trailPlan } from "../top/tracks.js";
import { Coverage, drawFrustum, addFloor, Lines, rgb, stageShapes, InstancedShapes, Tiles } from "./meshes.js";
import { CHI2_95_3D } from "../../state/object-state.js";

/** Radius of symbols, metres; distant ones are enlarged to stay legible. */
const DISC_M = 0.13;
const DISC_PX = 5.5;
const CAMERA_M = 0.16;
/** Largest size of a filled ellipsoid at the centre of the picture, as part of its height. */
const LARGEST_FILL = 0.1;
/** Approximate total number of trail points. */
const TRAIL_POINTS = 1600;
/** Sides of the polygon that approximates an ellipse. */
const OUTLINE = 48;
/** Smallest height of the fitted box, metres. */
const LEAST_HEIGHT_M = 1;

/** @typedef {import("../palette.js").Palette} Palette */
/** @typedef {import("../../wire/messages.js").Camera} Camera */
/** @typedef {import("../../state/store.js").Track} Track */
/** @typedef {import("../../state/object-state.js").ObjectState} ObjectState */
/** @typedef {import("../top/tracks.js").PlotOptions} PlotOptions */
/** @typedef {{state: ObjectState, px: number, py: number, radiusPx: number}} Seen */

export class SpaceView {
  /**
   * @param {OffscreenCanvas | HTMLCanvasElement} canvas
   * @param {WebGL2RenderingContext} context of that canvas
   */
  constructor(canvas, context) {
    this.orbit = new OrbitCamera();
    this.renderer = new WebGLRenderer({ canvas, context });
    const { antialias } = context.getContextAttributes() ?? {};
    this.mostPixels = antialias ? 2 : 1;
    this.camera = new PerspectiveCamera((VIEW_RAD * 180) / Math.PI, 1, 0.05, 2000);
    this.camera.up.set(0, 0, 1);
    this.scene = new Scene();
    this.scene.background = new Color();
    this.still = new Lines();
    this.coverage = new Coverage();
    this.heat = new Tiles();
    this.moving = new Lines();
    this.trails = new Lines();
    this.bodies = new InstancedShapes(new BoxGeometry(1, 0.8, 1.2), 1, 0);
    this.sheets = new InstancedShapes(new CircleGeometry(0.98, 24), 1, 0);
    this.ellipsoids = new InstancedShapes(new SphereGeometry(1, 20, 14), 0.2, 3, new SphereGeometry(1, 10, 7));
    this.marks = new InstancedShapes(new RingGeometry(1.35, 1.6, 40), 1, 0);
    // Without a GPU each vertex takes about a microsecond: draw many objects with less detail.
    const [shapes, coarse] = [stageShapes(3), stageShapes(1)];
    /** @type {Record<import("../../state/object-state.js").Stage, InstancedShapes>} */
    this.stages = {
      tracked: new InstancedShapes(shapes.tracked, 1, 0, coarse.tracked),
      predicted: new InstancedShapes(shapes.predicted, 1, 0, coarse.predicted),
      tentative: new InstancedShapes(shapes.tentative, 1, 0),
      lost: new InstancedShapes(shapes.lost, 1, 0),
      unspecified: new InstancedShapes(shapes.unspecified, 1, 0),
    };
    const instanced = [this.bodies, this.sheets, this.marks, this.ellipsoids, ...Object.values(this.stages)];
    for (const { object } of [this.coverage, this.heat, this.still, this.trails, this.moving, ...instanced]) this.scene.add(object);
    /** @type {Seen[]} drawn objects, to find the one under the pointer */
    this.seen = [];
    this.stepM = 1;
    /** Whether objects are drawn with less detail. */
    this.hasManyObjects = false;
    this.ratio = 1;
    this.scratch = { matrix: new Matrix4(), turn: new Quaternion(), place: new Vector3(), size: new Vector3() };
  }

  /** @param {number} width CSS pixels @param {number} height @param {number} ratio the screen's pixels in one */
  resize(width, height, ratio) {
    this.orbit.width = width;
    this.orbit.height = height;
    this.ratio = ratio;
    this.renderer.setPixelRatio(Math.min(this.mostPixels, ratio));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
  }

  /**
   * Updates the static part: floor, fixed cameras with their footprints, history overlay.
   * @param {Palette} palette
   * @param {Camera[]} cameras
   * @param {import("../viewport.js").Bounds} bounds
   * @param {import("../../state/trajectories.js").HistoryOverlay | null} overlay
   */
  lay(palette, cameras, bounds, overlay) {
    /** @type {Color} */ (this.scene.background).set(palette.sheet);
    this.still.clear();
    this.stepM = addFloor(this.still, palette, bounds);
    for (const camera of cameras) drawFrustum(this.still, palette, camera);
    addOverlay(this.still, this.heat, rgb, palette, overlay);
    this.still.done();
    this.coverage.show(cameras, palette);
    this.heightM = Math.max(LEAST_HEIGHT_M, ...cameras.map((camera) => camera.pose?.position.z ?? 0));
  }

  /** @param {import("../viewport.js").Bounds} bounds */
  fit(bounds) {
    this.orbit.fit(bounds, this.heightM ?? LEAST_HEIGHT_M);
  }

  /**
   * @param {import("../canvas/canvas-layer.js").Context2D} labels in CSS pixels
   * @param {Palette} palette
   * @param {Track[]} tracks
   * @param {Camera[]} cameras all cameras
   * @param {PlotOptions} options
   */
  draw(labels, palette, tracks, cameras, options) {
    const { orbit } = this;
    const eye = orbit.eye;
    this.camera.position.set(eye.x, eye.y, eye.z);
    this.camera.lookAt(orbit.target.x, orbit.target.y, orbit.target.z);
    this.moving.clear();
    this.trails.clear();
    const instanced = [this.bodies, this.sheets, this.marks, this.ellipsoids, ...Object.values(this.stages)];
    this.hasManyObjects = tracks.length >= MANY_OBJECTS;
    for (const shape of instanced) shape.clear(this.hasManyObjects);
    this.seen = [];
    const plan = trailPlan(tracks.length, TRAIL_POINTS);
    for (const { state } of tracks) {
      if (state.positionM) this.addObject(state, state.positionM, palette, options);
      if (options.trails) this.addTrail(state, palette, options, plan);
    }
    for (const camera of cameras) this.addCamera(camera, palette);
    for (const camera of options.cameras) drawFrustum(this.moving, palette, camera);
    for (const part of [this.moving, this.trails, ...instanced]) part.done();
    this.renderer.render(this.scene, this.camera);
    this.label(labels, palette, cameras, options);
  }

  /** @param {ObjectState} state @param {import("../../base/geometry.js").Vector3} p @param {Palette} palette @param {PlotOptions} options */
  addObject(state, p, palette, options) {
    const seen = this.orbit.project(p);
    if (!seen) return;
    const { matrix, turn, place, size } = this.scratch;
    const pixelM = this.orbit.pixelM(seen.depthM);
    const radiusM = Math.max(DISC_M, DISC_PX * pixelM);
    const color = rgb(palette.stage[state.stage]);
    if (state.orientation) turn.set(state.orientation.x, state.orientation.y, state.orientation.z, state.orientation.w);
    else turn.identity();
    matrix.compose(place.set(p.x, p.y, p.z), turn, size.set(radiusM, radiusM, radiusM));
    this.stages[state.stage].add(matrix, color);
    if (state.id === options.selected || state.id === options.hovered) this.marks.add(matrix, rgb(palette.accent));
    // Slightly below the symbol, so that grid lines do not show through.
    if (!this.hasManyObjects && (state.stage === "tracked" || state.stage === "predicted")) {
      this.sheets.add(matrix.setPosition(p.x, p.y, p.z - 0.004), rgb(palette.sheet));
    }
    this.seen.push({ state, px: seen.px, py: seen.py, radiusPx: radiusM / pixelM });
    const soft = rgb(palette.inkSoft);
    // Vertical line to the floor.
    if (p.z > 0.02) this.moving.line(p, { x: p.x, y: p.y, z: 0 }, soft, 0.45);
    if (state.stage === "lost") return;
    const v = state.velocityMS;
    if (v) this.moving.line(p, { x: p.x + v.x * VELOCITY_LINE_S, y: p.y + v.y * VELOCITY_LINE_S, z: p.z + v.z * VELOCITY_LINE_S }, color);
    const heading = state.headingRad;
    if (heading !== null) {
      const [hx, hy] = [Math.cos(heading) * radiusM * 1.7, Math.sin(heading) * radiusM * 1.7];
      const back = state.isHeadingAmbiguous ? -1 : 0;
      this.moving.line({ x: p.x + back * hx, y: p.y + back * hy, z: p.z }, { x: p.x + hx, y: p.y + hy, z: p.z }, rgb(palette.ink));
    }
    this.addEllipsoid(state, p, color, options.exaggeration, radiusM);
  }

  /** @param {ObjectState} state @param {import("../../base/geometry.js").Vector3} p @param {[number, number, number]} color @param {number} exaggeration @param {number} radiusM */
  addEllipsoid(state, p, color, exaggeration, radiusM) {
    const { covariance } = state;
    if (exaggeration === 0 || !covariance) return;
    const by = Math.sqrt(CHI2_95_3D) * exaggeration;
    const [xx, yx, yy, zx, zy, zz] = cholesky(covariance);
    const longestM = by * Math.max(xx, Math.hypot(yx, yy), Math.hypot(zx, zy, zz));
    // Smaller ones are hidden by the symbol.
    if (longestM < radiusM * 0.9) return;
    if (longestM > LARGEST_FILL * this.orbit.pixelM(this.orbit.distanceM) * this.orbit.height) {
      this.addOutline(state, p, color, exaggeration);
      return;
    }
    const { matrix } = this.scratch;
    matrix.set(xx * by, 0, 0, p.x, yx * by, yy * by, 0, p.y, zx * by, zy * by, zz * by, p.z, 0, 0, 0, 1);
    this.ellipsoids.add(matrix, color);
  }

  /** Draws a large ellipsoid as an outline, since a filled one would hide the arena. @param {ObjectState} state @param {import("../../base/geometry.js").Vector3} p @param {[number, number, number]} color @param {number} exaggeration */
  addOutline({ ellipse }, p, color, exaggeration) {
    if (!ellipse) return;
    const [sin, cos] = [Math.sin(ellipse.angleRad), Math.cos(ellipse.angleRad)];
    const at = (/** @type {number} */ i) => {
      const a = ellipse.majorM * exaggeration * Math.cos((2 * Math.PI * i) / OUTLINE);
      const b = ellipse.minorM * exaggeration * Math.sin((2 * Math.PI * i) / OUTLINE);
      return { x: p.x + cos * a - sin * b, y: p.y + sin * a + cos * b, z: p.z };
    };
    for (let i = 0; i < OUTLINE; i += 1) this.moving.line(at(i), at(i + 1), color, 0.5);
  }

  /** @param {ObjectState} state @param {Palette} palette @param {PlotOptions} options @param {{spanMs: number, stride: number}} plan */
  addTrail(state, palette, { history, timeMs }, { spanMs, stride }) {
    const color = rgb(palette.stage[state.stage]);
    const { trails } = this;
    let [x0, y0, z0, lastMs] = [0, 0, 0, -Infinity];
    /** @param {number} atMs @param {number} x @param {number} y @param {number} z */
    const visit = (atMs, x, y, z) => {
      if (atMs > lastMs && atMs - lastMs <= GAP_MS + stride * FRAME_MS) {
        const fresh = 1 - (timeMs - atMs) / spanMs;
        trails.end(x0, y0, z0, color, 0.1 + 0.6 * fresh);
        trails.end(x, y, z, color, 0.1 + 0.6 * fresh);
      }
      [x0, y0, z0, lastMs] = [x, y, z, atMs];
    };
    history.trace(state.id, timeMs - spanMs, timeMs, stride, visit);
    if (state.positionM) visit(timeMs, state.positionM.x, state.positionM.y, state.positionM.z);
  }

  /** @param {Camera} camera @param {Palette} palette */
  addCamera(camera, palette) {
    if (!camera.pose) return;
    const { matrix, turn, place, size } = this.scratch;
    const { position: p, orientation: q } = camera.pose;
    matrix.compose(place.set(p.x, p.y, p.z), turn.set(q.x, q.y, q.z, q.w), size.set(CAMERA_M, CAMERA_M, CAMERA_M));
    this.bodies.add(matrix, rgb(camera.status === "failed" ? palette.failed : palette.inkSoft));
  }

  /** @param {import("../canvas/canvas-layer.js").Context2D} context @param {Palette} palette @param {Camera[]} cameras @param {PlotOptions} options */
  label(context, palette, cameras, options) {
    context.clearRect(0, 0, this.orbit.width, this.orbit.height);
    const labels = this.seen.map(({ state, px, py, radiusPx }) => ({ state, px: px + radiusPx + 4, py: py - radiusPx * 0.5 }));
    drawLabels(context, palette, labels, options, this.ratio);
    context.font = `11px ${palette.font}`;
    context.textAlign = "center";
    context.textBaseline = "bottom";
    for (const camera of cameras) {
      const seen = camera.pose && this.orbit.project(camera.pose.position);
      if (!seen) continue;
      const isFailed = camera.status === "failed";
      const words = isFailed ? `${camera.name} – failed` : camera.name;
      drawOutlinedText(context, palette, words, seen.px, seen.py - 10, isFailed ? palette.failed : palette.inkSoft);
    }
  }

  /** @param {number} px @param {number} py @param {number} reachPx @returns {number | null} id of the nearest object within reach */
  objectAt(px, py, reachPx) {
    let nearest = null;
    let nearestPx = Infinity;
    for (const seen of this.seen) {
      const distancePx = Math.hypot(seen.px - px, seen.py - py) - seen.radiusPx;
      if (distancePx > reachPx || distancePx >= nearestPx) continue;
      nearest = seen.state.id;
      nearestPx = distancePx;
    }
    return nearest;
  }
}
