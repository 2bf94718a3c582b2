/** Translates mouse, touch and keyboard input on the arena to drag, zoom, pick and hover. */

/** A press that moves less than this is a click, CSS pixels. */
const CLICK_SLACK_PX = 5;
const PAN_STEP_PX = 60;
const ZOOM_STEP = 1.25;

/**
 * @typedef {object} GestureHandlers
 * @property {(dx: number, dy: number, isSecond: boolean) => void} drag movement in pixels; isSecond: with Shift, the right
 *   button or two fingers
 * @property {(px: number, py: number, factor: number) => void} zoom about a point
 * @property {(px: number, py: number, coarse: boolean) => void} pick coarse: by touch
 * @property {(px: number | null, py: number | null) => void} hover null outside the arena
 */

/**
 * @param {HTMLElement} target
 * @param {GestureHandlers} handlers
 */
export function listenForGestures(target, handlers) {
  listenForPointers(target, handlers);
  target.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      const [px, py] = place(target, event);
      // Mouse wheels report lines (1) or pages (2), touch pads pixels (0).
      const pixels = event.deltaY * (event.deltaMode === 1 ? 16 : event.deltaMode === 2 ? 400 : 1);
      // A pinch on a touch pad arrives as wheel events with Ctrl and small steps.
      handlers.zoom(px, py, Math.exp(-pixels * (event.ctrlKey ? 0.01 : 0.0016)));
    },
    { passive: false },
  );
  target.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const action = keyAction(event.key, event.shiftKey, target, handlers);
    if (!action) return;
    event.preventDefault();
    action();
  });
}

/**
 * @param {string} key
 * @param {boolean} isSecond with Shift
 * @param {HTMLElement} target
 * @param {GestureHandlers} handlers
 * @returns {(() => void) | undefined}
 */
function keyAction(key, isSecond, target, handlers) {
  const zoom = (/** @type {number} */ factor) =>
    handlers.zoom(target.clientWidth / 2, target.clientHeight / 2, factor);
  /** @type {Record<string, () => void>} */
  const actions = {
    ArrowLeft: () => handlers.drag(PAN_STEP_PX, 0, isSecond),
    ArrowRight: () => handlers.drag(-PAN_STEP_PX, 0, isSecond),
    ArrowUp: () => handlers.drag(0, PAN_STEP_PX, isSecond),
    ArrowDown: () => handlers.drag(0, -PAN_STEP_PX, isSecond),
    "+": () => zoom(ZOOM_STEP),
    "=": () => zoom(ZOOM_STEP),
    "-": () => zoom(1 / ZOOM_STEP),
  };
  return actions[key.length === 1 ? key.toLowerCase() : key];
}

/**
 * @param {HTMLElement} target
 * @param {GestureHandlers} handlers
 */
function listenForPointers(target, handlers) {
  /** @type {Map<number, [number, number]>} positions of the pressed pointers */
  const down = new Map();
  let travelledPx = 0;
  let isSecond = false;

  // The right button pans, so it must not open a menu.
  target.addEventListener("contextmenu", (event) => event.preventDefault());
  target.addEventListener("pointerdown", (event) => {
    if (event.button !== 0 && event.button !== 2) return;
    isSecond = event.shiftKey || event.button === 2;
    target.setPointerCapture(event.pointerId);
    if (down.size === 0) travelledPx = 0;
    // With a second finger it is a pinch, not a click.
    else travelledPx = Infinity;
    down.set(event.pointerId, place(target, event));
  });

  target.addEventListener("pointermove", (event) => {
    const now = place(target, event);
    const before = down.get(event.pointerId);
    if (!before) {
      if (event.pointerType === "mouse") handlers.hover(...now);
      return;
    }
    const spanBefore = span(down);
    down.set(event.pointerId, now);
    const [dx, dy] = [now[0] - before[0], now[1] - before[1]];
    travelledPx += Math.hypot(dx, dy);
    if (travelledPx < CLICK_SLACK_PX) return;
    // Each of two fingers moves their midpoint by half of its own movement.
    handlers.drag(dx / down.size, dy / down.size, isSecond || down.size > 1);
    if (down.size === 2 && spanBefore > 0) {
      const [a, b] = [...down.values()];
      handlers.zoom((a[0] + b[0]) / 2, (a[1] + b[1]) / 2, span(down) / spanBefore);
    }
  });

  target.addEventListener("pointerup", (event) => {
    if (!down.delete(event.pointerId)) return;
    if (down.size === 0 && travelledPx < CLICK_SLACK_PX && event.button === 0) {
      handlers.pick(...place(target, event), event.pointerType !== "mouse");
    }
  });
  target.addEventListener("pointercancel", (event) => down.delete(event.pointerId));
  target.addEventListener("pointerleave", () => handlers.hover(null, null));
}

/** Distance of two fingers; 0 for one. @param {Map<number, [number, number]>} down */
function span(down) {
  if (down.size !== 2) return 0;
  const [a, b] = [...down.values()];
  return Math.hypot(a[0] - b[0], a[1] - b[1]);
}

/**
 * @param {HTMLElement} target
 * @param {MouseEvent} event
 * @returns {[number, number]} CSS pixels from the target's corner
 */
function place(target, event) {
  const box = target.getBoundingClientRect();
  return [event.clientX - box.left, event.clientY - box.top];
}
