/** Starts the page: one store, the views that read it, the line to the worker that fills it and draws the arena. */

import { Arena } from "./arena/arena.js";
import { showArenaCalibration } from "./panels/calibration/arena-calibration.js";
import { showCameraCards } from "./panels/cameras/camera-cards.js";
import { showTrajectories } from "./panels/history/trajectories-panel.js";
import { find, setText } from "./base/dom.js";
import { showEventList } from "./panels/history/event-list.js";
import { showHealthPanel } from "./panels/cameras/health-panel.js";
import { listenForKeys } from "./panels/page/keyboard.js";
import { showLensCalibration } from "./panels/calibration/lens-calibration.js";
import { WorkerClient } from "./worker-client.js";
import { showObjectList } from "./panels/objects/object-list.js";
import { showPageHeader } from "./panels/page/page-header.js";
import { decodeMessage, readInfo } from "./wire/messages.js";
import { showObjectForm } from "./panels/objects/object-form.js";
import { showCapabilities } from "./panels/page/server-capabilities.js";
import { showObjectDetails } from "./panels/objects/object-details.js";
import { showCameraPlan } from "./panels/calibration/camera-plan.js";
import { showPrint } from "./panels/calibration/print.js";
import { showRecording } from "./panels/history/recording.js";
import { showReplay } from "./panels/history/replay.js";
import { showObjectSearch } from "./panels/objects/object-search.js";
import { showCameraForm } from "./panels/cameras/camera-form.js";
import { Store } from "./state/store.js";
import { showTimeline } from "./panels/history/timeline.js";
import { showViewSwitch } from "./panels/page/view-switch.js";

/** Snapshots asked for each second: a screen's rate, and half of it where a finger says that it is a phone's. */
const MAX_RATE_HZ = matchMedia("(pointer: coarse)").matches ? 30 : 60;

const store = new Store();
const worker = new WorkerClient(showWorkerFailure);
const arena = new Arena(store, worker, streamAddress());
const list = showObjectList(store);
const clearSearch = showObjectSearch(store, list.setFilter);
showObjectDetails(store);
const lens = showLensCalibration();
const setup = showCameraForm(lens.open);
showCameraCards(store, { edit: setup.edit, findLens: (name) => lens.open({ camera: name, source: "", name: "" }) });
showArenaCalibration(store);
showEventList(store);
const timeline = showTimeline(store);
showTrajectories(store, arena);
showObjectForm(store);
showCameraPlan(store);
showPrint(store);
showRecording(store);
const replay = showReplay(store);
const views = showViewSwitch(arena);
const health = showHealthPanel(store, { open: () => views.show("health"), isOpen: () => views.shown() === "health" });
views.onHealth(health.opened);
listenForKeys({
  show: (mode) => views.show(mode),
  step: timeline.step,
  live: () => store.seekTo(null),
  pause: () => store.info?.replays && replay.togglePause(),
  fit: () => arena.fit(),
  selectNext: (step) => store.selectNext(step),
  follow: () => store.follow(!store.following),
  measure: () => arena.mode === "top" && arena.measure(!arena.measures),
  // One thing after the other: the tape, what is searched for, the object.
  deselect: () => {
    if (arena.measures) arena.measure(false);
    else if (!clearSearch()) store.select(null);
  },
  theme: () => find("#theme").click(),
});

for (const input of document.querySelectorAll("input[name=exaggeration]")) {
  if (!(input instanceof HTMLInputElement)) continue;
  input.addEventListener("change", () => arena.setExaggeration(Number(input.value)));
  // A reloaded page keeps what was chosen, in browsers that restore forms.
  if (input.checked) arena.setExaggeration(Number(input.value));
}
const trails = /** @type {HTMLInputElement} */ (find("#trails"));
trails.addEventListener("change", () => arena.setTrails(trails.checked));
arena.setTrails(trails.checked);
find("#fit").addEventListener("click", () => arena.fit());
find("#zoom-in").addEventListener("click", () => arena.zoomMiddle(1.4));
find("#zoom-out").addEventListener("click", () => arena.zoomMiddle(1 / 1.4));

worker.on("snapshot", (packed) => store.takePackedSnapshot(packed));
worker.on("data", (data) => store.take(decodeMessage(data) ?? {}));
worker.on("report", (report) => store.takeReport(report));
worker.on("connection", ({ phase, sinceMs, retryAtMs }) => {
  const here = (/** @type {number} */ ms) => ms - performance.timeOrigin;
  const before = store.connection.phase;
  store.setConnection({ phase, sinceMs: here(sinceMs), retryAtMs: retryAtMs && here(retryAtMs) });
  // With each connection: it may be another server, or another version of it.
  if (phase === "live" && before !== "live") void loadInfo();
});
showPageHeader(store, () => worker.send("retry"));

/** Without its worker the page can do nothing but say so. */
function showWorkerFailure() {
  find("#banner").hidden = false;
  setText(find("#banner-title"), "A part of this page could not be loaded, or broke.");
  setText(find("#banner-text"), "What you see does not change any more.");
  const button = find("#retry");
  setText(button, "Reload the page");
  button.addEventListener("click", () => location.reload());
}

/** Relative to the page, so that it also works behind a proxy that adds a path. */
function streamAddress() {
  const address = new URL("api/v1/stream", location.href);
  address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  address.search = `?include=snapshots,cameras,events&max_rate_hz=${MAX_RATE_HZ}`;
  return address.href;
}

async function loadInfo() {
  try {
    const response = await fetch("api/v1/info", { cache: "no-store" });
    if (!response.ok) return;
    const info = readInfo(await response.json());
    store.setInfo(info);
    await showCapabilities(info);
  } catch {
    // The stream tells of the loss; the name comes with the next connection.
  }
}
