/** The worker's begin: see engine.js. */

import { runEngine } from "./engine.js";

runEngine(/** @type {import("./engine.js").Port} */ (/** @type {unknown} */ (self)));
