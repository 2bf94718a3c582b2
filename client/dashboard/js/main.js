/** Starts the page: the store, its views, and the worker that fills the store and draws the arena. */

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
import { SignIn } from "./panels/page/sign-in.js";
import { request } from "./wire/api-client.js";

/** Requested snapshot rate: that of a screen, or half of it on touch devices. */
const MAX_RATE_HZ = matchMedia("(pointer: coarse)").matches ? 30 : 60;

const store = new Store();
const signIn = new SignIn(store, () => {
  worker.send("retry");
  void loadInfo();
});
await signIn.begin();
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
  // Each press undoes one thing: the tape measure, the search, the selection.
  deselect: () => {
    if (arena.measures) arena.measure(false);
    else if (!clearSearch()) store.select(null);
  },
  theme: () => find("#theme").click(),
});

for (const input of document.querySelectorAll("input[name=exaggeration]")) {
  if (!(input instanceof HTMLInputElement)) continue;
  input.addEventListener("change", () => arena.setExaggeration(Number(input.value)));
  // Some browsers restore form values after a reload.
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
  // The new connection may be to another server or version.
  if (phase === "live" && before !== "live") void signIn.check().then(loadInfo);
  // A browser does not say whether the server has refused the connection for want of credentials.
  if (phase === "lost" && retryAtMs !== null) void signIn.check();
});
showPageHeader(store, () => worker.send("retry"));

/** Shows that the worker could not be loaded or has failed. */
function showWorkerFailure() {
  find("#banner").hidden = false;
  setText(find("#banner-title"), "Part of this page could not be loaded or has failed.");
  setText(find("#banner-text"), "The display is no longer updated.");
  const button = find("#retry");
  setText(button, "Reload the page");
  button.addEventListener("click", () => location.reload());
}

/** Relative to the page's URL, so that it works behind a proxy that adds a path. */
function streamAddress() {
  const address = new URL("api/v1/stream", location.href);
  address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
  address.search = `?include=snapshots,cameras,events&max_rate_hz=${MAX_RATE_HZ}`;
  return address.href;
}

async function loadInfo() {
  try {
    const response = await request("info");
    if (!response.ok) return;
    const info = readInfo(await response.json());
    store.setInfo(info);
    await showCapabilities(info, store.session);
  } catch {
    // The stream reports the lost connection; the next connection loads the info again.
  }
}
