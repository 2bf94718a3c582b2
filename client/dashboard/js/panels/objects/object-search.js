/** Search for an object by number, name or code. */

import { find, setText } from "../../base/dom.js";

/** @typedef {import("../../state/object-state.js").ObjectState} ObjectState */

/**
 * Returns how well an object matches what was typed: 0 not at all, 3 exactly.
 * @param {ObjectState} state
 * @param {string} typed
 */
export function matchScore(state, typed) {
  const wanted = typed.trim().toLowerCase();
  if (wanted === "") return 1;
  const id = String(state.id);
  const code = state.code ? `#${state.code.number}` : "";
  const name = state.name.toLowerCase();
  if ([id, name, code].includes(wanted)) return 3;
  if (name.startsWith(wanted) || id.startsWith(wanted) || (wanted.length > 1 && code.startsWith(wanted))) return 2;
  // "robot 7" and "object 7" find number 7.
  const number = /^(?:robot|object)\s*#?(\d+)$/.exec(wanted)?.[1];
  if (number !== undefined) return number === id ? 3 : 0;
  return name.includes(wanted) ? 1 : 0;
}

/**
 * @param {import("../../state/store.js").Store} store
 * @param {(filter: ((state: ObjectState) => boolean) | null) => void} setFilter filters the list
 * @returns {() => boolean} clears the field; returns whether it had text
 */
export function showObjectSearch(store, setFilter) {
  const input = /** @type {HTMLInputElement} */ (find("#search"));
  const note = find("#search-note");
  const found = () =>
    store
      .sortedTracks()
      .map(({ state }) => ({ state, fit: matchScore(state, input.value) }))
      .filter(({ fit }) => fit > 0)
      .sort((a, b) => b.fit - a.fit);

  const clear = () => {
    const wasEmpty = input.value === "";
    input.value = "";
    input.dispatchEvent(new Event("input"));
    return !wasEmpty;
  };

  input.addEventListener("input", () => {
    const typed = input.value;
    setFilter(typed.trim() === "" ? null : (state) => matchScore(state, typed) > 0);
    const count = typed.trim() === "" ? null : found().length;
    setText(note, count === null ? "" : count === 0 ? "No matches" : count === 1 ? "1 match" : `${count} matches`);
  });
  input.addEventListener("keydown", (event) => {
    if (event.key === "Escape") {
      clear();
      input.blur();
    }
    if (event.key !== "Enter") return;
    const [best] = found();
    if (!best) return;
    store.select(best.state.id);
    // Further keys apply to the object, not to the search.
    find("#arena-stage").focus({ preventScroll: true });
  });
  return clear;
}
