/** Simulated robots and cameras of the mock server, with the layout of the reference installation R4. */

import jpeg from "jpeg-js";

import { rotate } from "../../client/dashboard/js/base/geometry.js";

const ROBOTS = 24;
const PICTURE = { width: 400, height: 225 };
const IMAGE = { width: 1280, height: 720 };
const FOCAL_PX = 735;
/** Background of the pictures, painted once. */
const FLOOR = Buffer.alloc(PICTURE.width * PICTURE.height * 4, 255);
for (let y = 0; y < PICTURE.height; y += 1) {
  for (let x = 0; x < PICTURE.width; x += 1) {
    const at = (y * PICTURE.width + x) * 4;
    FLOOR.fill(120 + 50 * Math.sin((x + y) / 160) + 8 * Math.random(), at, at + 3);
  }
}
/** Indices of the diagonal in the upper triangle of a 6x6 matrix. */
const DIAGONAL = [0, 6, 11, 15, 18, 20];

export class World {
  /** @param {{robots?: number, cameras?: number}} [options] */
  constructor({ robots = ROBOTS, cameras = 4 } = {}) {
    this.startedNs = BigInt(Date.now()) * 1_000_000n;
    this.sourceId = "mock-1";
    this.sequence = 0;
    this.robots = Array.from({ length: robots }, (_, i) => makeRobot(i, robots > ROBOTS));
    this.mounts = Array.from({ length: cameras }, (_, i) => makeMount(i, cameras > 4));
    this.listeners = new Set();
    /** Events, oldest first. */
    this.events = [];
    this.stages = new Map();
  }

  seconds() {
    return performance.now() / 1000;
  }

  onEvent(listener) {
    this.listeners.add(listener);
    return () => this.listeners.delete(listener);
  }

  /** @param {object} event kind, message, and the object or camera */
  tell(event) {
    const whole = { sequence: this.events.length + 1, time_ns: nowNs(0), object_id: 0, camera: "", ...event };
    this.events.push(whole);
    for (const listener of this.listeners) listener(whole);
  }

  /** @param {string} name @param {string} error */
  failCamera(name, error) {
    const mount = this.mounts.find((each) => each.name === name);
    mount.error = error;
    this.tell({ kind: "camera_failed", camera: name, message: `Camera ${name} failed: ${error}` });
  }

  /** @param {string} name */
  restoreCamera(name) {
    const mount = this.mounts.find((each) => each.name === name);
    mount.error = "";
    mount.restarts += 1;
    this.tell({ kind: "camera_running", camera: name, message: `Camera ${name} is running again.` });
  }

  info() {
    return {
      version: "0.1.0",
      source_id: this.sourceId,
      name: "Test hall",
      started_time_ns: String(this.startedNs),
      snapshot_rate_hz: 60,
      records: false,
      replays: false,
      keeps_history: false,
      allows_setup: true,
    };
  }

  snapshot() {
    this.sequence += 1;
    const t = this.seconds();
    return {
      sequence: this.sequence,
      source_id: this.sourceId,
      pose_time_ns: nowNs(0),
      capture_time_ns: nowNs(-31),
      fused_time_ns: nowNs(-2),
      sent_time_ns: nowNs(0),
      objects: this.robots.map((robot) => this.state(robot, t)),
      missed: 0,
      a_field_of_a_later_version: { ignored: true },
    };
  }

  objects() {
    const t = this.seconds();
    return this.robots.map((robot) => ({
      object_id: robot.id,
      name: robot.name,
      roundel: "robot",
      stage: stageOf(robot, t),
      first_seen_time_ns: String(this.startedNs),
      last_seen_time_ns: nowNs(0),
      observations: Math.round(t * 30),
      code: robot.code,
    }));
  }

  state(robot, t) {
    const at = place(robot, t);
    const soon = place(robot, t + 0.01);
    const velocity = { x: (soon.x - at.x) * 100, y: (soon.y - at.y) * 100, z: (soon.z - at.z) * 100 };
    const stage = stageOf(robot, t);
    this.tellOfStage(robot, stage);
    const hidden = stage === "predicted";
    const sigma = hidden ? 0.02 : 0.0012 + 0.0006 * Math.sin(robot.id);
    return {
      object_id: robot.id,
      name: robot.name,
      stage,
      position: at,
      orientation: { x: 0, y: 0, z: 0, w: 1 },
      yaw_observed: robot.code !== null,
      velocity,
      angular_velocity: { x: 0, y: 0, z: 0 },
      covariance: covariance(sigma, robot.id),
      velocity_covariance: [1e-4, 0, 0, 1e-4, 0, 1e-4],
      cameras: hidden ? [] : this.mounts.filter((m) => !m.error && project(m, at)).map((m) => m.name),
      observation_age_ns: hidden ? "740000000" : "31000000",
      residual: 0.9 + 0.3 * Math.sin(t + robot.id),
      roundel: "robot",
      code: robot.code,
    };
  }

  tellOfStage(robot, stage) {
    const before = this.stages.get(robot.id);
    this.stages.set(robot.id, stage);
    if (!before || before === stage) return;
    const kinds = { predicted: "object_predicted", tracked: "object_recovered" };
    const words = { predicted: "is seen by no camera; it is predicted", tracked: "is seen again" };
    if (!kinds[stage]) return;
    const name = robot.name || `Object ${robot.id}`;
    this.tell({ kind: kinds[stage], object_id: robot.id, message: `${name} ${words[stage]}.` });
  }

  cameras() {
    const t = this.seconds();
    return this.mounts.map((mount, i) => ({
      name: mount.name,
      source: `sim:?seed=1&camera=${i}`,
      status: mount.error ? "failed" : "running",
      error: mount.error,
      ...IMAGE,
      pose: { position: mount.position, orientation: mount.orientation },
      intrinsics: {
        lens: "plumb_bob",
        fx_px: FOCAL_PX,
        fy_px: FOCAL_PX,
        cx_px: (IMAGE.width - 1) / 2,
        cy_px: (IMAGE.height - 1) / 2,
        distortion: [0, 0, 0, 0, 0],
      },
      calibration_version: 1,
      frames: Math.round(t * 30),
      dropped: i === 2 ? 3 : 0,
      restarts: mount.restarts,
      rate_hz: mount.error ? 0 : 29.9 + 0.1 * Math.sin(t + i),
      detections: mount.error ? 0 : this.robots.filter((robot) => project(mount, place(robot, t))).length,
      detect_ms: 1.3 + 0.2 * Math.sin(t + i),
      latency_ms: 24 + 3 * Math.sin(t / 2 + i),
      clock: i === 0 ? null : { offset_ms: 12.4 - 9 * i, skew_ppm: 8 * i, deviation_ms: 0.03 * i },
      reprojection_px: i === 3 ? 0 : 0.2 + 0.01 * i,
      blur_px: i === 3 ? 0 : 0.7 + 0.02 * Math.sin(t + i),
      noise: 2.1,
    }));
  }

  /** @param {string} name @returns {Buffer | null} JPEG */
  picture(name) {
    const mount = this.mounts.find((each) => each.name === name);
    if (!mount) return null;
    const data = Buffer.from(FLOOR);
    const t = this.seconds();
    for (const robot of this.robots) paintRoundel(data, project(mount, place(robot, t)));
    return jpeg.encode({ data, ...PICTURE }, 80).data;
  }
}

/** Now plus some milliseconds, as decimal nanoseconds. */
function nowNs(offsetMs) {
  return String(BigInt(Math.round((performance.timeOrigin + performance.now() + offsetMs) * 1000)) * 1000n);
}

/** Few robots are in the arena of R4, many in that of R16. */
function makeRobot(i, isMany) {
  const flying = i % 3 === 2;
  const [columns, gapX, gapY, left, low] = isMany ? [25, 0.95, 1.1, -11.4, -8.2] : [6, 1.45, 1.8, -3.6, -2.7];
  return {
    id: i + 1,
    name: i === 6 ? "Forklift" : "",
    code: i % 6 === 5 ? { bits: 8, number: 40 + i } : null,
    x: left + (i % columns) * gapX,
    y: low + Math.floor(i / columns) * gapY,
    radius: 0.35 + 0.12 * (i % 4),
    omega: (0.5 + 0.13 * (i % 5)) * (i % 2 ? 1 : -1),
    z: flying ? 1.2 + 0.1 * (i % 7) : 0.3,
    bob: flying ? 0.3 : 0,
  };
}

function place(robot, t) {
  const angle = robot.omega * t + robot.id;
  return {
    x: robot.x + robot.radius * Math.cos(angle) + 0.25 * Math.sin(0.31 * angle),
    y: robot.y + robot.radius * Math.sin(angle) * 0.8,
    z: robot.z + robot.bob * Math.sin(angle / 2),
  };
}

/** Robots 5 and 17 are hidden at times, robot 24 stays tentative. */
function stageOf(robot, t) {
  if (robot.id === 24) return "tentative";
  if ((robot.id === 5 || robot.id === 17) && (t + robot.id) % 12 < 4) return "predicted";
  return "tracked";
}

function makeMount(i, isMany) {
  if (isMany) {
    const position = { x: -9 + 6 * (i % 4), y: -6.75 + 4.5 * Math.floor(i / 4), z: 5 };
    const target = { x: position.x * 0.9, y: position.y * 0.9, z: 0 };
    return { name: `camera-${i + 1}`, position, orientation: lookAt(position, target), error: "", restarts: 0 };
  }
  const [sx, sy] = [i % 2 ? 1 : -1, i < 2 ? -1 : 1];
  const position = { x: 2.5 * sx, y: 2 * sy, z: 5 };
  return {
    name: ["south-west", "south-east", "north-west", "north-east"][i] ?? `camera-${i + 1}`,
    position,
    orientation: lookAt(position, { x: 1.25 * sx, y: sy, z: 0 }),
    error: "",
    restarts: 0,
  };
}

/** world_from_camera of a camera with its image's right side level. */
function lookAt(from, to) {
  const normalize = (v) => {
    const n = Math.hypot(...v);
    return v.map((c) => c / n);
  };
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const z = normalize([to.x - from.x, to.y - from.y, to.z - from.z]);
  const x = normalize(cross(z, [0, 0, 1]));
  const y = cross(z, x);
  // Columns x y z to a quaternion; w is far from 0 for none of the mounts, so divide by the largest.
  const m = (r, c) => [x, y, z][c][r];
  const squares = [
    1 + m(0, 0) - m(1, 1) - m(2, 2),
    1 - m(0, 0) + m(1, 1) - m(2, 2),
    1 - m(0, 0) - m(1, 1) + m(2, 2),
    1 + m(0, 0) + m(1, 1) + m(2, 2),
  ];
  const best = squares.indexOf(Math.max(...squares));
  const k = 0.5 / Math.sqrt(squares[best]);
  const q = [
    [squares[0], m(0, 1) + m(1, 0), m(0, 2) + m(2, 0), m(2, 1) - m(1, 2)],
    [m(0, 1) + m(1, 0), squares[1], m(1, 2) + m(2, 1), m(0, 2) - m(2, 0)],
    [m(0, 2) + m(2, 0), m(1, 2) + m(2, 1), squares[2], m(1, 0) - m(0, 1)],
    [m(2, 1) - m(1, 2), m(0, 2) - m(2, 0), m(1, 0) - m(0, 1), squares[3]],
  ][best].map((c) => c * k);
  return { x: q[0], y: q[1], z: q[2], w: q[3] };
}

/** Pixel position and radius of a 160 mm roundel in the small picture, or null if it is not visible. */
function project(mount, point) {
  const { x, y, z, w } = mount.orientation;
  const seen = rotate(
    { x: -x, y: -y, z: -z, w },
    { x: point.x - mount.position.x, y: point.y - mount.position.y, z: point.z - mount.position.z },
  );
  const scale = PICTURE.width / IMAGE.width;
  const focal = FOCAL_PX * scale;
  if (seen.z < 0.3) return null;
  const u = PICTURE.width / 2 + (focal * seen.x) / seen.z;
  const v = PICTURE.height / 2 + (focal * seen.y) / seen.z;
  if (u < 0 || v < 0 || u > PICTURE.width || v > PICTURE.height) return null;
  return { u, v, radius: (focal * 0.08) / seen.z };
}

function paintRoundel(data, seen) {
  if (!seen) return;
  const reach = seen.radius + 4;
  for (let y = Math.ceil(seen.v - reach); y <= seen.v + reach; y += 1) {
    for (let x = Math.ceil(seen.u - reach); x <= seen.u + reach; x += 1) {
      if (x < 0 || y < 0 || x >= PICTURE.width || y >= PICTURE.height) continue;
      const distance = Math.hypot(x - seen.u, y - seen.v);
      const at = (y * PICTURE.width + x) * 4;
      if (distance < seen.radius) data.fill(distance < seen.radius * 0.4 ? 235 : 25, at, at + 3);
      else if (Math.abs(distance - seen.radius - 2) < 0.8) data.set([60, 220, 230], at);
      else if (distance < seen.radius + 1) data.fill(235, at, at + 3);
    }
  }
}

function covariance(sigma, id) {
  const entries = new Array(21).fill(0);
  const variances = [1.6, 0.7, 3, 1, 1, 1].map((part) => part * sigma * sigma);
  DIAGONAL.forEach((entry, i) => {
    entries[entry] = variances[i];
  });
  entries[1] = Math.sin(id) * 0.8 * sigma * sigma;
  return entries;
}
