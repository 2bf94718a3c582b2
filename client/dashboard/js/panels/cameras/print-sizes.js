/** Measured size of each kind's prints. */

import { element, find } from "../../base/dom.js";
import { printSizeText } from "../../state/print-size.js";
import { callApi } from "../../wire/api-client.js";

/** Returns a function that loads the sizes and shows them. @returns {() => Promise<void>} */
export function makePrintSizes() {
  const section = find("#print-sizes");
  const rows = find("#print-size-rows");
  return async () => {
    const { answer } = await callApi("GET", "print-sizes");
    /** @type {import("../../state/print-size.js").PrintSize[]} */
    const sizes = answer?.print_sizes ?? [];
    section.hidden = sizes.length === 0;
    const row = (/** @type {import("../../state/print-size.js").PrintSize} */ size) =>
      element("tr", { "data-health": size.state === "contradicted" ? "grave" : "well" }, [
        element("th", { scope: "row" }, [size.roundel]),
        element("td", { class: "why" }, [printSizeText(size)]),
        element("td", { class: "why" }, [size.cameras.join(", ") || "–"]),
      ]);
    rows.replaceChildren(...sizes.map(row));
  };
}
