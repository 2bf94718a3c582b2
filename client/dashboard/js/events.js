/** What has happened, newest first. */

import { element, find, glyph } from "./dom.js";
import { timeOfDay } from "./format.js";

/** The sign of each kind of event; a kind that this page does not know has a plain dot. */
const SIGNS = new Map([
  ["object_appeared", "tracked"],
  ["object_predicted", "predicted"],
  ["object_recovered", "tracked"],
  ["object_lost", "lost"],
  ["camera_running", "running"],
  ["camera_failed", "failed"],
  ["camera_finished", "finished"],
]);

/** @param {import("./store.js").Store} store */
export function showEvents(store) {
  const list = find("#event-rows");
  const empty = find("#events-empty");
  /** @type {Map<number, HTMLElement>} by sequence */
  const rows = new Map();

  list.addEventListener("click", (event) => {
    const button = event.target instanceof Element ? event.target.closest("button") : null;
    const id = Number(button?.dataset.objectId);
    if (id && store.tracks.has(id)) store.select(id);
  });

  store.on("events", () => {
    const known = new Set(store.events.map((event) => event.sequence));
    for (const [sequence, row] of rows) {
      if (known.has(sequence)) continue;
      row.remove();
      rows.delete(sequence);
    }
    for (const [i, event] of store.events.entries()) {
      if (rows.has(event.sequence)) continue;
      const row = makeRow(event);
      rows.set(event.sequence, row);
      list.insertBefore(row, list.children[i] ?? null);
    }
    empty.hidden = rows.size > 0;
  });
}

/** @param {import("./message.js").Event} event */
function makeRow(event) {
  const sign = SIGNS.get(event.kind) ?? "unspecified";
  const words = event.message || event.kind.replaceAll("_", " ") || "Event";
  // An object's event leads to the object.
  const text = event.objectId
    ? element("button", { type: "button", "data-object-id": String(event.objectId) }, [words])
    : element("span", {}, [words]);
  return element("li", { class: `event sign-${sign}` }, [
    element("time", { datetime: new Date(event.timeMs).toISOString() }, [timeOfDay(event.timeMs)]),
    element("span", { class: "sign" }, [glyph(sign)]),
    text,
  ]);
}
