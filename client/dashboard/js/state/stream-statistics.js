/** Rate, latency and age of the stream's snapshots. The time is an argument. */

/** Window of the snapshot rate, ms. */
const RATE_WINDOW_MS = 2000;
/** Shortest window for which a rate is reported, ms. */
const LEAST_WINDOW_MS = 500;

/**
 * @typedef {object} StreamReport
 * @property {number | null} rateHz snapshots per second; null while the window is too short
 * @property {number | null} ageMs age of the newest capture: from capture to sending by the server's clock, plus the time
 *   since its arrival by this machine's clock. It does not include the network, and does not compare the two clocks
 * @property {number | null} receivedAtMs arrival of the newest snapshot, since the Unix epoch
 * @property {number} missed snapshots that this page was too slow for
 * @property {number[]} latenciesMs from capture to sending, of the snapshots since the last report
 */

export class StreamStatistics {
  constructor() {
    this.beganMs = 0;
    /** @type {number[]} */
    this.arrivals = [];
    /** @type {number | null} */
    this.receivedAtMs = null;
    this.latencyMs = 0;
    this.missed = 0;
    this.sourceId = "";
    /** @type {number[]} not reported yet */
    this.latencies = [];
  }

  /** Restarts the rate when a connection begins or ends. @param {number} nowMs */
  begin(nowMs) {
    this.beganMs = nowMs;
    this.arrivals = [];
  }

  /** @param {import("../wire/messages.js").Snapshot} snapshot @param {number} nowMs */
  take({ sourceId, latencyMs, missed }, nowMs) {
    // Counts start at zero with another run of the server.
    if (sourceId !== this.sourceId) this.missed = 0;
    this.sourceId = sourceId;
    this.missed += missed;
    this.receivedAtMs = nowMs;
    this.latencyMs = latencyMs ?? 0;
    if (latencyMs !== null) this.latencies.push(latencyMs);
    this.arrivals.push(nowMs);
  }

  /** @param {number} nowMs @returns {StreamReport} */
  report(nowMs) {
    while (this.arrivals.length > 0 && this.arrivals[0] < nowMs - RATE_WINDOW_MS) this.arrivals.shift();
    const spanMs = nowMs - Math.max(this.beganMs, nowMs - RATE_WINDOW_MS);
    const latenciesMs = this.latencies;
    this.latencies = [];
    const { receivedAtMs, missed } = this;
    return {
      rateHz: spanMs < LEAST_WINDOW_MS ? null : (this.arrivals.length / spanMs) * 1000,
      ageMs: receivedAtMs === null ? null : this.latencyMs + nowMs - receivedAtMs,
      receivedAtMs: receivedAtMs === null ? null : receivedAtMs + performance.timeOrigin,
      missed,
      latenciesMs,
    };
  }
}
