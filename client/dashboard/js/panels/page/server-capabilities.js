/**
 * Hides the controls of features that the server does not offer, by its OpenAPI description and its info, and those that
 * the user's role does not permit.
 */

import { find } from "../../base/dom.js";
import { permits } from "../../state/session.js";

/** @typedef {"records" | "replays" | "keepsHistory" | "allowsSetup"} Capability */

/** @typedef {{method: string, path: string, capability?: Capability, role?: import("../../state/session.js").Need}} Need */

/** Controls that need an API call, a capability of the server, and a role other than `view`. @type {(Need & {control: string})[]} */
const NEEDS = [
  { control: "#add-camera", method: "post", path: "/api/v1/cameras", capability: "allowsSetup", role: "setup" },
  { control: "#calibrate", method: "post", path: "/api/v1/calibration", role: "operate" },
  { control: "#setup-try", method: "post", path: "/api/v1/sources/test", capability: "allowsSetup", role: "setup" },
  { control: "#setup-lens", method: "post", path: "/api/v1/lens", capability: "allowsSetup", role: "setup" },
  { control: "#add-object", method: "post", path: "/api/v1/configuration/objects", capability: "allowsSetup", role: "setup" },
  { control: "#name-object", method: "put", path: "/api/v1/objects/{id}/name", capability: "allowsSetup", role: "setup" },
  { control: "#plan-open", method: "get", path: "/api/v1/plan" },
  { control: "#print-open", method: "get", path: "/api/v1/print" },
  { control: "#record", method: "post", path: "/api/v1/recording", capability: "records", role: "operate" },
  { control: "#history-open", method: "get", path: "/api/v1/history", capability: "keepsHistory" },
  { control: "#replay", method: "get", path: "/api/v1/replay", capability: "replays" },
  ...["#replay-pause", "#replay-position", "#replay-settings", "#replay-key"].map((control) => /** @type {const} */ ({ control, method: "patch", path: "/api/v1/replay", capability: "replays", role: "operate" })),
];
/** Needed by the Edit button of each camera card. @type {Need} */
const EDIT = { method: "patch", path: "/api/v1/cameras/{name}", capability: "allowsSetup", role: "setup" };
/** Needed by the Lens button of each camera card. @type {Need} */
const LENS = { method: "post", path: "/api/v1/lens", role: "setup" };
/** Controls without use in a replay. */
const LIVE_ONLY = ["#calibrate", "#plan-open"];

/**
 * Hides the controls that are not offered or not permitted. A server without a description is assumed to have every call.
 * @param {import("../../wire/messages.js").ServerInfo} info
 * @param {import("../../state/session.js").Session | null} session
 */
export async function showCapabilities(info, session) {
  const paths = await describedPaths();
  const offers = (/** @type {Need} */ { method, path, capability, role = "view" }) =>
    permits(session, role) && (!capability || info[capability]) && (!paths || Boolean(paths[path]?.[method]));
  for (const need of NEEDS) find(need.control).hidden = !offers(need);
  if (info.replays) for (const control of LIVE_ONLY) find(control).hidden = true;
  document.body.classList.toggle("no-edits", !offers(EDIT));
  document.body.classList.toggle("no-lens", info.replays || !offers(LENS));
}

async function describedPaths() {
  try {
    const response = await fetch("openapi.json", { cache: "no-cache" });
    return response.ok ? ((await response.json()).paths ?? null) : null;
  } catch {
    return null;
  }
}
