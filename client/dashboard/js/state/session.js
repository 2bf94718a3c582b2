/** Who uses the page, and what the role permits. The server's server/src/api/access/roles.rs has the same roles. */

import { text } from "../base/validate.js";

/** @typedef {"view" | "operate" | "setup"} Need role that a control needs */
/** @typedef {{needsCredentials: boolean, name: string, role: string}} Session `role` is empty without valid credentials */

/** What each role permits. `feed` is for programs that send frames. @type {Map<string, Need[]>} */
const PERMITTED = new Map([
  ["view", ["view"]],
  ["feed", []],
  ["operate", ["view", "operate"]],
  ["setup", ["view", "operate", "setup"]],
]);

/** @param {any} raw @returns {Session} */
export function readSession(raw) {
  return { needsCredentials: raw?.needs_credentials === true, name: text(raw?.name), role: text(raw?.role) };
}

/**
 * Whether a session permits what needs a role. The server checks it again.
 * @param {Session | null} session null: the server has no sessions, or has not answered yet
 * @param {Need} need
 */
export function permits(session, need) {
  return session === null || (PERMITTED.get(session.role) ?? []).includes(need);
}
