/** A card for each camera: how it is doing, in words and numbers, and what it sees. */

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
/** @typedef {{edit: (name: string) => void, findLens: (name: string) => void}} Actions open a camera's setup, and the search for its lens */

/** @type {{key: string, name: string, unit: string, title: string, value: (camera: Camera) => string}[]} */
const FIGURES = [
  { key: "rate", name: "Rate", unit: "Hz", title: "Frames processed a second", value: (c) => fixed(c.rateHz, 1) },
  { key: "latency", name: "Latency", unit: "ms", title: "From capture to fused, median", value: (c) => fixed(c.latencyMs, 1) },
  { key: "times", name: "Times", unit: "", title: "Where its capture times come from, and what they may be off by together before anything is found", value: (c) => timesText(c.captureClock) },
  { key: "clock", name: "Clock", unit: "", title: "By how much its clock is late against the others, give or take; times are corrected by it", value: (c) => clockText(c.clock) },
  { key: "detect", name: "Detect", unit: "ms", title: "Time to find the roundels in a frame, median", value: (c) => fixed(c.detectMs, 2) },
  { key: "detections", name: "Roundels", unit: "", title: "Found in the newest frame", value: (c) => whole(c.detections) },
  { key: "dropped", name: "Dropped", unit: "", title: "Frames that gave way to newer ones because the worker was busy", value: (c) => whole(c.dropped) },
  { key: "broken", name: "Broken", unit: "", title: "Frames that arrived broken and were left out", value: (c) => whole(c.broken) },
  { key: "restarts", name: "Restarts", unit: "", title: "Times that the source was opened again after a failure", value: (c) => whole(c.restarts) },
];

/** @type {Record<string, string>} */
const BASE_WORDS = {
  server: "server's clock",
  arrival: "arrival",
  camera: "camera's counter",
  driver: "driver's stamp",
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
  return clock ? `${clock.offsetMs < 0 ? "" : "+"}${fixed(clock.offsetMs, 2)} ± ${fixed(clock.deviationMs, 2)} ms` : "trusted";
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
    setText(card.noPicture, store.info?.replays ? "No picture recorded here" : `No picture from ${name} yet`);
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
    const all = [...cards];
    // All at once would hold up the page where there are many.
    for (let i = 0; i < all.length; i += AT_ONCE) inOwnFrame(() => all.slice(i, i + AT_ONCE).forEach(([name, card]) => fill(name, card)));
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

/** Where it is, and what carries it. @param {Camera} camera */
function placeText(camera) {
  const on = camera.carrier ? `on ${camera.carrier}` : "stands";
  if (!camera.pose) return camera.carrier ? on : "";
  const { x, y, z } = camera.pose.position;
  return `${on}, at ${[x, y, z].map((value) => fixed(value, 2)).join("  ")} m`;
}

/** The program that feeds it; empty of a camera that no program has fed. @param {Camera} camera */
function senderText({ link }) {
  if (!link?.sender) return "";
  const lost = link.missing > 0 ? `, ${whole(link.missing)} frames lost on the way` : "";
  if (!link.connected) return `was fed by ${link.sender}${lost}`;
  const away = link.roundTripMs > 0 ? `, ${fixed(link.roundTripMs, 1)} ms there and back` : "";
  return `fed by ${link.sender} (${link.address})${away}${lost}`;
}

class Card {
  /**
   * @param {string} name
   * @param {Viewer} viewer
   * @param {Actions} actions
   */
  constructor(name, viewer, actions) {
    const image = new Image();
    image.alt = `What camera ${name} sees, with its detections drawn in`;
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
    const lens = element("button", { type: "button", class: "quiet find-lens", "aria-haspopup": "dialog", "aria-label": `Find the lens of camera ${name}` }, ["Lens…"]);
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
   * @param {boolean} live whether the server can be asked for pictures
   * @param {import("../../state/camera-health.js").Problem[]} problems
   */
  fill(camera, live, problems) {
    setAttribute(this.root, "data-status", camera.status);
    if (this.statusShown !== camera.status) {
      this.statusShown = camera.status;
      this.status.replaceChildren(glyph(camera.status), STATUS_WORDS[camera.status]);
    }
    const blur = camera.blurPx === null ? "" : `, blurred by ${fixed(camera.blurPx, 2)} px`;
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
    // Before the first frame there is no picture to ask for; a finished camera's last one stays.
    this.picture.setWanted(live && camera.frames > 0 && camera.status !== "failed" && camera.status !== "starting");
  }

  remove() {
    this.picture.stop();
    this.root.remove();
  }
}

/** One picture, large. It shows what the card's picture shows, so nothing is asked for twice. */
class Viewer {
  constructor() {
    const dialog = find("#viewer");
    const picture = find("#viewer-picture");
    if (!(dialog instanceof HTMLDialogElement) || !(picture instanceof HTMLImageElement)) {
      throw new Error("index.html's viewer is no dialog with an image");
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
