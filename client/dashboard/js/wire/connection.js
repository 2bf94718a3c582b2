/**
 * The stream from the server, reopened with backoff after a loss.
 *
 * A broken network often leaves a socket open. A time without messages therefore counts as a loss:
 * the server sends the cameras twice a second.
 */

import { decodeMessage } from "./messages.js";

/** Subprotocols, the preferred one first. A server that supports neither sends JSON. */
const PROTOCOLS = ["roundel.v1.protobuf", "roundel.v1.json"];
/** Time without messages after which the connection counts as lost, ms. */
const SILENCE_MS = 3000;
/** First and longest pause before another attempt, ms. */
const FIRST_PAUSE_MS = 500;
const LONGEST_PAUSE_MS = 8000;

/**
 * @typedef {object} ConnectionState
 * @property {"connecting" | "live" | "lost"} phase
 * @property {number} sinceMs `performance.now()` when the connection was lost; else when the phase began
 * @property {number | null} retryAtMs `performance.now()` of the next attempt; null while one runs
 */

/**
 * @param {string} url of the WebSocket
 * @param {{onMessage: (message: import("./messages.js").Message, data: string | ArrayBuffer) => void, onState: (state: ConnectionState) => void}} handlers
 * @returns {{retryNow: () => void}}
 */
export function connect(url, { onMessage, onState }) {
  /** @type {WebSocket | null} */
  let socket = null;
  /** @type {ConnectionState} */
  let state = { phase: "connecting", sinceMs: performance.now(), retryAtMs: null };
  let attempts = 0;
  let silenceTimer = 0;
  let retryTimer = 0;

  /** @param {Partial<ConnectionState>} change */
  const become = (change) => {
    state = { ...state, ...change };
    onState(state);
  };

  const listen = () => {
    clearTimeout(silenceTimer);
    silenceTimer = setTimeout(lose, SILENCE_MS);
  };

  function open() {
    clearTimeout(retryTimer);
    if (state.phase === "lost") become({ retryAtMs: null });
    const mine = new WebSocket(url, PROTOCOLS);
    mine.binaryType = "arraybuffer";
    socket = mine;
    listen();
    mine.onmessage = (event) => {
      if (socket !== mine) return;
      listen();
      const message = decodeMessage(event.data);
      if (message === null) return;
      if (state.phase !== "live") {
        attempts = 0;
        become({ phase: "live", sinceMs: performance.now(), retryAtMs: null });
      }
      onMessage(message, event.data);
    };
    mine.onclose = () => {
      if (socket === mine) lose();
    };
  }

  function lose() {
    clearTimeout(silenceTimer);
    // Cleared first, so that the close event is not counted as a second loss.
    const old = socket;
    socket = null;
    old?.close();
    const pause = pauseMs(attempts);
    attempts += 1;
    const now = performance.now();
    const sinceMs = state.phase === "lost" ? state.sinceMs : now;
    become({ phase: "lost", sinceMs, retryAtMs: now + pause });
    clearTimeout(retryTimer);
    retryTimer = setTimeout(open, pause);
  }

  const retryNow = () => {
    if (state.phase === "lost" && socket === null) open();
  };

  // The network is back: retry at once.
  addEventListener("online", retryNow);

  onState(state);
  open();
  return { retryNow };
}

/**
 * Exponential backoff with jitter, which keeps many pages from reconnecting at the same time.
 * @param {number} attempts number of failed attempts
 */
function pauseMs(attempts) {
  const pause = Math.min(FIRST_PAUSE_MS * 2 ** attempts, LONGEST_PAUSE_MS);
  return pause * (0.75 + 0.5 * Math.random());
}
