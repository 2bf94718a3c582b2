/** Entry point of the worker: see worker-runtime.js. */

import { runWorker } from "./worker-runtime.js";

runWorker(/** @type {import("./worker-runtime.js").Port} */ (/** @type {unknown} */ (self)));
