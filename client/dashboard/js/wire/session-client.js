/** Calls /api/v1/session. These requests need no credentials, so that they are sent while others wait (api-client.js). */

import { readSession } from "../state/session.js";
import { answered, requestOptions } from "./api-client.js";

/** Time after which the server counts as unreachable, ms. */
const TIMEOUT_MS = 3000;
const URL_PATH = "api/v1/session";

/** @typedef {import("../state/session.js").Session} Session */

/** @returns {Promise<{session: Session | null, error: import("./api-client.js").ApiError | null}>} */
export async function fetchSession() {
  return sessionOf(await answered(() => fetch(URL_PATH, { cache: "no-store", signal: AbortSignal.timeout(TIMEOUT_MS) })));
}

/** @param {{name: string, password: string} | {token: string}} credentials */
export async function signIn(credentials) {
  return sessionOf(await answered(() => fetch(URL_PATH, requestOptions("POST", credentials))));
}

export async function signOut() {
  return sessionOf(await answered(() => fetch(URL_PATH, requestOptions("DELETE"))));
}

/** @param {import("./api-client.js").Reply} reply */
function sessionOf({ answer, error }) {
  return { session: answer && readSession(answer), error };
}
