/** Queries the server's history and draws it over the arena, as trajectories or as a heat map. */

import { callApi } from "../../wire/api-client.js";
import { computeHeatMap, readTrajectories } from "../../state/trajectories.js";
import { find, setText } from "../../base/dom.js";
import { dateAndTime, duration, fixed, timeOfDay, whole } from "../../base/format.js";
import { FormErrors } from "../forms/form-errors.js";

/** Initial period, s. */
const FIRST_S = 600;
/** Vertical extent of the region "in view", down and up, metres. */
const DEEP_M = 1000;

/**
 * @param {import("../../state/store.js").Store} store
 * @param {import("../../arena/arena.js").Arena} arena
 */
export function showTrajectories(store, arena) {
  const view = new TrajectoriesPanel(store, arena);
  store.on("selection", () => view.onSelection());
  // Close the panel if the server no longer has a history.
  store.on("info", () => {
    if (!store.info?.keepsHistory) view.close();
  });
}

class TrajectoriesPanel {
  /** @param {import("../../state/store.js").Store} store @param {import("../../arena/arena.js").Arena} arena */
  constructor(store, arena) {
    this.store = store;
    this.arena = arena;
    this.panel = find("#history");
    this.opener = find("#history-open");
    this.form = /** @type {HTMLFormElement} */ (find("#history-form"));
    this.words = find("#history-words");
    this.errors = new FormErrors("history", ["objects", "from", "until"]);
    /** Number of the newest request. Answers of older ones are ignored. */
    this.asked = 0;
    /** True while the field of objects shows the selected object, until the user types in it. */
    this.followsSelection = true;

    this.opener.addEventListener("click", () => (this.panel.hidden ? this.open() : this.close()));
    find("#history-close").addEventListener("click", () => {
      this.close();
      this.opener.focus();
    });
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.show();
    });
    this.field("objects").addEventListener("input", () => (this.followsSelection = false));
    for (const button of this.panel.querySelectorAll("button[data-seconds]")) {
      button.addEventListener("click", () => {
        this.setSpan(Number(/** @type {HTMLElement} */ (button).dataset.seconds));
        void this.show();
      });
    }
    for (const name of ["courses", "heat"]) this.field(name).addEventListener("change", () => void this.show());
  }

  /** @param {string} name */
  field(name) {
    return /** @type {HTMLInputElement} */ (find(`#history-${name}`));
  }

  open() {
    this.panel.hidden = false;
    this.opener.setAttribute("aria-expanded", "true");
    this.followsSelection = true;
    if (this.field("until").value === "") this.setSpan(FIRST_S);
    this.onSelection();
    this.field("objects").focus();
    void this.show();
  }

  close() {
    this.asked += 1;
    this.panel.hidden = true;
    this.opener.setAttribute("aria-expanded", "false");
    this.arena.setOverlay(null);
    setText(this.words, "");
  }

  onSelection() {
    if (this.panel.hidden || !this.followsSelection) return;
    const { selected, selectedState } = this.store;
    const wanted = selected === null ? "" : selectedState?.name || String(selected);
    if (this.field("objects").value === wanted) return;
    this.field("objects").value = wanted;
    void this.show();
  }

  /** Selects the last seconds. @param {number} seconds */
  setSpan(seconds) {
    // The history uses the server's clock.
    const nowMs = this.store.snapshot?.poseTimeMs ?? Date.now();
    this.field("until").value = localInput(nowMs + 1000);
    this.field("from").value = localInput(nowMs - seconds * 1000);
  }

  async show() {
    this.errors.clear();
    const query = this.query();
    if (!query) return;
    this.asked += 1;
    const mine = this.asked;
    setText(this.words, "Loading…");
    const { answer, error } = await callApi("GET", `history?${query}`);
    if (mine !== this.asked) return;
    if (error) {
      setText(this.words, "");
      this.errors.showApiError(error);
      return;
    }
    const trajectories = readTrajectories(answer);
    const heat = this.field("heat").checked ? computeHeatMap(trajectories) : null;
    this.arena.setOverlay(trajectories.points > 0 ? { trajectories, heat } : null);
    setText(this.words, trajectories.points === 0 && query.has("objects") ? `No matching object in this period. ${keptText(trajectories)}` : wordsOf(trajectories, heat));
  }

  /** Query of the form; null if a time is missing. */
  query() {
    const query = new URLSearchParams();
    const objects = this.field("objects").value.trim();
    if (objects !== "") query.set("objects", objects.split(/\s*,\s*/).filter(Boolean).join(","));
    for (const name of ["from", "until"]) {
      const ms = new Date(this.field(name).value).getTime();
      if (Number.isNaN(ms)) {
        this.errors.showError(name, "Enter a date and time.");
        return null;
      }
      query.set(name, String(BigInt(Math.round(ms)) * 1_000_000n));
    }
    if (this.field("within").checked) {
      const { minX, minY, maxX, maxY } = this.arena.inView();
      query.set("min", [minX, minY, -DEEP_M].join(","));
      query.set("max", [maxX, maxY, DEEP_M].join(","));
    }
    return query;
  }
}

/** Period that the history covers. @param {import("../../state/trajectories.js").Trajectories} trajectories */
function keptText({ oldestMs, newestMs }) {
  return oldestMs && newestMs ? `Stored: ${dateAndTime(oldestMs)} to ${dateAndTime(newestMs)}.` : "Nothing is stored yet.";
}

/** Describes what is shown. @param {import("../../state/trajectories.js").Trajectories} all @param {import("../../state/trajectories.js").HeatMap | null} heat */
export function wordsOf(all, heat) {
  const { trajectories, points, stepS } = all;
  const kept = keptText(all);
  if (points === 0) return `No objects in this period. ${kept}`;
  const who = trajectories.length === 1 ? trajectories[0].label : `${trajectories.length} objects`;
  const times = trajectories.flatMap(({ timesMs, count }) => (count > 0 ? [timesMs[0], timesMs[count - 1]] : []));
  const span = `${timeOfDay(Math.min(...times))} to ${timeOfDay(Math.max(...times))}`;
  const shown = heat
    ? `Darkest: ${duration(heat.mostS * 1000)} in a square of ${fixed(heat.cellM, heat.cellM < 0.1 ? 2 : 1)} m.`
    : `${whole(points)} points, one every ${duration(stepS * 1000)}. Ring: start, disc: end.`;
  return `${who}, ${span}. ${shown} ${kept}`;
}

/** Formats a time for an `<input type="datetime-local">`. @param {number} unixMs */
export function localInput(unixMs) {
  const date = new Date(unixMs);
  return new Date(unixMs - date.getTimezoneOffset() * 60_000).toISOString().slice(0, 19);
}
