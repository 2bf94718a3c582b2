/** What this server can do, by its own description: what it cannot is not on the page. */

import { find } from "./dom.js";

/** Controls that lead nowhere without a call. @type {{control: string, method: string, path: string}[]} */
const NEEDS = [
  { control: "#add-camera", method: "post", path: "/api/v1/cameras" },
  { control: "#calibrate", method: "post", path: "/api/v1/calibration" },
  { control: "#setup-try", method: "post", path: "/api/v1/sources/test" },
];
/** Edits of cameras: one button on each card. */
const EDIT = { method: "patch", path: "/api/v1/cameras/{name}" };

/**
 * Hides what is not offered. A server that does not describe itself is taken to offer everything: its answers then say
 * what it does not.
 */
export async function showOffer() {
  let description;
  try {
    const response = await fetch("openapi.json", { cache: "no-cache" });
    if (!response.ok) return;
    description = await response.json();
  } catch {
    return;
  }
  const offers = (/** @type {{method: string, path: string}} */ { method, path }) => Boolean(description.paths?.[path]?.[method]);
  for (const need of NEEDS) find(need.control).hidden = !offers(need);
  document.body.classList.toggle("no-edits", !offers(EDIT));
}
