/**
 * Viewpoint of the 3D view: an eye that orbits a target point, and its projection to pixels.
 *
 * World z is up. The azimuth of the eye as seen from the target is measured from world x towards y, its elevation from the
 * floor.
 */

/** Vertical field of view. */
export const VIEW_RAD = (40 * Math.PI) / 180;
/** Rotation per pixel, radians. */
const TURN_RAD = 0.006;
const LOWEST_RAD = 0.03;
const HIGHEST_RAD = Math.PI / 2 - 0.001;
const NEAREST_M = 0.3;
const FARTHEST_M = 500;

/** @typedef {import("../../base/geometry.js").Vector3} Vector3 */

export class OrbitCamera {
  constructor() {
    /** Point at the centre of the picture, metres. @type {Vector3} */
    this.target = { x: 0, y: 0, z: 0 };
    this.distanceM = 12;
    this.azimuthRad = (-70 * Math.PI) / 180;
    this.elevationRad = (38 * Math.PI) / 180;
    /** Size of the picture, CSS pixels. */
    this.width = 1;
    this.height = 1;
  }

  /** @returns {Vector3} metres */
  get eye() {
    const level = this.distanceM * Math.cos(this.elevationRad);
    return {
      x: this.target.x + level * Math.cos(this.azimuthRad),
      y: this.target.y + level * Math.sin(this.azimuthRad),
      z: this.target.z + this.distanceM * Math.sin(this.elevationRad),
    };
  }

  /** Width of a pixel at a distance from the eye, metres. @param {number} distanceM */
  pixelM(distanceM) {
    return (2 * distanceM * Math.tan(VIEW_RAD / 2)) / this.height;
  }

  /**
   * @param {number} dx pixels of a drag that rotates the arena
   * @param {number} dy
   */
  turn(dx, dy) {
    this.azimuthRad -= dx * TURN_RAD;
    this.elevationRad = Math.min(HIGHEST_RAD, Math.max(LOWEST_RAD, this.elevationRad + dy * TURN_RAD));
  }

  /**
   * Pans along the floor, so that the point at the centre follows the drag.
   * @param {number} dx pixels
   * @param {number} dy
   */
  slide(dx, dy) {
    const step = this.pixelM(this.distanceM);
    const [sin, cos] = [Math.sin(this.azimuthRad), Math.cos(this.azimuthRad)];
    // At a low elevation a pixel up is a long distance on the floor; the factor is limited to three.
    const ahead = (dy * step) / Math.max(0.33, Math.sin(this.elevationRad));
    this.target = {
      x: this.target.x + sin * dx * step - cos * ahead,
      y: this.target.y - cos * dx * step - sin * ahead,
      z: this.target.z,
    };
  }

  /** @param {number} factor above 1: closer */
  zoom(factor) {
    this.distanceM = Math.min(FARTHEST_M, Math.max(NEAREST_M, this.distanceM / factor));
  }

  /**
   * Fits a box into the picture without changing the viewing direction.
   * @param {{minX: number, minY: number, maxX: number, maxY: number}} bounds metres
   * @param {number} heightM of the box
   */
  fit(bounds, heightM) {
    const [dx, dy] = [bounds.maxX - bounds.minX, bounds.maxY - bounds.minY];
    this.target = { x: bounds.minX + dx / 2, y: bounds.minY + dy / 2, z: heightM / 4 };
    const radius = Math.hypot(dx, dy, heightM) / 2;
    const across = 2 * Math.atan(Math.tan(VIEW_RAD / 2) * (this.width / this.height));
    // The box is flatter than its bounding sphere, so the factor can be smaller.
    this.distanceM = (0.88 * Math.max(1, radius)) / Math.sin(Math.min(VIEW_RAD, across) / 2);
  }

  /**
   * Projects a point.
   * @param {Vector3} point metres
   * @returns {{px: number, py: number, depthM: number} | null} null behind the eye
   */
  project(point) {
    const [sa, ca] = [Math.sin(this.azimuthRad), Math.cos(this.azimuthRad)];
    const [se, ce] = [Math.sin(this.elevationRad), Math.cos(this.elevationRad)];
    const [x, y, z] = [point.x - this.target.x, point.y - this.target.y, point.z - this.target.z];
    const away = x * ca * ce + y * sa * ce + z * se;
    const depthM = this.distanceM - away;
    if (depthM < 0.05) return null;
    const scale = 1 / this.pixelM(depthM);
    const right = -x * sa + y * ca;
    const up = -x * ca * se - y * sa * se + z * ce;
    return { px: this.width / 2 + right * scale, py: this.height / 2 - up * scale, depthM };
  }
}
