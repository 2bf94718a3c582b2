/** Arena calibration of the mock server, in the JSON form of `proto/roundel/v1/calibration.proto`. */

const LOOKS_OF_RECORDING = 3;
const LOOKS_OF_SOLVING = 2;

export class Calibrator {
  /** @param {string[]} cameras their names; @param {{refuses?: string, isSevere?: boolean}} [options] */
  constructor(cameras, { refuses = "", isSevere = false } = {}) {
    this.cameras = cameras;
    this.refuses = refuses;
    this.isSevere = isSevere;
    this.version = 0;
    this.asked = [];
    /** While true, stages do not advance, so that a slow page sees every step. */
    this.isHeld = false;
    this.reset("idle");
  }

  reset(stage) {
    Object.assign(this, { stage, looks: 0, seconds: 0, error: "", report: null, applied: 0 });
  }

  /** Status and body of a response. */
  answer(method, path, body) {
    this.asked.push({ method, path, body });
    const refuse = (message) => [409, { error: { code: "failed_precondition", message } }];
    const isRunning = this.stage === "recording" || this.stage === "solving";
    if (path === "/applied" && method === "PUT") {
      if (!this.report) return refuse("there is no calibration to take over: start one first");
      this.version += 1;
      this.applied = this.version;
    } else if (method === "POST") {
      if (this.refuses) return refuse(this.refuses);
      if (isRunning) return refuse("a calibration is running already: wait for it, or cancel it");
      this.reset("recording");
      this.seconds = body.seconds;
    } else if (method === "DELETE") {
      if (!isRunning) return refuse("no calibration is running");
      this.reset("failed");
      this.error = "cancelled";
    } else if (isRunning) {
      this.goOn();
    }
    return [200, this.message()];
  }

  /** Advances with each poll, so that tests do not depend on time. */
  goOn() {
    if (this.isHeld) return;
    this.looks += 1;
    if (this.looks > LOOKS_OF_RECORDING) this.stage = "solving";
    if (this.looks <= LOOKS_OF_RECORDING + LOOKS_OF_SOLVING) return;
    this.stage = "done";
    const findings = [{ message: "camera south-east is weakly constrained: let robots drive longer there", grave: false }];
    if (this.isSevere) {
      findings.unshift({ message: "reference 2 appears 50.1 mm from where it was said to be", grave: true });
    } else {
      this.version += 1;
      this.applied = this.version;
    }
    this.report = {
      cameras: this.cameras.map((camera, i) => ({
        camera,
        moved_m: i === 0 ? null : 0.0123,
        turned_rad: i === 0 ? null : 0.001,
        position_deviation_m: 0.00042,
        rotation_deviation_rad: 0.00001,
        reprojection_px: 0.05,
        error_ratio: 1.02,
        coverage: 0.9,
      })),
      findings,
      sightings: 8901,
      roundels: 20,
      length_s: this.seconds,
      steps: 12,
      solve_s: 1.3,
      sound: !this.isSevere,
    };
  }

  message() {
    const recorded = this.cameras.map((camera, i) => ({
      camera,
      frames: 100 * this.looks,
      codes: 12,
      coverage: 0.2 * this.looks,
      // The last camera shares no codes at first.
      together: i + 1 < this.cameras.length || this.looks > 1 ? [{ camera: this.cameras[0], sightings: 9 }] : [],
    }));
    return {
      stage: this.stage,
      seconds: this.seconds,
      recorded_s: (this.seconds * Math.min(this.looks, LOOKS_OF_RECORDING)) / LOOKS_OF_RECORDING,
      recorded: this.stage === "idle" ? [] : recorded,
      steps: Math.max(0, this.looks - LOOKS_OF_RECORDING),
      error: this.error,
      report: this.report,
      applied_version: this.applied,
      version: this.version,
    };
  }
}
