/** Rate, latency and age of the stream's snapshots. Pure: the time is an argument. */

/** Window over which the snapshots are counted, ms. */
const RATE_WINDOW_MS = 2000;
/** After less than this a rate says nothing, ms. */
const LEAST_WINDOW_MS = 500;

/**
 * @typedef {object} StreamReport
 * @property {number | null} rateHz snapshots a second over the last two; null before there is enough to say
 * @property {number | null} ageMs of the newest capture: what passed on the server until it was sent, by the server's
 *   clock, and what has passed here since it came, by this machine's. The way between is not in it, but no difference of
 *   two machines' clocks is either
 * @property {number | null} receivedAtMs when the newest snapshot came, since the Unix epoch
 * @property {number} missed snapshots that this page was too slow for
 * @property {number[]} latenciesMs of the snapshots since the report before: from the capture to the sending
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

  /** A connection begins, or ends. @param {number} nowMs */
  begin(nowMs) {
    this.beganMs = nowMs;
    this.arrivals = [];
  }

  /** @param {import("../wire/messages.js").Snapshot} snapshot @param {number} nowMs */
  take({ sourceId, latencyMs, missed }, nowMs) {
    // A server that has started again has had us miss nothing yet.
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
