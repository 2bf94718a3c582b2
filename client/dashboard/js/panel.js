/** The selected object with all its values. */

import { element, find, glyph, paced, setAttribute, setText } from "./dom.js";
import { degrees, duration, fixed, significant } from "./format.js";

const INTERVAL_MS = 150;

/** What the stages mean, for who does not know the words yet. */
const STAGE_WORDS = {
  tracked: "Tracked – observed now",
  predicted: "Predicted – not observed now, carried on by the motion model",
  tentative: "Tentative – seen too seldom yet to be trusted",
  lost: "Lost – given up; these are its last values",
  unspecified: "Of unknown stage",
};

/** @typedef {import("./state.js").ObjectState} ObjectState */

/** @type {{key: string, name: string, value: (state: ObjectState) => string}[]} */
const VALUES = [
  { key: "speed", name: "Speed", value: (state) => `${fixed(state.speedMS, 3)} m/s` },
  {
    key: "heading",
    name: "Heading",
    value: ({ headingRad, eitherWay, code }) =>
      headingRad !== null
        ? `${degrees(headingRad)}${eitherWay ? " or opposite" : ""}`
        : code
          ? "not observed"
          : "not observed (plain roundel)",
  },
  { key: "tilt", name: "Tilt", value: (state) => degrees(state.tiltRad) },
  {
    key: "ellipse",
    name: "95 % ellipse",
    value: ({ ellipse }) =>
      ellipse
        ? `± ${significant(ellipse.majorM * 1000)} × ${significant(ellipse.minorM * 1000)} mm`
        : "not given",
  },
  { key: "age", name: "Last observation", value: (state) => `${duration(state.ageMs)} before` },
  { key: "residual", name: "Residual", value: (state) => `${fixed(state.residual, 2)} (1 is as modelled)` },
  { key: "cameras", name: "Cameras", value: (state) => state.cameras.join(", ") || "none now" },
  { key: "roundel", name: "Roundel", value: (state) => state.roundel || "–" },
  {
    key: "code",
    name: "Code",
    value: ({ code }) => (code ? `${code.number} of ${code.bits} bits` : "none read"),
  },
];

/** @param {import("./store.js").Store} store */
export function showPanel(store) {
  const panel = find("#selection");
  const title = find("#selection-title");
  const follow = find("#follow");
  const body = makeBody(find("#selection-body"));
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
    setText(body.stage, gone ? STAGE_WORDS.lost : STAGE_WORDS[state.stage]);
    fillAxes(body, state);
    for (const [i, { value }] of VALUES.entries()) setText(body.values[i], value(state));
    setAttribute(follow, "aria-pressed", String(store.following));
  };

  follow.addEventListener("click", () => store.follow(!store.following));
  find("#deselect").addEventListener("click", () => store.select(null));
  store.on("selection", update);
  store.on("snapshot", paced(INTERVAL_MS, update));
  update();
}

/** @param {HTMLElement} target */
function makeBody(target) {
  const stage = element("p", { class: "stage-words" });
  const axes = ["x", "y", "z"].map((axis) => ({
    position: element("td", { "data-value": axis }),
    sigma: element("td", { "data-value": `sigma-${axis}` }),
    velocity: element("td", { "data-value": `velocity-${axis}` }),
  }));
  const row = (/** @type {string} */ name, /** @type {string} */ unit, /** @type {Node[]} */ cells) =>
    element("tr", {}, [element("th", { scope: "row" }, [name, " ", element("small", {}, [unit])]), ...cells]);
  const table = element("table", { class: "axes" }, [
    element("thead", {}, [
      element("tr", {}, [
        element("td"),
        ...["x", "y", "z"].map((axis) => element("th", { scope: "col" }, [axis])),
      ]),
    ]),
    element("tbody", {}, [
      row("Position", "m", axes.map((axis) => axis.position)),
      row("σ", "mm", axes.map((axis) => axis.sigma)),
      row("Velocity", "m/s", axes.map((axis) => axis.velocity)),
    ]),
  ]);
  const values = VALUES.map(({ key }) => element("dd", { "data-value": key }));
  const list = element(
    "dl",
    { class: "values" },
    VALUES.map(({ name }, i) => element("div", {}, [element("dt", {}, [name]), values[i]])),
  );
  target.append(stage, table, list);
  return { stage, axes, values };
}

/**
 * @param {ReturnType<typeof makeBody>} body
 * @param {ObjectState} state
 */
function fillAxes(body, state) {
  for (const [i, axis] of /** @type {const} */ (["x", "y", "z"]).entries()) {
    setText(body.axes[i].position, fixed(state.positionM?.[axis], 4));
    setText(body.axes[i].sigma, fixed(state.sigmaM && state.sigmaM[axis] * 1000, 2));
    setText(body.axes[i].velocity, fixed(state.velocityMS?.[axis], 3));
  }
}
