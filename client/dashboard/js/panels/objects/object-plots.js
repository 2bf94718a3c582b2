/** Small plots of the selected object's last minute. A click shows that instant. */

import uPlot from "../../../vendor/uplot.js";
import { element, inOwnFrame, setAttribute, setText } from "../../base/dom.js";
import { significant } from "../../base/format.js";
import { HISTORY_MS } from "../../state/history.js";

const HEIGHT_PX = 54;
/** @typedef {import("../../state/object-state.js").ObjectState} ObjectState */
/** @type {{key: string, name: string, unit: string, least: number, value: (state: ObjectState) => number | null}[]} */
const PLOTS = [
  { key: "reach", name: "Accuracy", unit: "mm", least: 0.2, value: (state) => state.error95M && state.error95M * 1000 },
  { key: "speed", name: "Speed", unit: "m/s", least: 0.1, value: (state) => state.speedMS },
  { key: "height", name: "Height", unit: "m", least: 0.02, value: (state) => state.positionM?.z ?? null },
  { key: "age", name: "Last seen", unit: "ms ago", least: 20, value: (state) => state.ageMs && Math.max(0, state.ageMs) },
];

/**
 * @param {import("../../state/store.js").Store} store
 * @param {HTMLElement} target
 * @returns {() => void} updates the plots
 */
export function showPlots(store, target) {
  const series = new Series(store);
  const plots = PLOTS.map((plot, i) => {
    const range = element("small");
    const box = element("div", { class: "plot", "data-plot": plot.key });
    const picture = element("div", { role: "img" });
    box.append(element("p", {}, [plot.name, " ", range]), picture);
    target.append(box);
    const chart = new uPlot(options(plot.least), [[], []], picture);
    picture.addEventListener("click", () => {
      const at = chart.cursor.left === undefined || chart.cursor.left < 0 ? null : chart.posToVal(chart.cursor.left, "x");
      if (at !== null && store.snapshot) store.seekTo(at * 1000);
    });
    new ResizeObserver(() => picture.clientWidth > 0 && chart.setSize({ width: picture.clientWidth, height: HEIGHT_PX })).observe(picture);
    const { name, unit } = plot;
    const draw = () => {
      const [values, end] = [series.values[i], (store.history.newestMs ?? 0) / 1000];
      chart.batch(() => {
        chart.setData([series.times, values], false);
        chart.setScale("x", { min: end - HISTORY_MS / 1000, max: end });
      });
      const known = values.filter((one) => one !== null);
      const words = known.length > 0 ? `${significant(Math.min(...known))} to ${significant(Math.max(...known))} ${unit}` : "–";
      setText(range, words);
      setAttribute(picture, "aria-label", `${name}, the last minute: ${words}`);
    };
    return { chart, draw };
  });
  const recolor = () => plots.forEach(({ chart }) => chart.redraw());
  document.addEventListener("themechange", recolor);

  return () => {
    if (store.selected === null || !store.snapshot) return;
    series.renew(store.selected);
    for (const { draw } of plots) inOwnFrame(draw);
  };
}

/** Values of the plots, updated incrementally. */
class Series {
  /** @param {import("../../state/store.js").Store} store */
  constructor(store) {
    this.store = store;
    /** @type {number | null} */
    this.id = null;
    /** Pose time of the newest state taken. */
    this.lastMs = -Infinity;
    /** Pose times, seconds. @type {number[]} */
    this.times = [];
    /** By plot. @type {(number | null)[][]} */
    this.values = PLOTS.map(() => []);
  }

  /** @param {number} id */
  renew(id) {
    const { history } = this.store;
    // Another object, or an earlier time of a replay.
    if (id !== this.id || (history.newestMs ?? -Infinity) < this.lastMs) {
      this.id = id;
      this.lastMs = -Infinity;
      this.times = [];
      this.values = PLOTS.map(() => []);
    }
    for (const { timeMs, state } of history.of(id, this.lastMs)) {
      this.lastMs = timeMs;
      this.times.push(timeMs / 1000);
      for (const [i, { value }] of PLOTS.entries()) this.values[i].push(value(state));
    }
    const gone = this.times.findIndex((time) => time * 1000 >= (history.oldestMs ?? 0));
    if (gone <= 0) return;
    this.times.splice(0, gone);
    for (const values of this.values) values.splice(0, gone);
  }
}

/** @param {number} least */
function options(least) {
  const color = (/** @type {string} */ name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
  return {
    width: 120,
    height: HEIGHT_PX,
    padding: [3, 0, 3, 0],
    legend: { show: false },
    axes: [{ show: false }, { show: false }],
    cursor: { y: false, drag: { setScale: false, x: false, y: false }, points: { show: false } },
    scales: {
      x: { time: false, auto: false },
      y: {
        range: (/** @type {unknown} */ _, /** @type {number} */ low, /** @type {number} */ high) => {
          if (!Number.isFinite(low) || !Number.isFinite(high)) return [0, 1];
          const spare = Math.max(0, least - (high - low)) / 2 + (high - low) * 0.05;
          return [low - spare, high + spare];
        },
      },
    },
    series: [{}, { stroke: () => color("--accent"), width: 1.25, points: { show: false }, spanGaps: false }],
  };
}
