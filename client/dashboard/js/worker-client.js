/** The page's interface to the worker (worker-runtime.js). */

/** @typedef {import("./worker-runtime.js").Commands} Commands */
/** @typedef {import("./worker-runtime.js").Notifications} Notifications */

export class WorkerClient {
  /** @param {() => void} onFailure called if the worker cannot be loaded or fails */
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
   * @param {Transferable[]} [transfer] objects whose ownership moves to the worker
   */
  send(name, value, transfer = []) {
    this.port.postMessage([name, value], transfer);
  }

  /** Transfers a canvas for drawing by the worker. @param {HTMLCanvasElement} canvas */
  hand(canvas) {
    return this.port instanceof Worker ? canvas.transferControlToOffscreen() : canvas;
  }
}

/** Browsers older than 2023 cannot draw in a worker. */
function canDrawElsewhere() {
  return "transferControlToOffscreen" in HTMLCanvasElement.prototype && typeof OffscreenCanvas !== "undefined";
}

function startWorker() {
  return new Worker(new URL("./worker.js", import.meta.url), { type: "module", name: "arena" });
}

/** Runs the worker's code in the page. Messages wait until it is loaded, stay in order and are not copied. */
function startHere() {
  /** @type {import("./worker-runtime.js").Port} */
  const there = { postMessage: (data) => queueMicrotask(() => here.onmessage?.(/** @type {MessageEvent} */ ({ data }))), onmessage: null };
  /** @type {{postMessage: (data: any, transfer?: Transferable[]) => void, onmessage: ((event: MessageEvent) => any) | null}} */
  const here = { postMessage: (data) => void ready.then(() => there.onmessage?.(/** @type {MessageEvent} */ ({ data }))), onmessage: null };
  const ready = import("./worker-runtime.js").then(({ runWorker }) => runWorker(there));
  return here;
}
