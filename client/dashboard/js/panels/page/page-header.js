/** Header of the page: installation, connection, counts and rates; and the banner for a lost connection. */

import { find, glyph, throttle, setText } from "../../base/dom.js";
import { duration, fixed, timeOfDay, whole } from "../../base/format.js";

/** Age from which data is stale, ms. */
const STALE_MS = 500;
const STAGES = /** @type {const} */ (["tracked", "predicted", "tentative", "lost"]);

/**
 * @param {import("../../state/store.js").Store} store
 * @param {() => void} retryNow
 */
export function showPageHeader(store, retryNow) {
  const stages = showStages(store);
  const figures = {
    link: find("#link-text"),
    rate: find("#rate"),
    age: find("#age"),
    missed: find("#missed"),
    bannerText: find("#banner-text"),
    bannerTitle: find("#banner-title"),
  };
  const banner = find("#banner");
  const note = find("#arena-note");
  find("#retry").addEventListener("click", retryNow);

  const showFigures = () => {
    const { phase } = store.connection;
    // The age of replayed data has no meaning.
    const age = store.info?.replays ? null : store.dataAgeMs();
    setText(figures.rate, phase === "live" ? fixed(store.report.rateHz, 1) : "–");
    setText(figures.age, duration(age));
    figures.age.classList.toggle("stale", age !== null && age > STALE_MS);
    setText(figures.missed, whole(store.report.missed));
    setText(figures.link, linkText(store));
    if (phase === "lost") setText(figures.bannerText, lossText(store));
    const words = noteText(store);
    note.hidden = words === "";
    setText(note, words);
  };

  const showPhase = () => {
    const { phase } = store.connection;
    document.body.dataset.phase = phase;
    setText(figures.bannerTitle, store.snapshot ? "Connection lost." : "No connection.");
    banner.hidden = phase !== "lost";
    showFigures();
  };

  store.on("connection", showPhase);
  store.on("snapshot", throttle(250, stages));
  store.on("info", () => showInfo(store));
  store.on("report", throttle(250, showFigures));
  // Ages grow between reports.
  setInterval(showFigures, 1000);
  showPhase();
  stages();
}

/**
 * @param {import("../../state/store.js").Store} store
 * @returns {() => void} updates the counts
 */
function showStages(store) {
  const target = find("#stages");
  const counts = STAGES.map((stage) => {
    const count = document.createElement("b");
    const item = document.createElement("span");
    item.className = `stage-count stage-${stage}`;
    item.dataset.stage = stage;
    item.append(glyph(stage), count, ` ${stage}`);
    target.append(item);
    return { stage, item, count };
  });
  return () => {
    const states = [...store.tracks.values()].map((track) => track.stage);
    for (const { stage, item, count } of counts) {
      const number = states.filter((each) => each === stage).length;
      setText(count, String(number));
      // Tracked objects are always shown, other stages only if there are any.
      item.hidden = number === 0 && stage !== "tracked";
    }
  };
}

/** @param {import("../../state/store.js").Store} store */
function showInfo(store) {
  const { info } = store;
  if (!info) return;
  const name = info.name || "Unnamed installation";
  const title = find("#installation");
  setText(title, name);
  title.title = info.version ? `Roundel ${info.version}, ${fixed(info.snapshotRateHz, 0)} snapshots per second` : "";
  document.title = `${name} – Roundel`;
}

/** @param {import("../../state/store.js").Store} store */
function linkText(store) {
  const { phase } = store.connection;
  if (phase === "connecting") return "Connecting…";
  if (phase === "lost") return store.connection.retryAtMs === null ? "Reconnecting…" : "Disconnected";
  // A replay is never "Live", even before its state is known.
  if (store.info?.replays) return store.replay?.ended ? "Replay ended" : store.replay?.paused ? "Replay paused" : "Replaying";
  const age = store.dataAgeMs();
  return age !== null && age > STALE_MS ? "Connected, no new data" : "Live";
}

/** @param {import("../../state/store.js").Store} store */
function lossText(store) {
  const now = performance.now();
  const { sinceMs, retryAtMs } = store.connection;
  const { receivedAtMs } = store.report;
  const shown =
    store.snapshot && receivedAtMs !== null
      ? `Showing data from ${timeOfDay(receivedAtMs)}, ${duration(Date.now() - receivedAtMs)} ago.`
      : `The server has not answered for ${duration(now - sinceMs)}. Is it running at ${location.host}?`;
  const next =
    retryAtMs === null ? "Connecting…" : `Next attempt in ${Math.max(1, Math.ceil((retryAtMs - now) / 1000))} s.`;
  return `${shown} ${next}`;
}

/**
 * Explains why the arena is empty; empty if it is not.
 * @param {import("../../state/store.js").Store} store
 */
function noteText(store) {
  if (store.connection.phase === "connecting") return "Connecting to the server…";
  if (store.connection.phase === "lost") return store.snapshot ? "" : "No connection to the server.";
  if (store.tracks.size > 0 || !store.snapshot || !store.camerasKnown) return "";
  if (store.pastMs !== null) return "No data for this time.";
  if (store.cameras.length === 0) return "No cameras are configured.";
  if (!store.cameras.some((camera) => camera.status === "running")) return "No camera is running.";
  return "No objects in view.";
}
