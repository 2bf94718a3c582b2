/**
 * Live picture of a camera. While it is in view it is requested repeatedly, one request at a time.
 */

import { request } from "../../wire/api-client.js";

/** Pause between the end of one request and the start of the next, ms: two to three a second. */
const PAUSE_MS = 350;
/** Pauses after the first failure and after many in a row, ms. A recording may have no pictures. */
const FAILURE_PAUSE_MS = 2000;
const LONGEST_PAUSE_MS = 30_000;
/** Timeout of a request, ms. */
const TIMEOUT_MS = 5000;

/** Notifies each picture when it enters or leaves the view. */
const watcher = new IntersectionObserver((entries) => {
  for (const entry of entries) pictures.get(entry.target)?.setInView(entry.isIntersecting);
});
/** @type {WeakMap<Element, Picture>} */
const pictures = new WeakMap();

document.addEventListener("visibilitychange", () => {
  if (document.visibilityState !== "visible") return;
  for (const image of document.querySelectorAll("img[data-camera]")) pictures.get(image)?.wake();
});

export class Picture {
  /**
   * @param {HTMLImageElement} image
   * @param {string} camera its name
   */
  constructor(image, camera) {
    this.image = image;
    this.path = `cameras/${encodeURIComponent(camera)}/frame.jpg`;
    this.wanted = false;
    this.inView = false;
    this.busy = false;
    this.timer = 0;
    this.failures = 0;
    this.shown = "";
    image.dataset.camera = camera;
    pictures.set(image, this);
    watcher.observe(image);
  }

  /** @param {boolean} wanted whether the camera has a picture */
  setWanted(wanted) {
    if (this.wanted === wanted) return;
    this.wanted = wanted;
    this.failures = 0;
    this.wake();
  }

  /** @param {boolean} inView */
  setInView(inView) {
    this.inView = inView;
    this.wake();
  }

  wake() {
    clearTimeout(this.timer);
    void this.load();
  }

  async load() {
    if (this.busy || !this.wanted || !this.inView || document.visibilityState !== "visible") return;
    this.busy = true;
    const done = await this.fetchOnce();
    this.busy = false;
    this.failures = done ? 0 : this.failures + 1;
    const pauseMs = done ? PAUSE_MS : Math.min(LONGEST_PAUSE_MS, FAILURE_PAUSE_MS * 2 ** (this.failures - 1));
    this.timer = setTimeout(() => void this.load(), pauseMs);
  }

  /** @returns {Promise<boolean>} whether a picture was received */
  async fetchOnce() {
    try {
      // The time in the URL defeats proxies that ignore cache headers.
      const response = await request(`${this.path}?t=${Date.now()}`, { signal: AbortSignal.timeout(TIMEOUT_MS) });
      if (!response.ok) return false;
      const address = URL.createObjectURL(await response.blob());
      const before = this.shown;
      this.image.src = address;
      this.shown = address;
      // The old picture stays visible until the new one is decoded.
      await this.image.decode();
      if (before) URL.revokeObjectURL(before);
      this.image.classList.add("loaded");
      this.image.dataset.pictures = String(Number(this.image.dataset.pictures ?? 0) + 1);
      return true;
    } catch {
      return false;
    }
  }

  stop() {
    this.wanted = false;
    clearTimeout(this.timer);
    watcher.unobserve(this.image);
    if (this.shown) URL.revokeObjectURL(this.shown);
  }
}
