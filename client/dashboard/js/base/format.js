/** Formats numbers and times. Unknown values are an en dash. */

const UNKNOWN = "–";
/** A true minus sign: as wide as a digit, so that columns of signed numbers stay aligned. */
const MINUS = "\u2212";

const clock = new Intl.DateTimeFormat(undefined, {
  hour: "2-digit",
  minute: "2-digit",
  second: "2-digit",
  hourCycle: "h23",
});

const preciseClock = new Intl.DateTimeFormat(undefined, {
  hour: "2-digit",
  minute: "2-digit",
  second: "2-digit",
  fractionalSecondDigits: 1,
  hourCycle: "h23",
});

const calendar = new Intl.DateTimeFormat(undefined, {
  day: "numeric",
  month: "short",
  hour: "2-digit",
  minute: "2-digit",
  hourCycle: "h23",
});

/**
 * @param {number | null | undefined} value
 * @param {number} decimals
 */
export function fixed(value, decimals) {
  if (value === null || value === undefined || !Number.isFinite(value)) return UNKNOWN;
  const digits = Math.abs(value).toFixed(decimals);
  // -0.0001 must not read as "−0.00".
  return value < 0 && Number(digits) !== 0 ? MINUS + digits : digits;
}

/** At most three significant digits from 1 up, else two decimals. @param {number | null} value */
export function significant(value) {
  if (value === null || !Number.isFinite(value)) return UNKNOWN;
  const size = Math.abs(value);
  return fixed(value, size >= 100 ? 0 : size >= 10 ? 1 : 2);
}

/** With thin spaces between thousands. @param {number} value */
export function whole(value) {
  return Math.round(value)
    .toString()
    .replace(/\B(?=(\d{3})+$)/g, "\u2009");
}

/** @param {number | null} rad */
export function degrees(rad) {
  return rad === null ? UNKNOWN : `${fixed((rad * 180) / Math.PI, 1)}°`;
}

/** "41 ms", "3.2 s", "5 min", "12 days". @param {number | null} ms */
export function duration(ms) {
  if (ms === null || !Number.isFinite(ms)) return UNKNOWN;
  if (ms < 1000) return `${fixed(Math.round(ms), 0)} ms`;
  if (ms < 10_000) return `${fixed(ms / 1000, 1)} s`;
  if (ms < 120_000) return `${fixed(ms / 1000, 0)} s`;
  if (ms < 7_200_000) return `${fixed(ms / 60_000, 0)} min`;
  if (ms < 172_800_000) return `${fixed(ms / 3_600_000, 1)} h`;
  return `${fixed(ms / 86_400_000, 0)} days`;
}

/** "640 kB", "1.9 GB". @param {number} bytes */
export function size(bytes) {
  if (!Number.isFinite(bytes)) return UNKNOWN;
  const power = Math.min(4, Math.max(0, Math.floor(Math.log10(Math.max(1, bytes)) / 3)));
  const value = bytes / 1000 ** power;
  return `${fixed(value, power === 0 || value >= 100 ? 0 : 1)} ${["B", "kB", "MB", "GB", "TB"][power]}`;
}

/** "0:07", "1:02:03". @param {number} seconds */
export function minutes(seconds) {
  const whole = Math.max(0, Math.floor(seconds));
  const two = (/** @type {number} */ part) => String(part % 60).padStart(2, "0");
  const hours = Math.floor(whole / 3600);
  const minute = Math.floor(whole / 60);
  return hours > 0 ? `${hours}:${two(minute)}:${two(whole)}` : `${minute}:${two(whole)}`;
}

/** Local date and time of day, to the minute. @param {number} unixMs */
export function dateAndTime(unixMs) {
  return calendar.format(unixMs);
}

/** Local time of day, to a tenth of a second. @param {number} unixMs */
export function preciseTimeOfDay(unixMs) {
  return preciseClock.format(unixMs);
}

/** Local time of day. @param {number} unixMs */
export function timeOfDay(unixMs) {
  return clock.format(unixMs);
}
