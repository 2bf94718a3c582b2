/**
 * All objects as a table: for reading, for the keyboard, and for whoever cannot see the arena.
 * Each row carries its object's id as `data-object-id`.
 */

import { element, find, glyph, paced, setAttribute, setText } from "./dom.js";
import { fixed } from "./format.js";

/** Faster than this, figures flicker instead of being read, ms. */
const INTERVAL_MS = 200;
/** Of rows that are scrolled out of sight so many are brought up to date each time, in turns. */
const UNSEEN_AT_ONCE = 12;
/** Rows beyond the edges that count as in sight. */
const MARGIN_ROWS = 2;

/** @typedef {import("./state.js").ObjectState} ObjectState */
/** @typedef {{row: HTMLElement, button: HTMLElement, sign: Element, label: Element, code: HTMLElement, cells: Element[], stage: string}} Row */

/**
 * @param {import("./store.js").Store} store
 * @returns {{narrow: (filter: ((state: ObjectState) => boolean) | null) => void}} to what fits
 */
export function showList(store) {
  const body = find("#object-rows");
  const empty = find("#objects-empty");
  /** @type {Map<number, Row>} */
  const rows = new Map();

  body.addEventListener("click", (event) => {
    const row = event.target instanceof Element ? event.target.closest("tr") : null;
    if (row) store.select(Number(row.dataset.objectId));
  });

  const scroller = /** @type {HTMLElement} */ (body.closest(".scroll"));
  let turn = 0;
  /** @type {((state: ObjectState) => boolean) | null} */
  let filter = null;
  /** Whether a row is up for new figures: four hundred at once would hold the page up. @type {(i: number) => boolean} */
  let isDue = () => true;
  const lookWhatIsSeen = (/** @type {number} */ count) => {
    const height = /** @type {HTMLElement | null} */ (body.firstElementChild)?.offsetHeight || 27;
    const first = Math.floor(scroller.scrollTop / height) - MARGIN_ROWS;
    const last = first + Math.ceil(scroller.clientHeight / height) + 2 * MARGIN_ROWS;
    const from = turn % Math.max(1, count);
    turn = from + UNSEEN_AT_ONCE;
    isDue = (i) => (i >= first && i <= last) || (i >= from && i < from + UNSEEN_AT_ONCE);
  };

  const update = () => {
    const tracks = store.sortedTracks().filter(({ state }) => !filter || filter(state));
    const ids = new Set(tracks.map(({ state }) => state.id));
    lookWhatIsSeen(tracks.length);
    for (const [id, { row }] of rows) {
      if (ids.has(id)) continue;
      row.remove();
      rows.delete(id);
    }
    for (const [i, { state }] of tracks.entries()) {
      let row = rows.get(state.id);
      const isNew = !row;
      if (!row) {
        row = makeRow(state);
        rows.set(state.id, row);
        body.insertBefore(row.row, body.children[i] ?? null);
      }
      if (isNew || isDue(i) || row.stage !== state.stage) fillRow(row, state, store.selected);
    }
    setText(empty, filter ? "No object fits." : "No object is in view.");
    empty.hidden = tracks.length > 0;
  };

  // What comes into sight is up to date as soon as it does.
  scroller.addEventListener("scroll", paced(50, update), { passive: true });

  const markSelected = () => {
    for (const [id, { row, button }] of rows) {
      const chosen = id === store.selected;
      row.classList.toggle("selected", chosen);
      setAttribute(button, "aria-pressed", String(chosen));
      if (chosen) row.scrollIntoView({ block: "nearest" });
    }
  };

  store.on("snapshot", paced(INTERVAL_MS, update));
  store.on("time", update);
  store.on("selection", () => {
    update();
    markSelected();
  });
  update();
  return {
    narrow: (wanted) => {
      filter = wanted;
      update();
    },
  };
}

/**
 * @param {ObjectState} state
 * @returns {Row}
 */
function makeRow(state) {
  const sign = element("span", { class: "sign" });
  const label = element("span", { class: "label" });
  const code = element("small", { class: "code", hidden: "" });
  const button = element("button", { type: "button", "aria-pressed": "false" }, [sign, label, " ", code]);
  const cells = Array.from({ length: 5 }, () => element("td"));
  const row = element("tr", { "data-object-id": String(state.id) }, [
    element("th", { scope: "row" }, [button]),
    ...cells,
  ]);
  return { row, button, sign, label, code, cells, stage: "" };
}

/**
 * @param {Row} row
 * @param {ObjectState} state
 * @param {number | null} selected
 */
function fillRow(row, state, selected) {
  if (row.stage !== state.stage) {
    row.stage = state.stage;
    row.row.dataset.stage = state.stage;
    row.sign.className = `sign stage-${state.stage}`;
    row.sign.replaceChildren(glyph(state.stage));
    row.button.title = state.stage;
  }
  const code = state.code ? `#${state.code.number}` : "";
  // What is said begins with what is seen, so that either can be used to name the button.
  setAttribute(row.button, "aria-label", `Object ${[state.label, code].join(" ").trim()}, ${state.stage}`);
  row.code.hidden = code === "";
  setText(row.code, code);
  row.row.classList.toggle("selected", state.id === selected);
  setText(row.label, state.label);
  const { positionM, sigmaM } = state;
  const values = [
    fixed(positionM?.x, 3),
    fixed(positionM?.y, 3),
    fixed(positionM?.z, 3),
    fixed(state.speedMS, 2),
    fixed(sigmaM && Math.max(sigmaM.x, sigmaM.y, sigmaM.z) * 1000, 1),
  ];
  for (const [i, value] of values.entries()) setText(row.cells[i], value);
}
