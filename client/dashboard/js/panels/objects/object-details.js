/** Panel with all values of the selected object. */

import { element, find, glyph, throttle, setAttribute, setText } from "../../base/dom.js";
import { degrees, duration, fixed, significant } from "../../base/format.js";
import { showPlots } from "./object-plots.js";

const INTERVAL_MS = 250;
const PLOT_INTERVAL_MS = 500;
/** Age of the earlier position that is shown, ms. */
const AGO_MS = 10_000;
const AXES = /** @type {const} */ (["x", "y", "z"]);
const GONE_WORDS = "Not in view at that time; values are from another time";

/** Explanations of the life stages. */
const STAGE_WORDS = {
  tracked: "Tracked – observed now",
  predicted: "Predicted – not observed now; moved by the motion model",
  tentative: "Tentative – not confirmed yet",
  lost: "Lost – last known values",
  unspecified: "Unknown stage",
};

/** @typedef {import("../../state/object-state.js").ObjectState} ObjectState */

/** @type {{key: string, name: string, value: (state: ObjectState) => string}[]} */
const VALUES = [
  { key: "speed", name: "Speed", value: (state) => `${fixed(state.speedMS, 3)} m/s` },
  {
    key: "heading",
    name: "Heading",
    value: ({ headingRad, isHeadingAmbiguous, code }) =>
      headingRad !== null
        ? `${degrees(headingRad)}${isHeadingAmbiguous ? " or opposite" : ""}`
        : code
          ? "not observed"
          : "not observed (plain roundel)",
  },
  { key: "tilt", name: "Tilt", value: (state) => degrees(state.tiltRad) },
  {
    key: "turned",
    name: "Rotation σ",
    value: ({ sigmaRad, yawObserved }) => {
      if (!sigmaRad) return "not available";
      const parts = [sigmaRad.x, sigmaRad.y, yawObserved ? sigmaRad.z : null];
      return parts.map((one) => (one === null ? "yaw not observed" : `${significant((one * 180) / Math.PI)}°`)).join("  ");
    },
  },
  {
    key: "ellipse",
    name: "95 % ellipse",
    value: ({ ellipse }) =>
      ellipse
        ? `± ${significant(ellipse.majorM * 1000)} × ${significant(ellipse.minorM * 1000)} mm`
        : "not available",
  },
  { key: "age", name: "Last observation", value: (state) => `${duration(state.ageMs)} earlier` },
  { key: "residual", name: "Residual", value: (state) => `${fixed(state.residual, 2)} (1 is as modelled)` },
  {
    key: "cameras",
    name: "Cameras",
    value: ({ cameras, isUntrusted }) => `${cameras.join(", ") || "none now"}${isUntrusted ? " (not trusted: remote programs only)" : ""}`,
  },
  {
    key: "code",
    name: "Roundel",
    value: ({ code, roundel }) => `${roundel || "–"}, ${code ? `code ${code.number} of ${code.bits} bits` : "no code read"}`,
  },
];

/** Accuracy, number of cameras and age. @param {ObjectState} state */
function precisionText(state) {
  const { error95M, headingError95Rad, cameras, ageMs } = state;
  const known = error95M === null ? "Accuracy not available" : `Accuracy ${significant(error95M * 1000)} mm`;
  const heading = headingError95Rad === null ? "" : ` and ${significant((headingError95Rad * 180) / Math.PI)}°`;
  const by = cameras.length === 0 ? "seen by no camera now" : `seen by ${cameras.length === 1 ? "one camera" : `${cameras.length} cameras`}`;
  const trust = state.isUntrusted ? ", by remote programs only" : "";
  return `${known}${heading}${error95M === null ? "" : " (95 %)"}, ${by}${trust}, ${duration(ageMs && Math.max(0, ageMs))} ago`;
}

/** @param {import("../../state/store.js").Store} store */
export function showObjectDetails(store) {
  const panel = find("#selection");
  const title = find("#selection-title");
  const follow = find("#follow");
  const body = makeBody(find("#selection-body"), find("#selection-values"));
  const updatePlots = showPlots(store, find("#selection-plots"));
  let signDrawn = "";

  const update = () => {
    const state = store.selectedState;
    panel.hidden = state === null;
    if (!state) return;
    const gone = !store.tracks.has(state.id);
    const stage = gone ? "lost" : state.stage;
    const sign = `${state.id} ${stage} ${state.label}`;
    if (sign !== signDrawn) {
      signDrawn = sign;
      title.className = `stage-${stage}`;
      const words = element("span", {}, [state.name || `Object ${state.id}`]);
      title.replaceChildren(glyph(stage), words);
      if (state.name) title.append(element("small", {}, [`object ${state.id}`]));
    }
    panel.classList.toggle("gone", gone);
    const past = store.pastMs !== null;
    setText(body.stage, !gone ? STAGE_WORDS[state.stage] : past ? GONE_WORDS : STAGE_WORDS.lost);
    setText(body.precision, precisionText(state));
    fillAxes(body, state);
    const before = store.history.one(state.id, store.shownMs - AGO_MS)?.positionM;
    setText(body.ago, past ? "10 s before" : "10 s ago");
    for (const [i, axis] of AXES.entries()) setText(body.axes[i].before, fixed(before?.[axis], 3));
    for (const [i, { value }] of VALUES.entries()) setText(body.values[i], value(state));
    setAttribute(follow, "aria-pressed", String(store.following));
  };

  follow.addEventListener("click", () => store.follow(!store.following));
  find("#deselect").addEventListener("click", () => store.select(null));
  store.on("selection", update);
  store.on("snapshot", throttle(INTERVAL_MS, () => store.pastMs === null && update()));
  store.on("time", update);
  store.on("selection", updatePlots);
  store.on("snapshot", throttle(PLOT_INTERVAL_MS, updatePlots));
  update();
}

/** @param {HTMLElement} target @param {HTMLElement} rest receives less important values */
function makeBody(target, rest) {
  const stage = element("p", { class: "stage-words" });
  const precision = element("p", { class: "precision", "data-value": "precision" });
  const axes = AXES.map((axis) => ({
    position: element("td", { "data-value": axis }),
    sigma: element("td", { "data-value": `sigma-${axis}` }),
    velocity: element("td", { "data-value": `velocity-${axis}` }),
    before: element("td", { "data-value": `before-${axis}` }),
  }));
  const ago = element("span");
  const row = (/** @type {string | Node} */ name, /** @type {string} */ unit, /** @type {Node[]} */ cells) =>
    element("tr", {}, [element("th", { scope: "row" }, [name, " ", element("small", {}, [unit])]), ...cells]);
  const table = element("table", { class: "axes" }, [
    element("thead", {}, [
      element("tr", {}, [
        element("td"),
        ...AXES.map((axis) => element("th", { scope: "col" }, [axis])),
      ]),
    ]),
    element("tbody", {}, [
      row("Position", "m", axes.map((axis) => axis.position)),
      row("σ", "mm", axes.map((axis) => axis.sigma)),
      row("Velocity", "m/s", axes.map((axis) => axis.velocity)),
      row(ago, "m", axes.map((axis) => axis.before)),
    ]),
  ]);
  const values = VALUES.map(({ key }) => element("dd", { "data-value": key }));
  const list = element(
    "dl",
    { class: "values" },
    VALUES.map(({ name }, i) => element("div", {}, [element("dt", {}, [name]), values[i]])),
  );
  target.append(stage, precision, table);
  rest.append(list);
  return { stage, precision, axes, values, ago };
}

/**
 * @param {ReturnType<typeof makeBody>} body
 * @param {ObjectState} state
 */
function fillAxes(body, state) {
  for (const [i, axis] of AXES.entries()) {
    setText(body.axes[i].position, fixed(state.positionM?.[axis], 4));
    setText(body.axes[i].sigma, fixed(state.sigmaM && state.sigmaM[axis] * 1000, 2));
    setText(body.axes[i].velocity, fixed(state.velocityMS?.[axis], 3));
  }
}
