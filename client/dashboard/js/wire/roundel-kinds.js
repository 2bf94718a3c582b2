/** Roundel kinds of the configuration. */

import { permits } from "../state/session.js";
import { callApi } from "./api-client.js";

/** @typedef {{name: string, outer_mm: number, inner_mm: number, inner_minor_mm: number | null, code_bits: number | null, code_min_distance: number | null, polarity: string}} Kind */

/**
 * In the order of the configuration; empty if this page may not read it.
 * @param {import("../state/store.js").Store} store
 * @returns {Promise<Kind[]>}
 */
export async function fetchRoundelKinds(store) {
  const isAllowed = store.info?.allowsSetup && permits(store.session, "setup");
  const { answer } = isAllowed ? await callApi("GET", "configuration") : { answer: null };
  return answer?.roundels ?? [];
}
