/** The page's interface to the worker (worker-runtime.js). */

/** @typedef {import("./worker-runtime.js").Commands} Commands */
/** @typedef {import("./worker-runtime.js").Notifications} Notifications */

export class WorkerClient {
  /** @param {() => void} onFailure is called if the worker's program cannot be loaded, or ends */
  constructor(onFailure) {
    /** @type {Partial<{[Name in keyof Notifications]: (value: Notifications[Name]) => void}>} */
    this.listeners = {};
    this.port = canDrawElsewhere() ? startWorker() : startHere();
    if (this.port instanceof Worker) this.port.onerror = onFailure;
    this.port.onmessage = ({ data: [name, value] }) => this.listeners[/** @type {keyof Notifications} */ (name)]?.(value);
  }

  /**
   * @template {keyof Notifications} Name
   * @param {Name} name
   * @param {(value: Notifications[Name]) => void} listener
   */
  on(name, listener) {
    this.listeners[name] = listener;
  }

  /**
   * @template {keyof Commands} Name
   * @param {Name} name
   * @param {Parameters<Commands[Name]>[0]} [value]
   * @param {Transferable[]} [transfer] goes over and is gone here
   */
  send(name, value, transfer = []) {
    this.port.postMessage([name, value], transfer);
  }

  /** A canvas as the other side can draw on it. @param {HTMLCanvasElement} canvas */
  hand(canvas) {
    return this.port instanceof Worker ? canvas.transferControlToOffscreen() : canvas;
  }
}

/** Browsers older than 2023 draw 3D in the page alone. */
function canDrawElsewhere() {
  return "transferControlToOffscreen" in HTMLCanvasElement.prototype && typeof OffscreenCanvas !== "undefined";
}

function startWorker() {
  return new Worker(new URL("./worker.js", import.meta.url), { type: "module", name: "arena" });
}

/** The same in the page. Messages stay in order, though the program comes later; they are not copied, so that a canvas can be one. */
function startHere() {
  /** @type {import("./worker-runtime.js").Port} */
  const there = { postMessage: (data) => queueMicrotask(() => here.onmessage?.(/** @type {MessageEvent} */ ({ data }))), onmessage: null };
  /** @type {{postMessage: (data: any, transfer?: Transferable[]) => void, onmessage: ((event: MessageEvent) => any) | null}} */
  const here = { postMessage: (data) => void ready.then(() => there.onmessage?.(/** @type {MessageEvent} */ ({ data }))), onmessage: null };
  const ready = import("./worker-runtime.js").then(({ runWorker }) => runWorker(there));
  return here;
}
