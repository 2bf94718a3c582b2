/** Words for the measured size of prints. */

import { fixed } from "../base/format.js";

/** @typedef {{roundel: string, factor: number, deviation: number, state: string, cameras: string[]}} PrintSize */

/** Differences below this do not matter. */
const SMALL = 0.001;
/** Factors by which printers and viewers scale a page to fit. */
const FIT_TO_PAGE = { least: 0.92, most: 0.985 };

/** @param {PrintSize} size @returns {string} */
export function printSizeText({ factor, deviation, state }) {
  const difference = `${fixed(Math.abs(factor - 1) * 100, 1)} % ${factor < 1 ? "smaller" : "larger"} than configured`;
  const precision = `± ${fixed(deviation * 100, 2)} %`;
  switch (state) {
    case "exact":
      return "As configured; not measured";
    case "assumed":
      return `Not measured yet (${precision}): two cameras must see the same roundels, or one camera references of this kind`;
    case "contradicted":
      return `${difference}: correct its diameters in the configuration, or the poses of the cameras`;
    default: {
      if (Math.abs(factor - 1) < Math.max(SMALL, 2 * deviation)) return `As configured (${precision})`;
      const isFitted = factor > FIT_TO_PAGE.least && factor < FIT_TO_PAGE.most;
      return `${difference} (${precision}); positions are corrected${isFitted ? ". Printed with “fit to page”?" : ""}`;
    }
  }
}
