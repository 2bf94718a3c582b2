/** State of one object at one instant. Derived values are computed on demand. */

import { errorEllipse, headingRad, longestSemiaxis, sigmasM, tiltRad } from "../base/geometry.js";

/** @typedef {import("../base/geometry.js").Vector3} Vector3 */
/** @typedef {import("../base/geometry.js").Quaternion} Quaternion */
/** @typedef {"tentative" | "tracked" | "predicted" | "lost" | "unspecified"} Stage */
/** @typedef {{majorM: number, minorM: number, angleRad: number}} ErrorEllipse */

/** Life stages by their number in the protobuf enumeration. @type {Stage[]} */
export const STAGES = ["unspecified", "tentative", "tracked", "predicted", "lost"];
/** The 0.95 quantile of chi squared with three degrees of freedom. */
export const CHI2_95_3D = 7.814727903;
/** The 0.975 quantile of a normal distribution, for two-sided 95 % intervals. */
const NORMAL_95 = 1.959963985;
/** Indices of the rotation's variances in the 21 numbers of the upper triangle. */
const ROTATION_ENTRIES = [15, 18, 20];

/**
 * 21 numbers, or a function that returns them: most covariances are never read.
 * @typedef {ArrayLike<number> | (() => ArrayLike<number> | null)} Covariance
 */

/**
 * @typedef {object} Values
 * @property {number} id
 * @property {string} name configured, or empty
 * @property {Stage} stage
 * @property {Vector3 | null} positionM
 * @property {Quaternion | null} orientation world_from_object
 * @property {boolean} yawObserved
 * @property {boolean} isHeadingAmbiguous the opposite heading looks the same
 * @property {Vector3 | null} velocityMS
 * @property {Covariance | null} covariance null if it was not sent
 * @property {string[]} cameras
 * @property {number | null} ageMs
 * @property {number | null} residual
 * @property {string} roundel
 * @property {{bits: number, number: number} | null} code null until one is read
 * @property {boolean} [isUntrusted] seen only by cameras without trust
 */

export class ObjectState {
  /** @param {Values} values */
  constructor(values) {
    this.id = values.id;
    this.name = values.name;
    this.stage = values.stage;
    this.positionM = values.positionM;
    this.orientation = values.orientation;
    this.yawObserved = values.yawObserved;
    this.isHeadingAmbiguous = values.isHeadingAmbiguous;
    this.velocityMS = values.velocityMS;
    /** @type {Covariance | null} */
    this.covarianceSource = values.covariance;
    this.cameras = values.cameras;
    this.ageMs = values.ageMs;
    this.residual = values.residual;
    this.roundel = values.roundel;
    this.code = values.code;
    this.isUntrusted = values.isUntrusted === true;
    /** @type {ErrorEllipse | null | undefined} undefined until it is computed */
    this.cachedEllipse = undefined;
  }

  /** Upper triangle of the 6x6. @returns {ArrayLike<number> | null} */
  get covariance() {
    if (typeof this.covarianceSource === "function") this.covarianceSource = this.covarianceSource();
    return this.covarianceSource;
  }

  /** Name, or id without a name. */
  get label() {
    return this.name || String(this.id);
  }

  /** Null while the yaw is not observed. */
  get headingRad() {
    return this.yawObserved && this.orientation ? headingRad(this.orientation) : null;
  }

  get tiltRad() {
    return this.orientation ? tiltRad(this.orientation) : null;
  }

  get speedMS() {
    const { velocityMS } = this;
    return velocityMS && Math.hypot(velocityMS.x, velocityMS.y, velocityMS.z);
  }

  /** Standard deviations of the position. */
  get sigmaM() {
    return this.covariance && sigmasM(this.covariance);
  }

  /** Standard deviations of the rotation about the world's axes. @returns {Vector3 | null} */
  get sigmaRad() {
    const { covariance } = this;
    if (!covariance) return null;
    const [x, y, z] = ROTATION_ENTRIES.map((entry) => Math.sqrt(Math.max(0, covariance[entry])));
    return { x, y, z };
  }

  /** 95 % error ellipse in the floor plane. */
  get ellipse() {
    if (this.cachedEllipse === undefined) this.cachedEllipse = this.covariance && errorEllipse(this.covariance);
    return this.cachedEllipse;
  }

  /** Longest semi-axis of the position's 95 % ellipsoid. */
  get error95M() {
    return this.covariance && Math.sqrt(CHI2_95_3D) * longestSemiaxis(this.covariance);
  }

  /** Half the 95 % interval of the heading; null without a heading. */
  get headingError95Rad() {
    const sigma = this.yawObserved ? this.sigmaRad : null;
    return sigma && NORMAL_95 * sigma.z;
  }
}
