/** Meshes of the 3D view: line buffers, instanced symbols, camera frusta, the floor. */

import {
  BufferAttribute, BufferGeometry, CircleGeometry, Color, DoubleSide, DynamicDrawUsage, InstancedBufferAttribute, InstancedMesh,
  LineBasicMaterial, LineSegments, Mesh, MeshBasicMaterial, RingGeometry,
} from "../../../vendor/three.js";
import { cameraFootprint } from "../top/backdrop.js";
import { imageCorners, roundStep, rotate } from "../../base/geometry.js";

/** Depth of a camera's frustum, metres. */
const FRUSTUM_M = 0.6;
/** Largest number of grid lines in each direction. */
const MOST_LINES = 60;
const LIFT_M = 0.002;

/** @typedef {import("../../base/geometry.js").Vector3} Vector3 */
/** @typedef {import("../palette.js").Palette} Palette */
/** @typedef {import("../../wire/messages.js").Camera} Camera */
/** @typedef {[number, number, number]} Rgb */

/** @type {Map<string, Rgb>} */
const mixed = new Map();

/** Converts a CSS colour to three.js's linear components. @param {string} css @returns {Rgb} */
export function rgb(css) {
  let parts = mixed.get(css);
  if (!parts) {
    const { r, g, b } = new Color(css);
    parts = [r, g, b];
    mixed.set(css, parts);
  }
  return parts;
}

/** Line segments with vertex colours in one draw call. The buffer is rewritten for each frame. */
export class Lines {
  constructor() {
    this.capacity = 0;
    this.count = 0;
    this.geometry = new BufferGeometry();
    const material = new LineBasicMaterial({ vertexColors: true, transparent: true, depthWrite: false });
    this.object = new LineSegments(this.geometry, material);
    this.object.frustumCulled = false;
    this.places = new Float32Array(0);
    this.colors = new Float32Array(0);
    this.grow(256);
  }

  /** @param {number} capacity in line ends */
  grow(capacity) {
    const [places, colors] = [new Float32Array(capacity * 3), new Float32Array(capacity * 4)];
    places.set(this.places);
    colors.set(this.colors);
    [this.places, this.colors, this.capacity] = [places, colors, capacity];
    // GPU buffers have fixed sizes, so growing replaces them.
    this.geometry.dispose();
    this.geometry.setAttribute("position", new BufferAttribute(places, 3).setUsage(DynamicDrawUsage));
    this.geometry.setAttribute("color", new BufferAttribute(colors, 4).setUsage(DynamicDrawUsage));
  }

  clear() {
    this.count = 0;
  }

  /** @param {number} x @param {number} y @param {number} z @param {Rgb} color @param {number} alpha */
  end(x, y, z, color, alpha) {
    if (this.count === this.capacity) this.grow(this.capacity * 2);
    const at = this.count;
    this.count += 1;
    this.places[at * 3] = x;
    this.places[at * 3 + 1] = y;
    this.places[at * 3 + 2] = z;
    this.colors[at * 4] = color[0];
    this.colors[at * 4 + 1] = color[1];
    this.colors[at * 4 + 2] = color[2];
    this.colors[at * 4 + 3] = alpha;
  }

  /** @param {Vector3} a @param {Vector3} b @param {Rgb} color @param {number} [alpha] */
  line(a, b, color, alpha = 1) {
    this.end(a.x, a.y, a.z, color, alpha);
    this.end(b.x, b.y, b.z, color, alpha);
  }

  /** Uploads the lines for drawing. */
  done() {
    this.geometry.setDrawRange(0, this.count);
    for (const name of ["position", "color"]) {
      const attribute = /** @type {BufferAttribute} */ (this.geometry.getAttribute(name));
      attribute.clearUpdateRanges();
      attribute.addUpdateRange(0, this.count * attribute.itemSize);
      attribute.needsUpdate = true;
    }
  }
}

/** One shape drawn many times, with a matrix and a colour for each instance. */
export class InstancedShapes {
  /**
   * @param {BufferGeometry} geometry
   * @param {number} opacity
   * @param {number} order drawing order among transparent shapes
   * @param {BufferGeometry} [coarse] replaces the shape if there are many
   */
  constructor(geometry, opacity, order, coarse = geometry) {
    const isClear = opacity < 1;
    this.fine = geometry;
    this.coarse = coarse;
    this.geometry = geometry;
    this.order = order;
    this.material = new MeshBasicMaterial({ opacity, transparent: isClear, depthWrite: !isClear, side: DoubleSide });
    this.capacity = 64;
    this.count = 0;
    this.object = this.make();
  }

  make() {
    const made = new InstancedMesh(this.geometry, this.material, this.capacity);
    made.frustumCulled = false;
    made.renderOrder = this.order;
    made.instanceMatrix.setUsage(DynamicDrawUsage);
    made.instanceColor = new InstancedBufferAttribute(new Float32Array(this.capacity * 3), 3).setUsage(DynamicDrawUsage);
    return made;
  }

  /** Replaces a full GPU buffer by a larger one. */
  grow() {
    const old = this.object;
    this.capacity *= 2;
    this.object = this.make();
    this.object.instanceMatrix.array.set(old.instanceMatrix.array);
    this.object.instanceColor.array.set(old.instanceColor.array);
    old.parent?.add(this.object);
    old.removeFromParent();
    old.dispose();
  }

  /** @param {boolean} hasManyObjects */
  clear(hasManyObjects) {
    this.count = 0;
    this.geometry = hasManyObjects ? this.coarse : this.fine;
    this.object.geometry = this.geometry;
  }

  /** @param {import("../../../vendor/three.js").Matrix4} matrix @param {Rgb} color */
  add(matrix, color) {
    if (this.count === this.capacity) this.grow();
    matrix.toArray(this.object.instanceMatrix.array, this.count * 16);
    this.object.instanceColor.array.set(color, this.count * 3);
    this.count += 1;
  }

  done() {
    const { object, count } = this;
    object.count = count;
    object.visible = count > 0;
    for (const attribute of [object.instanceMatrix, object.instanceColor]) {
      attribute.clearUpdateRanges();
      attribute.addUpdateRange(0, count * attribute.itemSize);
      attribute.needsUpdate = true;
    }
  }
}

/** Coloured squares on the floor, in one draw call. */
export class Tiles {
  constructor() {
    this.geometry = new BufferGeometry();
    const material = new MeshBasicMaterial({ vertexColors: true, transparent: true, depthWrite: false, side: DoubleSide });
    this.object = new Mesh(this.geometry, material);
    this.object.frustumCulled = false;
    this.clear();
  }

  clear() {
    /** @type {number[]} */
    this.places = [];
    /** @type {number[]} */
    this.colors = [];
  }

  /** @param {number} x of the corner with the smallest coordinates @param {number} y @param {number} z @param {number} sideM @param {Rgb} color @param {number} alpha */
  add(x, y, z, sideM, color, alpha) {
    const [right, top] = [x + sideM, y + sideM];
    this.places.push(x, y, z, right, y, z, right, top, z, x, y, z, right, top, z, x, top, z);
    for (let corner = 0; corner < 6; corner += 1) this.colors.push(...color, alpha);
  }

  done() {
    this.geometry.dispose();
    this.geometry.setAttribute("position", new BufferAttribute(new Float32Array(this.places), 3));
    this.geometry.setAttribute("color", new BufferAttribute(new Float32Array(this.colors), 4));
    this.object.visible = this.places.length > 0;
  }
}

/** Symbols of the life stages as in index.html, with radius 1, in the floor plane. @param {number} fineness multiplies the number of corners; 1: few */
export function stageShapes(fineness) {
  return {
    tracked: new RingGeometry(0.55, 1, 10 * fineness),
    predicted: arcs(6, 2 * fineness),
    tentative: new RingGeometry(0.68, 1.05, 4),
    lost: cross(),
    unspecified: new CircleGeometry(0.5, 16),
  };
}

/** A ring with gaps. @param {number} count @param {number} corners of each */
function arcs(count, corners) {
  const parts = Array.from({ length: count }, (_, i) => new RingGeometry(0.6, 1, corners, 1, (i * 2 * Math.PI) / count, (1.25 * Math.PI) / count));
  return joined(parts);
}

function cross() {
  const corners = [];
  for (const [sx, sy] of [[1, 1], [1, -1]]) {
    const [a, b] = [[-0.75 * sx, -0.75 * sy], [0.75 * sx, 0.75 * sy]];
    const [nx, ny] = [0.16 * -sy, 0.16 * sx];
    corners.push(
      a[0] + nx, a[1] + ny, 0, a[0] - nx, a[1] - ny, 0, b[0] - nx, b[1] - ny, 0,
      a[0] + nx, a[1] + ny, 0, b[0] - nx, b[1] - ny, 0, b[0] + nx, b[1] + ny, 0,
    );
  }
  return new BufferGeometry().setAttribute("position", new BufferAttribute(new Float32Array(corners), 3));
}

/** @param {BufferGeometry[]} parts */
function joined(parts) {
  const corners = parts.flatMap((part) => [.../** @type {BufferAttribute} */ (part.toNonIndexed().getAttribute("position")).array]);
  return new BufferGeometry().setAttribute("position", new BufferAttribute(new Float32Array(corners), 3));
}

/**
 * The grid and the world's axes.
 * @param {Lines} lines
 * @param {Palette} palette
 * @param {import("../viewport.js").Bounds} bounds
 * @returns {number} metres between two lines
 */
export function addFloor(lines, palette, bounds) {
  const span = Math.max(bounds.maxX - bounds.minX, bounds.maxY - bounds.minY, 1);
  let step = roundStep(span / 8);
  if (span / step > MOST_LINES) step *= 10;
  const [x0, x1] = [Math.floor(bounds.minX / step) * step, Math.ceil(bounds.maxX / step) * step];
  const [y0, y1] = [Math.floor(bounds.minY / step) * step, Math.ceil(bounds.maxY / step) * step];
  const color = rgb(palette.gridMajor);
  for (let i = Math.round(x0 / step); i * step <= x1 + step / 2; i += 1) lines.line({ x: i * step, y: y0, z: 0 }, { x: i * step, y: y1, z: 0 }, color);
  for (let i = Math.round(y0 / step); i * step <= y1 + step / 2; i += 1) lines.line({ x: x0, y: i * step, z: 0 }, { x: x1, y: i * step, z: 0 }, color);
  const origin = { x: 0, y: 0, z: LIFT_M };
  lines.line(origin, { x: step, y: 0, z: LIFT_M }, rgb(palette.axisX));
  lines.line(origin, { x: 0, y: step, z: LIFT_M }, rgb(palette.axisY));
  lines.line(origin, { x: 0, y: 0, z: step }, rgb(palette.accent));
  return step;
}

/**
 * A camera's frustum, and its extension to the floor.
 * @param {Lines} lines
 * @param {Palette} palette
 * @param {Camera} camera
 */
export function drawFrustum(lines, palette, camera) {
  if (!camera.pose) return;
  const isFailed = camera.status === "failed";
  const color = rgb(isFailed ? palette.failed : palette.inkSoft);
  const apex = camera.pose.position;
  const outline = cameraFootprint(camera);
  const faint = rgb(isFailed ? palette.failed : palette.view);
  const floor = outline.map((point) => ({ ...point, z: LIFT_M }));
  for (const [i, point] of floor.entries()) {
    lines.line(point, floor[(i + 1) % floor.length], faint, 0.8);
    lines.line(apex, point, faint, 0.22);
  }
  if (!camera.intrinsics || !camera.width || !camera.height) return;
  const { orientation } = camera.pose;
  const corners = imageCorners(camera.intrinsics, camera).map((ray) => {
    const way = rotate(orientation, { x: ray.x * FRUSTUM_M, y: ray.y * FRUSTUM_M, z: FRUSTUM_M });
    return { x: apex.x + way.x, y: apex.y + way.y, z: apex.z + way.z };
  });
  for (const [i, corner] of corners.entries()) {
    lines.line(apex, corner, color);
    lines.line(corner, corners[(i + 1) % 4], color);
  }
}

/** Footprints of the cameras; overlaps are darker. */
export class Coverage {
  constructor() {
    this.geometry = new BufferGeometry();
    this.material = new MeshBasicMaterial({ transparent: true, opacity: 0.09, depthWrite: false, side: DoubleSide });
    this.object = new Mesh(this.geometry, this.material);
    this.object.frustumCulled = false;
  }

  /** @param {Camera[]} cameras @param {Palette} palette */
  show(cameras, palette) {
    this.material.color.set(palette.view);
    /** @type {number[]} */
    const corners = [];
    for (const camera of cameras) {
      if (camera.status === "failed") continue;
      const outline = cameraFootprint(camera);
      for (let i = 1; i + 1 < outline.length; i += 1) {
        for (const point of [outline[0], outline[i], outline[i + 1]]) corners.push(point.x, point.y, LIFT_M / 2);
      }
    }
    this.geometry.dispose();
    this.geometry.setAttribute("position", new BufferAttribute(new Float32Array(corners), 3));
    this.object.visible = corners.length > 0;
  }
}
