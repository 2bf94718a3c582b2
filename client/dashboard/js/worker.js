/** The worker's begin: see worker-runtime.js. */

import { runEngine } from "./worker-runtime.js";

runEngine(/** @type {import("./worker-runtime.js").Port} */ (/** @type {unknown} */ (self)));
