/** List of events, newest first. */

import { element, find, glyph } from "../../base/dom.js";
import { timeOfDay } from "../../base/format.js";

/** Symbol of each event kind. Unknown kinds have a dot. */
const SIGNS = new Map([
  ["object_appeared", "tracked"],
  ["object_predicted", "predicted"],
  ["object_recovered", "tracked"],
  ["object_lost", "lost"],
  ["camera_running", "running"],
  ["camera_failed", "failed"],
  ["camera_finished", "finished"],
  ["camera_clock_set", "predicted"],
  ["camera_placed", "running"],
  ["camera_unplaced", "predicted"],
  ["height_contradicted", "failed"],
  ["print_size_contradicted", "predicted"],
  ["calibration_begun", "starting"],
  ["calibration_done", "running"],
  ["calibration_failed", "failed"],
  ["calibration_applied", "running"],
  ["camera_bumped", "failed"],
  ["camera_returned", "running"],
  ["camera_drifted", "predicted"],
  ["cameras_contradict", "failed"],
  ["cameras_agree", "running"],
  ["cameras_misplaced", "failed"],
  ["camera_rate_off", "predicted"],
  ["camera_rate_agrees", "running"],
  ["camera_added", "starting"],
  ["camera_changed", "starting"],
  ["camera_removed", "finished"],
  ["object_added", "starting"],
  ["object_changed", "starting"],
  ["object_removed", "finished"],
  ["recording_begun", "starting"],
  ["recording_ended", "finished"],
  ["recording_failed", "failed"],
  ["recording_lossy", "failed"],
  ["history_failed", "failed"],
  ["history_restored", "running"],
  ["history_replaced", "failed"],
]);

/** @param {import("../../state/store.js").Store} store */
export function showEventList(store) {
  const list = find("#event-rows");
  const empty = find("#events-empty");
  /** @type {Map<string, HTMLElement>} by sequence number and time, unique across runs of the server */
  const rows = new Map();
  const key = (/** @type {import("../../wire/messages.js").Event} */ event) => `${event.sequence} ${event.timeMs}`;

  list.addEventListener("click", (event) => {
    const button = event.target instanceof Element ? event.target.closest("button") : null;
    const id = Number(button?.dataset.objectId);
    if (id && store.tracks.has(id)) store.select(id);
  });

  store.on("events", () => {
    const known = new Set(store.events.map(key));
    for (const [shown, row] of rows) {
      if (known.has(shown)) continue;
      row.remove();
      rows.delete(shown);
    }
    for (const [i, event] of store.events.entries()) {
      if (rows.has(key(event))) continue;
      const row = makeRow(event);
      rows.set(key(event), row);
      list.insertBefore(row, list.children[i] ?? null);
    }
    empty.hidden = rows.size > 0;
  });
}

/** @param {import("../../wire/messages.js").Event} event */
function makeRow(event) {
  const sign = SIGNS.get(event.kind) ?? "unspecified";
  const kind = event.kind === "unspecified" ? "" : event.kind.replaceAll("_", " ");
  const words = event.message || kind || "Unknown event";
  // A click on an object's event selects the object.
  const text = event.objectId
    ? element("button", { type: "button", "data-object-id": String(event.objectId) }, [words])
    : element("span", {}, [words]);
  return element("li", { class: `event sign-${sign}` }, [
    element("time", { datetime: new Date(event.timeMs).toISOString() }, [timeOfDay(event.timeMs)]),
    element("span", { class: "sign" }, [glyph(sign)]),
    text,
  ]);
}
