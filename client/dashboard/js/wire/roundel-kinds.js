/** The kinds of roundel that the configuration has. */

import { callApi } from "./api-client.js";

/** @typedef {{name: string, outer_mm: number, inner_mm: number, inner_minor_mm: number | null, code_bits: number | null, code_min_distance: number | null, polarity: string}} Kind */

/**
 * In the configuration's order; none where this page has no right to see it.
 * @param {import("../state/store.js").Store} store
 * @returns {Promise<Kind[]>}
 */
export async function fetchRoundelKinds(store) {
  const { answer } = store.info?.allowsSetup ? await callApi("GET", "configuration") : { answer: null };
  return answer?.roundels ?? [];
}
