/** Roles of the page's users. */

import assert from "node:assert/strict";
import { test } from "node:test";

import { permits, readSession } from "../../../client/dashboard/js/state/session.js";

const permitted = (role) => {
  const session = readSession({ needs_credentials: true, name: "alice", role });
  return ["view", "operate", "setup"].filter((need) => permits(session, need));
};

test("each role permits what it does on the server", () => {
  assert.deepEqual(permitted("view"), ["view"]);
  assert.deepEqual(permitted("feed"), []);
  assert.deepEqual(permitted("operate"), ["view", "operate"]);
  assert.deepEqual(permitted("setup"), ["view", "operate", "setup"]);
});

test("without credentials, or with the role of a newer server, nothing is permitted", () => {
  assert.deepEqual(permitted(null), []);
  assert.deepEqual(permitted("toString"), []);
});

test("a server without sessions permits everything", () => {
  assert.ok(permits(null, "setup"));
});

test("a session is read from the response, also from an incomplete one", () => {
  assert.deepEqual(readSession({ needs_credentials: false, name: "anonymous", role: "operate" }), { needsCredentials: false, name: "anonymous", role: "operate" });
  assert.deepEqual(readSession({ needs_credentials: true, name: null, role: null }), { needsCredentials: true, name: "", role: "" });
  assert.deepEqual(readSession({}), { needsCredentials: false, name: "", role: "" });
});
