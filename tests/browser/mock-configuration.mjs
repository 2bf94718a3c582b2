/** Configuration of the mock server: cameras that can be tested, added, changed and removed, in the JSON form of `proto/roundel/v1/setup.proto`. */

const KEYS = ["name", "source", "calibration", "pose", "line_time_us", "clock_uncertainty_ms", "rate_hz", "mode", "mask"];
const KEPT = "saved in lab.toml";

export class MockConfiguration {
  /** @param {import("./world.mjs").World} world @param {{refuses?: string}} [options] refuses: error message for every change */
  constructor(world, { refuses = "" } = {}) {
    this.world = world;
    this.refuses = refuses;
    this.asked = [];
    this.setups = new Map(
      world.mounts.map((mount, i) => [
        mount.name,
        {
          ...blank(),
          name: mount.name,
          source: `sim:?seed=1&camera=${i}`,
          calibration: "lens.yaml",
          pose: { unknown: false, pose: { position: mount.position, orientation: mount.orientation }, object: "", localizes: false },
        },
      ]),
    );
  }

  /** Status and body of a response; null for other paths. */
  answer(method, path, body) {
    const camera = /^\/cameras\/([^/]+)(\/setup)?$/.exec(path);
    const name = camera && decodeURIComponent(camera[1]);
    const isMine =
      (method === "POST" && (path === "/sources/test" || path === "/cameras")) ||
      (camera && (camera[2] ? method === "GET" : method === "PATCH" || method === "DELETE"));
    if (!isMine) return null;
    this.asked.push({ method, path, body });
    if (this.refuses) return [409, wrong("failed_precondition", this.refuses)];
    if (path === "/sources/test") return this.tryOut(body.source);
    if (method === "POST") return this.add(body);
    const setup = this.setups.get(name);
    if (!setup) return [404, wrong("not_found", `no camera "${name}"`)];
    if (method === "GET") return [200, setup];
    return method === "DELETE" ? this.remove(name) : this.change(name, setup, body);
  }

  tryOut(source) {
    const nothing = { error: "", width: 0, height: 0, frames: 0, broken: 0, rate_hz: 0, promised_rate_hz: 0, roundels: 0, decode_ms: 0, detect_ms: 0 };
    if (!/^[a-z0-9]+:/.test(source)) return [400, wrong("invalid_argument", `source: expected a URL, found "${source}"`)];
    if (source.includes("closed")) return [200, { ...nothing, error: "connection refused: is the camera on?" }];
    return [200, { ...nothing, width: 640, height: 480, frames: 50, rate_hz: 25, promised_rate_hz: 30, roundels: 3, decode_ms: 2.5, detect_ms: 0.3 }];
  }

  /** Error of a setup, if it has one. */
  fault(setup, others) {
    const known = others.some((other) => other === setup.name);
    if (!setup.name) return "name: missing key `name` in [[camera]]; add `name = \"north\"`";
    if (known) return `name: two cameras are named "${setup.name}"; give each camera its own name`;
    if (!setup.source) return "source: missing key `source` in [[camera]]";
    if (!setup.calibration && !setup.source.startsWith("sim:")) return "calibration: missing key `calibration` in [[camera]]";
    if (setup.rate_hz !== null && !(setup.rate_hz > 0)) return `rate_hz: \`rate_hz\` must be a number above 0, at most 1000, found ${setup.rate_hz}`;
    return "";
  }

  add(body) {
    const setup = { ...blank(), ...body };
    const fault = this.fault(setup, [...this.setups.keys()]);
    if (fault) return [400, wrong("invalid_argument", fault)];
    this.setups.set(setup.name, setup);
    const { position, orientation } = setup.pose?.pose ?? this.world.mounts[0];
    this.world.mounts.push({ name: setup.name, position, orientation, error: "", restarts: 0 });
    this.world.tell({ kind: "camera_added", camera: setup.name, message: `Camera ${setup.name} was added; ${KEPT}.` });
    return [200, { camera: this.world.cameras().at(-1), kept: KEPT }];
  }

  change(name, setup, body) {
    const unknown = Object.keys(body).find((key) => !KEYS.includes(key));
    if (unknown) return [400, wrong("invalid_argument", `fields: found "${unknown}"`)];
    const wanted = { ...setup };
    for (const [key, value] of Object.entries(body)) wanted[key] = value ?? blank()[key];
    const fault = this.fault(wanted, [...this.setups.keys()].filter((other) => other !== name));
    if (fault) return [400, wrong("invalid_argument", fault)];
    this.setups.delete(name);
    this.setups.set(wanted.name, wanted);
    const mount = this.world.mounts.find((each) => each.name === name);
    mount.name = wanted.name;
    this.world.tell({ kind: "camera_changed", camera: wanted.name, message: `Camera ${name} was changed; ${KEPT}.` });
    return [200, { camera: this.world.cameras().find((each) => each.name === wanted.name), kept: KEPT }];
  }

  remove(name) {
    this.setups.delete(name);
    this.world.mounts = this.world.mounts.filter((mount) => mount.name !== name);
    this.world.tell({ kind: "camera_removed", camera: name, message: `Camera ${name} was removed; ${KEPT}.` });
    return [200, { camera: null, kept: KEPT }];
  }
}

function blank() {
  return { name: "", source: "", calibration: "", pose: null, line_time_us: null, clock_uncertainty_ms: null, rate_hz: null, mode: "", mask: [] };
}

function wrong(code, message) {
  return { error: { code, message } };
}
