/** A card for each camera: problems, figures and live picture. */

import { element, find, glyph, inOwnFrame, setAttribute, setText } from "../../base/dom.js";
import { fixed, whole } from "../../base/format.js";
import { cameraProblems } from "../../state/camera-health.js";
import { Picture } from "./live-picture.js";

/** Cards updated per animation frame. */
const AT_ONCE = 4;

const STATUS_WORDS = {
  starting: "Starting",
  running: "Running",
  failed: "Failed",
  finished: "Finished",
  unspecified: "Unknown state",
};

/** @typedef {import("../../wire/messages.js").Camera} Camera */
/** @typedef {{edit: (name: string) => void, findLens: (name: string) => void}} Actions open a camera's form, and its lens calibration */

/** @type {{key: string, name: string, unit: string, title: string, value: (camera: Camera) => string}[]} */
const FIGURES = [
  { key: "rate", name: "Rate", unit: "Hz", title: "Frames processed per second", value: (c) => fixed(c.rateHz, 1) },
  { key: "latency", name: "Latency", unit: "ms", title: "From capture to fusion, median", value: (c) => fixed(c.latencyMs, 1) },
  { key: "times", name: "Timestamps", unit: "", title: "Source of the capture times, and their standard deviation before the clock is estimated", value: (c) => timesText(c.captureClock) },
  { key: "clock", name: "Clock", unit: "", title: "Delay of its clock against the other cameras ± standard deviation; capture times are corrected by it", value: (c) => clockText(c.clock) },
  { key: "detect", name: "Detect", unit: "ms", title: "Time to detect the roundels in a frame, median", value: (c) => fixed(c.detectMs, 2) },
  { key: "detections", name: "Roundels", unit: "", title: "Detected in the newest frame", value: (c) => whole(c.detections) },
  { key: "dropped", name: "Dropped", unit: "", title: "Frames dropped because the worker was busy", value: (c) => whole(c.dropped) },
  { key: "broken", name: "Broken", unit: "", title: "Frames that arrived broken", value: (c) => whole(c.broken) },
  { key: "restarts", name: "Restarts", unit: "", title: "Number of times the source was reopened after a failure", value: (c) => whole(c.restarts) },
];

/** @type {Record<string, string>} */
const BASE_WORDS = {
  server: "server clock",
  arrival: "arrival",
  camera: "camera counter",
  driver: "driver timestamp",
  synchronized: "synchronized",
};

/** @param {import("../../wire/messages.js").CaptureClock | null} clock */
function timesText(clock) {
  if (!clock) return "–";
  const words = BASE_WORDS[clock.base] ?? clock.base;
  return clock.deviationMs > 0 ? `${words} ± ${whole(clock.deviationMs)} ms` : words;
}

/** @param {import("../../wire/messages.js").Clock | null} clock */
function clockText(clock) {
  return clock ? `${clock.offsetMs < 0 ? "" : "+"}${fixed(clock.offsetMs, 2)} ± ${fixed(clock.deviationMs, 2)} ms` : "in sync";
}

/**
 * @param {import("../../state/store.js").Store} store
 * @param {Actions} actions
 */
export function showCameraCards(store, actions) {
  const list = find("#camera-cards");
  const empty = find("#cameras-empty");
  const summary = find("#cameras-summary");
  const viewer = new Viewer();
  /** @type {Map<string, Card>} */
  const cards = new Map();

  const fill = (/** @type {string} */ name, /** @type {Card} */ card) => {
    const camera = store.cameras.find((one) => one.name === name);
    if (!camera) return;
    card.fill(camera, store.connection.phase === "live", cameraProblems(camera, store.frameCounters.shares(name)));
    setText(card.noPicture, store.info?.replays ? "No picture recorded at this time" : `No picture from ${name} yet`);
  };

  /** Names of the cards to fill. @type {Set<string>} */
  const due = new Set();
  // A few cards per animation frame, so that many cameras do not block the page.
  const fillSome = () => {
    for (const name of [...due].slice(0, AT_ONCE)) {
      due.delete(name);
      const card = cards.get(name);
      if (card) fill(name, card);
    }
    if (due.size > 0) inOwnFrame(fillSome);
  };

  const update = () => {
    const names = new Set(store.cameras.map((camera) => camera.name));
    for (const [name, card] of cards) {
      if (names.has(name)) continue;
      card.remove();
      cards.delete(name);
    }
    for (const { name } of store.cameras) {
      if (cards.has(name)) continue;
      const card = new Card(name, viewer, actions);
      cards.set(name, card);
      list.append(card.root);
      fill(name, card);
    }
    for (const name of cards.keys()) due.add(name);
    if (due.size > 0) inOwnFrame(fillSome);
    empty.hidden = store.cameras.length > 0 || !store.camerasKnown;
    const failed = store.cameras.filter((camera) => camera.status === "failed").length;
    summary.classList.toggle("bad", failed > 0);
    setText(summary, summaryText(store.cameras, failed));
  };

  store.on("cameras", update);
  store.on("connection", update);
}

/**
 * @param {Camera[]} cameras
 * @param {number} failed
 */
function summaryText(cameras, failed) {
  if (cameras.length === 0) return "";
  if (failed > 0) return `${failed} of ${cameras.length} failed`;
  const running = cameras.filter((camera) => camera.status === "running").length;
  return running === cameras.length ? `${running} running` : `${running} of ${cameras.length} running`;
}

/** Position of the camera, and its carrier. @param {Camera} camera */
function placeText(camera) {
  const on = camera.carrier ? `on ${camera.carrier}` : "fixed";
  if (!camera.pose) return camera.carrier ? on : "";
  const { x, y, z } = camera.pose.position;
  return `${on}, at ${[x, y, z].map((value) => fixed(value, 2)).join("  ")} m`;
}

/** Sender of a `push:` camera; empty if none has connected yet. @param {Camera} camera */
function senderText({ link }) {
  if (!link?.sender) return "";
  const lost = link.missing > 0 ? `, ${whole(link.missing)} frames lost` : "";
  if (!link.connected) return `sender ${link.sender}, disconnected${lost}`;
  const roundTrip = link.roundTripMs > 0 ? `, ${fixed(link.roundTripMs, 1)} ms round trip` : "";
  return `sender ${link.sender} (${link.address})${roundTrip}${lost}`;
}

class Card {
  /**
   * @param {string} name
   * @param {Viewer} viewer
   * @param {Actions} actions
   */
  constructor(name, viewer, actions) {
    const image = new Image();
    image.alt = `Picture of camera ${name} with its detections`;
    this.picture = new Picture(image, name);
    this.noPicture = element("span", { class: "no-picture" });
    this.frame = element("button", { class: "frame", type: "button", title: "Enlarge" }, [image, this.noPicture]);
    this.frame.addEventListener("click", () => viewer.open(name, image));
    this.status = element("span", { class: "status" });
    this.statusShown = "";
    this.note = element("p", { class: "trouble" });
    this.place = element("p", { class: "place" });
    this.sender = element("p", { class: "sender" });
    this.values = FIGURES.map(({ key }) => element("span", { "data-figure": key }));
    const figures = FIGURES.map(({ name: title, unit, title: hint }, i) =>
      element("div", { title: hint }, [
        element("dt", {}, [title]),
        element("dd", {}, unit ? [this.values[i], " ", element("small", {}, [unit])] : [this.values[i]]),
      ]),
    );
    this.head = element("h3", {}, [name]);
    const change = element("button", { type: "button", class: "quiet edit", "aria-haspopup": "dialog", "aria-label": `Edit camera ${name}` }, ["Edit"]);
    change.addEventListener("click", () => actions.edit(name));
    const lens = element("button", { type: "button", class: "quiet find-lens", "aria-haspopup": "dialog", "aria-label": `Calibrate the lens of camera ${name}` }, ["Lens…"]);
    lens.addEventListener("click", () => actions.findLens(name));
    this.root = element("li", { class: "card", "data-camera-card": name }, [
      this.frame,
      element("div", { class: "card-head" }, [this.head, this.status, change]),
      element("div", { class: "card-line" }, [this.place, lens]),
      this.sender,
      this.note,
      element("dl", { class: "figures" }, figures),
    ]);
  }

  /**
   * @param {Camera} camera
   * @param {boolean} live whether the server is connected
   * @param {import("../../state/camera-health.js").Problem[]} problems
   */
  fill(camera, live, problems) {
    setAttribute(this.root, "data-status", camera.status);
    if (this.statusShown !== camera.status) {
      this.statusShown = camera.status;
      this.status.replaceChildren(glyph(camera.status), STATUS_WORDS[camera.status]);
    }
    const blur = camera.blurPx === null ? "" : `, blur ${fixed(camera.blurPx, 2)} px`;
    setAttribute(this.head, "title", `${camera.source}, ${camera.width} × ${camera.height} px${blur}`);
    const words = problems.map((one) => one.why).join(" ");
    setAttribute(this.root, "data-health", problems.length === 0 ? "well" : problems[0].isSevere ? "grave" : "ill");
    this.note.hidden = words === "";
    setText(this.note, words);
    setText(this.place, placeText(camera));
    const sender = senderText(camera);
    this.sender.hidden = sender === "";
    setText(this.sender, sender);
    for (const [i, { value }] of FIGURES.entries()) setText(this.values[i], value(camera));
    // There is no picture before the first frame. A finished camera keeps its last one.
    this.picture.setWanted(live && camera.frames > 0 && camera.status !== "failed" && camera.status !== "starting");
  }

  remove() {
    this.picture.stop();
    this.root.remove();
  }
}

/** Enlarged picture. It copies the card's picture and sends no requests of its own. */
class Viewer {
  constructor() {
    const dialog = find("#viewer");
    const picture = find("#viewer-picture");
    if (!(dialog instanceof HTMLDialogElement) || !(picture instanceof HTMLImageElement)) {
      throw new Error("index.html's viewer is not a dialog with an image");
    }
    this.dialog = dialog;
    this.picture = picture;
    /** @type {HTMLImageElement | null} */
    this.source = null;
    this.observer = new MutationObserver(() => this.copy());
    dialog.addEventListener("close", () => {
      this.observer.disconnect();
      this.source = null;
      this.picture.removeAttribute("src");
    });
    dialog.addEventListener("click", (event) => {
      if (event.target === dialog) dialog.close();
    });
  }

  /**
   * @param {string} name
   * @param {HTMLImageElement} source
   */
  open(name, source) {
    if (!source.classList.contains("loaded")) return;
    this.source = source;
    this.picture.alt = source.alt;
    setText(find("#viewer-title"), `Camera ${name}`);
    this.copy();
    this.observer.observe(source, { attributes: true, attributeFilter: ["data-pictures"] });
    this.dialog.showModal();
  }

  copy() {
    if (this.source) this.picture.src = this.source.src;
  }
}
