/**
 * Receives and decodes the stream, and draws the arena. Runs in a worker (worker.js), so that 400 objects at 60 Hz do not
 * block the page, or in the page itself in browsers without OffscreenCanvas (worker-client.js).
 *
 * The page receives ten decoded snapshots a second, and every other message undecoded. Messages in
 * both directions are `[name, value]`, with the names of `Notifications` and `Commands`.
 */

import { connect } from "./wire/connection.js";
import { StreamStatistics } from "./state/stream-statistics.js";
import { Stage } from "./arena/stage.js";
import { Store } from "./state/store.js";

/** Interval between two statistics reports, ms. */
const REPORT_MS = 100;

/**
 * Messages from the page.
 * @typedef {object} Commands
 * @property {(value: {url: string, canvases: import("./arena/stage.js").Canvases, palette: import("./arena/palette.js").Palette}) => void} open must be the first message
 * @property {(size: {width: number, height: number, ratio: number}) => void} size of the arena, CSS pixels; 0 while it is hidden
 * @property {(palette: import("./arena/palette.js").Palette) => void} palette
 * @property {(mode: import("./arena/stage.js").StageMode) => void} show answered by `shown`
 * @property {(look: {exaggeration: number, trails: boolean}) => void} look
 * @property {(overlay: import("./state/trajectories.js").HistoryOverlay | null) => void} overlay
 * @property {(by: [number, number, boolean]) => void} drag
 * @property {(by: [number, number, number]) => void} zoom
 * @property {() => void} fit
 * @property {(at: {px: number, py: number, coarse: boolean}) => void} pick answered by `picked`
 * @property {(isOut: boolean) => void} tape
 * @property {(at: {px: number, py: number, coarse: boolean}) => void} measure a click while the tape is out
 * @property {(at: [number, number] | null) => void} point answered by `hovered` if the object under the pointer changes
 * @property {(value: {id: number | null, following: boolean}) => void} select
 * @property {(timeMs: number | null) => void} past instant to show; null: now
 * @property {() => void} retry
 */

/**
 * Messages to the page.
 * @typedef {object} Notifications
 * @property {import("./wire/connection.js").ConnectionState} connection times are since the Unix epoch
 * @property {string | ArrayBuffer} data a message without a snapshot
 * @property {import("./state/store.js").PackedSnapshot} snapshot
 * @property {import("./state/stream-statistics.js").StreamReport} report
 * @property {import("./arena/stage.js").VisibleArea} sight
 * @property {import("./arena/stage.js").StageMode} shown
 * @property {number | null} picked
 * @property {number | null} hovered
 */

/** @typedef {{postMessage: (message: any, transfer?: Transferable[]) => void, onmessage: ((event: MessageEvent) => any) | null}} Port */

/** @param {Port} port to the page */
export function runWorker(port) {
  const store = new Store();
  const statistics = new StreamStatistics();
  /** @type {Stage | null} */
  let stage = null;
  /** @type {{retryNow: () => void} | null} */
  let connection = null;

  /** Identities last sent to the page, by id. @type {Map<number, string>} */
  let identified = new Map();

  /** @type {<Name extends keyof Notifications>(name: Name, value: Notifications[Name], transfer?: Transferable[]) => void} */
  const notify = (name, value, transfer = []) => port.postMessage([name, value], transfer);

  /** @param {import("./wire/messages.js").Message} message @param {string | ArrayBuffer} data */
  const take = (message, data) => {
    store.take(message);
    if (!message.snapshot) return notify("data", data);
    statistics.take(message.snapshot, performance.now());
    // The page receives only the snapshots that the history keeps.
    if (store.history.newestMs === message.snapshot.poseTimeMs) notifySnapshot(message.snapshot);
  };

  /** @param {import("./wire/messages.js").Snapshot} snapshot */
  const notifySnapshot = ({ sourceId, poseTimeMs, objects }) => {
    const { history } = store;
    const byId = (/** @type {import("./state/object-state.js").ObjectState[]} */ states) => states.sort((a, b) => a.id - b.id);
    const there = new Set(objects.map(({ id }) => id));
    const lost = [...store.live.values()].filter(({ id }) => !there.has(id)).map(({ state }) => state);
    const [frame, gone] = [history.pack(poseTimeMs, byId([...objects])), history.pack(poseTimeMs, byId(lost))];
    // After the history was cleared, the page needs all identities again.
    const known = history.count > 1 ? identified : new Map();
    identified = new Map([...objects, ...lost].map((state) => [state.id, identityKey(state)]));
    const identities = [...history.identities].filter(([id]) => identified.has(id) && identified.get(id) !== known.get(id));
    const arrays = [frame, gone].flatMap(({ ids, values, cameras, flags }) => [ids.buffer, values.buffer, cameras.buffer, flags.buffer]);
    notify("snapshot", { sourceId, frame, lost: gone, identities, cameraNames: history.cameraNames }, arrays);
  };

  /** @param {import("./wire/connection.js").ConnectionState} state */
  const become = (state) => {
    if (state.phase !== store.connection.phase) statistics.begin(performance.now());
    store.setConnection(state);
    const { sinceMs, retryAtMs } = state;
    notify("connection", { ...state, sinceMs: sinceMs + performance.timeOrigin, retryAtMs: retryAtMs && retryAtMs + performance.timeOrigin });
  };

  /** @type {Commands} */
  const commands = {
    open({ url, canvases, palette }) {
      stage = new Stage(store, canvases, palette, (sight) => notify("sight", sight));
      connection = connect(url, { onMessage: take, onState: become });
      setInterval(() => notify("report", statistics.report(performance.now())), REPORT_MS);
    },
    size: (size) => stage?.resize(size),
    palette: (palette) => stage?.setPalette(palette),
    show: async (mode) => stage && notify("shown", await stage.show(mode)),
    look: (look) => stage?.setLook(look),
    overlay: (overlay) => stage?.setOverlay(overlay),
    drag: (by) => stage?.drag(...by),
    zoom: (by) => stage?.zoom(...by),
    fit: () => stage?.fit(),
    tape: (isOut) => stage?.takeTape(isOut),
    measure: ({ px, py, coarse }) => stage?.measureAt(px, py, coarse),
    pick: ({ px, py, coarse }) => stage && notify("picked", stage.objectAt(px, py, coarse)),
    point(at) {
      if (!stage) return;
      const before = stage.hovered;
      stage.point(at);
      if (stage.hovered !== before) notify("hovered", stage.hovered);
    },
    select({ id, following }) {
      store.select(id);
      store.follow(following);
    },
    past: (timeMs) => store.seekTo(timeMs),
    retry: () => connection?.retryNow(),
  };
  port.onmessage = ({ data: [name, value] }) => commands[/** @type {keyof Commands} */ (name)](value);
}

/** @param {import("./state/object-state.js").ObjectState} state */
function identityKey({ name, roundel, code }) {
  return `${name}\n${roundel}\n${code ? `${code.bits} ${code.number}` : ""}`;
}
