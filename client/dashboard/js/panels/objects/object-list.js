/**
 * Table of all objects, also for keyboard use and screen readers.
 * Each row carries its object's id as `data-object-id`.
 */

import { element, find, glyph, throttle, setAttribute, setText } from "../../base/dom.js";
import { fixed } from "../../base/format.js";

/** Update interval at which figures stay readable, ms. */
const INTERVAL_MS = 250;
/** Update interval for many objects, ms. */
const MANY_INTERVAL_MS = 400;
/** Above this number of objects only rows in view exist, since a long table is slow to lay out. */
const MANY = 150;
/** Additional rows beyond each edge of the view. */
const MARGIN_ROWS = 3;
/** Longest name that always fits. */
const SHORT = 8;
/** Rows outside the view that are updated each time. */
const UNSEEN_AT_ONCE = 12;

/** @typedef {import("../../state/object-state.js").ObjectState} ObjectState */
/** @typedef {{row: HTMLElement, button: HTMLElement, sign: Element, label: Element, code: HTMLElement, cells: Element[], stage: string}} Row */

/**
 * @param {import("../../state/store.js").Store} store
 * @returns {{setFilter: (filter: ((state: ObjectState) => boolean) | null) => void}}
 */
export function showObjectList(store) {
  const body = find("#object-rows");
  const empty = find("#objects-empty");
  /** @type {Map<number, Row>} */
  const rows = new Map();

  body.addEventListener("click", (event) => {
    const row = event.target instanceof Element ? event.target.closest("tr") : null;
    if (row?.dataset.objectId) store.select(Number(row.dataset.objectId));
  });

  const scroller = /** @type {HTMLElement} */ (body.closest(".scroll"));
  const gaps = [makeGap(), makeGap()];
  body.before(gaps[0]);
  body.after(gaps[1]);
  let turn = 0;
  /** @type {((state: ObjectState) => boolean) | null} */
  let filter = null;
  /** @type {import("../../state/track.js").Track[]} all that pass the filter, also those without a row */
  let listed = [];

  const rowHeight = () => rows.values().next().value?.row.offsetHeight || 27;

  /** Half-open range of the rows in view, with margins. @param {number} count @returns {[number, number]} */
  const inSight = (count) => {
    const height = rowHeight();
    const first = Math.max(0, Math.min(count, Math.floor(scroller.scrollTop / height)) - MARGIN_ROWS);
    return [first, Math.min(count, first + Math.ceil(scroller.clientHeight / height) + 2 * MARGIN_ROWS)];
  };

  const update = () => {
    const all = store.sortedTracks().filter((track) => !filter || filter(track.state));
    const [first, last] = inSight(all.length);
    const [from, to] = all.length > MANY ? [first, last] : [0, all.length];
    listed = all;
    const there = all.slice(from, to);
    keepRows(new Set(there.map(({ id }) => id)));
    turn %= Math.max(1, all.length);
    for (const [k, track] of there.entries()) {
      const i = from + k;
      let row = rows.get(track.id);
      const isNew = !row;
      if (!row) {
        row = makeRow(track.id);
        rows.set(track.id, row);
      }
      if (body.children[k] !== row.row) body.insertBefore(row.row, body.children[k] ?? null);
      // Rows outside the view are updated in turn, since hundreds at once would block the page.
      const isDue = (i >= first && i < last) || (i >= turn && i < turn + UNSEEN_AT_ONCE);
      if (isNew || isDue || row.stage !== track.stage) fillRow(row, track.state, store.selected);
    }
    turn += UNSEEN_AT_ONCE;
    fillGaps(from, all.length - to);
    setText(empty, filter ? "No matching objects." : "No objects in view.");
    empty.hidden = all.length > 0;
  };

  /** @param {Set<number>} ids */
  const keepRows = (ids) => {
    for (const [id, { row }] of rows) {
      if (ids.has(id)) continue;
      row.remove();
      rows.delete(id);
    }
  };

  /** Sets the height of the gaps that stand for missing rows. @param {number} before @param {number} after */
  const fillGaps = (before, after) => {
    const height = rowHeight();
    for (const [i, count] of [before, after].entries()) {
      gaps[i].hidden = count === 0;
      /** @type {HTMLElement} */ (gaps[i].querySelector("td")).style.height = `${count * height}px`;
    }
  };

  // Rows that scroll into view are updated at once.
  scroller.addEventListener("scroll", throttle(50, update), { passive: true });

  const markSelected = () => {
    const at = listed.findIndex(({ id }) => id === store.selected);
    if (at >= 0 && store.selected !== null && !rows.has(store.selected)) {
      scroller.scrollTop = at * rowHeight() - scroller.clientHeight / 2;
      update();
    }
    for (const [id, { row, button }] of rows) {
      const chosen = id === store.selected;
      row.classList.toggle("selected", chosen);
      setAttribute(button, "aria-pressed", String(chosen));
      if (chosen) row.scrollIntoView({ block: "nearest" });
    }
  };

  store.on("snapshot", throttle(() => (store.tracks.size > MANY ? MANY_INTERVAL_MS : INTERVAL_MS), update, { alone: true }));
  store.on("time", update);
  store.on("selection", () => {
    update();
    markSelected();
  });
  update();
  return {
    setFilter: (wanted) => {
      filter = wanted;
      update();
    },
  };
}

/** Placeholder for rows that do not exist. */
function makeGap() {
  return element("tbody", { "aria-hidden": "true", hidden: "" }, [element("tr", {}, [element("td", { colspan: "6" })])]);
}

/**
 * @param {number} id
 * @returns {Row}
 */
function makeRow(id) {
  const sign = element("span", { class: "sign" });
  const label = element("span", { class: "label" });
  const code = element("small", { class: "code", hidden: "" });
  const button = element("button", { type: "button", "aria-pressed": "false" }, [sign, label, " ", code]);
  const cells = Array.from({ length: 5 }, () => element("td"));
  const row = element("tr", { "data-object-id": String(id) }, [
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
  // The accessible name contains the visible text, as voice control requires.
  setAttribute(row.button, "aria-label", `Object ${[state.label, code].join(" ").trim()}, ${state.stage}`);
  row.code.hidden = code === "";
  setText(row.code, code);
  row.row.classList.toggle("selected", state.id === selected);
  setText(row.label, state.label);
  row.label.classList.toggle("long", state.label.length > SHORT);
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
