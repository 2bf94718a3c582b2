/** Starts the page: one store, the views that read it, the connection that fills it. */

import { Arena } from "./arena.js";
import { showCalibration } from "./calibration.js";
import { showCameras } from "./cameras.js";
import { connect } from "./connection.js";
import { showCourses } from "./courses-view.js";
import { find } from "./dom.js";
import { showEvents } from "./events.js";
import { showHealth } from "./health-view.js";
import { listenForKeys } from "./keys.js";
import { showList } from "./list.js";
import { showMasthead } from "./masthead.js";
import { readInfo } from "./message.js";
import { showObjects } from "./object-form.js";
import { showOffer } from "./offer.js";
import { showPanel } from "./panel.js";
import { showPlan } from "./plan.js";
import { showPrint } from "./print.js";
import { showRecording } from "./recording.js";
import { showReplay } from "./replay.js";
import { showSearch } from "./search.js";
import { showSetup } from "./setup.js";
import { Store } from "./store.js";
import { showTimeline } from "./timeline.js";
import { showViews } from "./views.js";

/** Snapshots asked for each second: a screen's rate, and half of it where a finger says that it is a phone's. */
const MAX_RATE_HZ = matchMedia("(pointer: coarse)").matches ? 30 : 60;

const store = new Store();
const arena = new Arena(store);
const list = showList(store);
showSearch(store, list.narrow);
showPanel(store);
const setup = showSetup();
showCameras(store, setup.edit);
showCalibration(store);
showEvents(store);
const timeline = showTimeline(store);
showCourses(store, arena);
showObjects(store);
showPlan();
showPrint(store);
showRecording(store);
const replay = showReplay(store);
const views = showViews(arena);
const health = showHealth(store, { open: () => views.show("health"), isOpen: () => views.shown() === "health" });
views.onHealth(health.opened);
listenForKeys({
  show: (mode) => views.show(mode),
  step: timeline.step,
  live: () => store.lookBack(null),
  pause: () => store.info?.replays && replay.togglePause(),
  fit: () => arena.fit(),
  selectNext: (step) => store.selectNext(step),
  follow: () => store.follow(!store.following),
  deselect: () => store.select(null),
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

const connection = connect(streamAddress(), {
  onMessage: (message) => store.take(message),
  onState: (state) => {
    const before = store.connection.phase;
    store.setConnection(state);
    // With each connection: it may be another server, or another version of it.
    if (state.phase !== "live" || before === "live") return;
    void loadInfo();
  },
});
showMasthead(store, () => connection.retryNow());

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
    await showOffer(info);
  } catch {
    // The stream tells of the loss; the name comes with the next connection.
  }
}
