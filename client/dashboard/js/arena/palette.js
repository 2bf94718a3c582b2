/** The stylesheet's colours for the canvas, so that both themes are defined in one place. */

/**
 * @typedef {object} Palette
 * @property {string} sheet
 * @property {string} ink
 * @property {string} inkSoft
 * @property {string} gridMinor
 * @property {string} gridMajor
 * @property {string} view
 * @property {string} viewFill
 * @property {string} failed
 * @property {string} axisX
 * @property {string} axisY
 * @property {string} accent
 * @property {string} heat of cells that were occupied for long
 * @property {boolean} isDark
 * @property {Record<import("../state/object-state.js").Stage, string>} stage
 * @property {string} font
 */

/** @returns {Palette} */
export function readPalette() {
  const style = getComputedStyle(document.documentElement);
  const color = (/** @type {string} */ name) => style.getPropertyValue(`--${name}`).trim();
  return {
    sheet: color("sheet"),
    ink: color("ink"),
    inkSoft: color("ink-soft"),
    gridMinor: color("grid-minor"),
    gridMajor: color("grid-major"),
    view: color("view"),
    viewFill: color("view-fill"),
    failed: color("bad"),
    axisX: color("axis-x"),
    axisY: color("axis-y"),
    accent: color("accent"),
    heat: color("heat"),
    isDark: document.documentElement.dataset.theme === "dark",
    stage: {
      tracked: color("tracked"),
      predicted: color("predicted"),
      tentative: color("tentative"),
      lost: color("lost"),
      unspecified: color("ink-soft"),
    },
    font: getComputedStyle(document.body).fontFamily,
  };
}
