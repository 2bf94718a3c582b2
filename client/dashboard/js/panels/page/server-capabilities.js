/** Hides the controls of features that the server does not offer, by its OpenAPI description and its info. */

import { find } from "../../base/dom.js";

/** @typedef {"records" | "replays" | "keepsHistory" | "allowsSetup"} Capability */

/** Controls that lead nowhere without a call, or where this server refuses it. @type {{control: string, method: string, path: string, capability?: Capability}[]} */
const NEEDS = [
  { control: "#add-camera", method: "post", path: "/api/v1/cameras", capability: "allowsSetup" },
  { control: "#calibrate", method: "post", path: "/api/v1/calibration" },
  { control: "#setup-try", method: "post", path: "/api/v1/sources/test", capability: "allowsSetup" },
  { control: "#setup-lens", method: "post", path: "/api/v1/lens", capability: "allowsSetup" },
  { control: "#add-object", method: "post", path: "/api/v1/configuration/objects", capability: "allowsSetup" },
  { control: "#name-object", method: "put", path: "/api/v1/objects/{id}/name", capability: "allowsSetup" },
  { control: "#plan-open", method: "get", path: "/api/v1/plan" },
  { control: "#print-open", method: "get", path: "/api/v1/print" },
  { control: "#record", method: "post", path: "/api/v1/recording", capability: "records" },
  { control: "#history-open", method: "get", path: "/api/v1/history", capability: "keepsHistory" },
  { control: "#replay", method: "patch", path: "/api/v1/replay", capability: "replays" },
];
/** Edits of cameras: one button on each card. */
const EDIT = { method: "patch", path: "/api/v1/cameras/{name}", capability: /** @type {const} */ ("allowsSetup") };
/** Searches for their lenses, likewise. */
const LENS = { method: "post", path: "/api/v1/lens" };
/** What a server that plays a recording has nothing to do it with. */
const LIVE_ONLY = ["#calibrate", "#plan-open"];

/**
 * Hides what is not offered. A server that does not describe itself is taken to have every call: its answers then say
 * what it does not.
 * @param {import("../../wire/messages.js").ServerInfo} info
 */
export async function showCapabilities(info) {
  const paths = await describedPaths();
  const offers = (/** @type {{method: string, path: string, capability?: Capability}} */ { method, path, capability }) =>
    (!capability || info[capability]) && (!paths || Boolean(paths[path]?.[method]));
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
