/**
 * Geometry of the arena: quaternions, error ellipses, view footprints.
 *
 * Frames, signs and orders follow `core/docs/conventions.md`: metres, radians, quaternions
 * Hamilton stored x y z w, covariances as the upper triangle of the 6x6 row by row. Pure functions
 * without DOM, so that they are tested in Node.
 */

/** @typedef {{x: number, y: number, z: number}} Vector3 */
/** @typedef {{x: number, y: number, z: number, w: number}} Quaternion */
/** @typedef {{x: number, y: number}} Point2 */

/**
 * Square of the radius that holds 95 % of a two-dimensional normal distribution in units of its
 * standard deviations: the 0.95 quantile of chi squared with two degrees of freedom, -2 ln 0.05.
 */
export const CHI2_95_2D = -2 * Math.log(0.05);

/** Depth to which a view that does not end on the floor is drawn, along the optical axis, metres. */
export const VIEW_DEPTH_M = 25;

/** Indices of the position's variances and covariances in the 21 numbers of the upper triangle. */
const POSITION_ENTRIES = { xx: 0, xy: 1, xz: 2, yy: 6, yz: 7, zz: 11 };

/**
 * Rotates a vector by a unit quaternion.
 * @param {Quaternion} q
 * @param {Vector3} v
 * @returns {Vector3}
 */
export function rotate(q, v) {
  // t = 2 q × v;  v' = v + w t + q × t
  const tx = 2 * (q.y * v.z - q.z * v.y);
  const ty = 2 * (q.z * v.x - q.x * v.z);
  const tz = 2 * (q.x * v.y - q.y * v.x);
  return {
    x: v.x + q.w * tx + (q.y * tz - q.z * ty),
    y: v.y + q.w * ty + (q.z * tx - q.x * tz),
    z: v.z + q.w * tz + (q.x * ty - q.y * tx),
  };
}

/**
 * The rotation by b, then by a.
 * @param {Quaternion} a
 * @param {Quaternion} b
 * @returns {Quaternion}
 */
export function multiply(a, b) {
  return {
    x: a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y,
    y: a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
    z: a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w,
    w: a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z,
  };
}

/**
 * Composes two poses: world_from_b = world_from_a · a_from_b.
 * @param {{position: Vector3, orientation: Quaternion}} a
 * @param {{position: Vector3, orientation: Quaternion}} b
 */
export function compose(a, b) {
  const arm = rotate(a.orientation, b.position);
  return {
    position: { x: a.position.x + arm.x, y: a.position.y + arm.y, z: a.position.z + arm.z },
    orientation: multiply(a.orientation, b.orientation),
  };
}

/**
 * Direction of an object's x axis in the world's floor plane, radians from world x towards y.
 * @param {Quaternion} worldFromObject
 */
export function headingRad(worldFromObject) {
  const x = rotate(worldFromObject, { x: 1, y: 0, z: 0 });
  return Math.atan2(x.y, x.x);
}

/**
 * Angle between an object's z axis and the world's, radians in [0, pi].
 * @param {Quaternion} worldFromObject
 */
export function tiltRad(worldFromObject) {
  const z = rotate(worldFromObject, { x: 0, y: 0, z: 1 });
  return Math.acos(Math.min(1, Math.max(-1, z.z)));
}

/**
 * Standard deviations of a position.
 * @param {ArrayLike<number>} covariance 21 numbers
 * @returns {Vector3} metres; a negative variance counts as 0
 */
export function sigmasM(covariance) {
  const sigma = (/** @type {number} */ entry) => Math.sqrt(Math.max(0, covariance[entry]));
  return {
    x: sigma(POSITION_ENTRIES.xx),
    y: sigma(POSITION_ENTRIES.yy),
    z: sigma(POSITION_ENTRIES.zz),
  };
}

/**
 * The ellipse in the floor plane that holds the position with 95 % probability.
 *
 * Semiaxes are √(χ² λ) of the eigenvalues λ of [[a, b], [b, c]], which are m ± r with
 * m = (a + c)/2 and r = √(((a - c)/2)² + b²); the major axis lies at ½ atan2(2b, a - c).
 * @param {ArrayLike<number>} covariance 21 numbers
 * @returns {{majorM: number, minorM: number, angleRad: number}} angle of the major axis from world x
 */
export function errorEllipse(covariance) {
  const a = covariance[POSITION_ENTRIES.xx];
  const b = covariance[POSITION_ENTRIES.xy];
  const c = covariance[POSITION_ENTRIES.yy];
  const mean = (a + c) / 2;
  const radius = Math.hypot((a - c) / 2, b);
  return {
    majorM: Math.sqrt(CHI2_95_2D * Math.max(0, mean + radius)),
    minorM: Math.sqrt(CHI2_95_2D * Math.max(0, mean - radius)),
    angleRad: 0.5 * Math.atan2(2 * b, a - c),
  };
}

/**
 * Root of the largest eigenvalue of the position covariance. For a symmetric 3x3 matrix it is m + 2 p cos(φ) with
 * m = tr/3, p² = tr((A - m)²)/6, cos 3φ = det((A - m)/p)/2 (O. K. Smith, 1961).
 * @param {ArrayLike<number>} covariance 21 numbers
 * @returns {number} metres
 */
export function longestSemiaxis(covariance) {
  const { xx, xy, xz, yy, yz, zz } = POSITION_ENTRIES;
  const mean = (covariance[xx] + covariance[yy] + covariance[zz]) / 3;
  const [a, b, c] = [covariance[xx] - mean, covariance[yy] - mean, covariance[zz] - mean];
  const [d, e, f] = [covariance[xy], covariance[xz], covariance[yz]];
  const p = Math.sqrt((a * a + b * b + c * c + 2 * (d * d + e * e + f * f)) / 6);
  if (p === 0) return Math.sqrt(Math.max(0, mean));
  const half = (a * b * c + 2 * d * e * f - a * f * f - b * e * e - c * d * d) / (2 * p * p * p);
  const angle = Math.acos(Math.min(1, Math.max(-1, half))) / 3;
  return Math.sqrt(Math.max(0, mean + 2 * p * Math.cos(angle)));
}

/**
 * Cholesky factor L of the position covariance A = L Lᵀ. It maps the unit sphere to the one-sigma ellipsoid.
 * @param {ArrayLike<number>} covariance 21 numbers
 * @returns {[number, number, number, number, number, number]} xx, yx, yy, zx, zy, zz; metres
 */
export function cholesky(covariance) {
  const entry = POSITION_ENTRIES;
  const xx = Math.sqrt(Math.max(1e-18, covariance[entry.xx]));
  const yx = covariance[entry.xy] / xx;
  const yy = Math.sqrt(Math.max(1e-18, covariance[entry.yy] - yx * yx));
  const zx = covariance[entry.xz] / xx;
  const zy = (covariance[entry.yz] - zx * yx) / yy;
  const zz = Math.sqrt(Math.max(1e-18, covariance[entry.zz] - zx * zx - zy * zy));
  return [xx, yx, yy, zx, zy, zz];
}

/**
 * Intersection of a camera's view with the floor z = `floorM`, as a convex polygon in world x, y.
 *
 * The view is the pyramid through the image's four corners, cut off at `depthM` along the optical
 * axis; the polygon's corners are where the pyramid's eight edges cross the floor. Distortion is
 * ignored, which changes the outline by a few per cent with ordinary lenses. For an equidistant
 * (fisheye) lens the image radius is an angle, so its tangent is used.
 * @param {{position: Vector3, orientation: Quaternion}} worldFromCamera
 * @param {import("../wire/messages.js").Intrinsics} intrinsics
 * @param {{width: number, height: number}} image pixels
 * @param {number} [floorM]
 * @param {number} [depthM]
 * @returns {Point2[]} counter-clockwise; empty if the camera does not see the floor
 */
export function footprint(worldFromCamera, intrinsics, image, floorM = 0, depthM = VIEW_DEPTH_M) {
  const apex = worldFromCamera.position;
  const corners = imageCorners(intrinsics, image).map((ray) => {
    const turned = rotate(worldFromCamera.orientation, { x: ray.x, y: ray.y, z: 1 });
    return {
      x: apex.x + depthM * turned.x,
      y: apex.y + depthM * turned.y,
      z: apex.z + depthM * turned.z,
    };
  });
  /** @type {Point2[]} */
  const points = [];
  for (let i = 0; i < 4; i += 1) {
    pushCrossing(points, apex, corners[i], floorM);
    pushCrossing(points, corners[i], corners[(i + 1) % 4], floorM);
  }
  return points.length < 3 ? [] : aroundTheirMean(points);
}

/**
 * Corners of the image on the plane z = 1 of the camera frame. Pixel centres lie on
 * integers, so the image extends from -0.5 to size - 0.5.
 * @param {import("../wire/messages.js").Intrinsics} intrinsics
 * @param {{width: number, height: number}} image
 * @returns {Point2[]}
 */
export function imageCorners(intrinsics, image) {
  const outline = [
    [-0.5, -0.5],
    [image.width - 0.5, -0.5],
    [image.width - 0.5, image.height - 0.5],
    [-0.5, image.height - 0.5],
  ];
  return outline.map(([u, v]) => {
    const x = (u - intrinsics.cxPx) / intrinsics.fxPx;
    const y = (v - intrinsics.cyPx) / intrinsics.fyPx;
    if (intrinsics.lens !== "equidistant") return { x, y };
    const angle = Math.hypot(x, y);
    // A view of 180° has no pyramid; it is limited to 80° from the axis.
    const stretch = angle > 0 ? Math.tan(Math.min(angle, (80 * Math.PI) / 180)) / angle : 1;
    return { x: x * stretch, y: y * stretch };
  });
}

/**
 * @param {Point2[]} points
 * @param {Vector3} from
 * @param {Vector3} to
 * @param {number} floorM
 */
function pushCrossing(points, from, to, floorM) {
  const above = from.z - floorM;
  const below = to.z - floorM;
  if (above > 0 === below > 0) return;
  const part = above / (above - below);
  points.push({ x: from.x + part * (to.x - from.x), y: from.y + part * (to.y - from.y) });
}

/**
 * Orders the corners of a convex polygon by their angle about their mean.
 * @param {Point2[]} points
 */
function aroundTheirMean(points) {
  const x = points.reduce((sum, point) => sum + point.x, 0) / points.length;
  const y = points.reduce((sum, point) => sum + point.y, 0) / points.length;
  return points.sort((a, b) => Math.atan2(a.y - y, a.x - x) - Math.atan2(b.y - y, b.x - x));
}

/**
 * Largest 1, 2 or 5 times a power of ten that is at most `limit`, for grids and scales.
 * @param {number} limit above 0
 */
export function roundStep(limit) {
  const power = 10 ** Math.floor(Math.log10(limit));
  const digit = limit / power;
  // The tolerance keeps 0.2 / 0.1 = 1.9999… from falling to the step below.
  if (digit >= 5 - 1e-9) return 5 * power;
  if (digit >= 2 - 1e-9) return 2 * power;
  return power;
}
