/** Describes the result of a source test. */

import { fixed, whole } from "../../base/format.js";

/** @typedef {{error: string, width: number, height: number, frames: number, broken: number, rate_hz: number, promised_rate_hz: number, roundels: number, decode_ms: number, detect_ms: number}} SourceTest */

/** Empty if no frame arrived. @param {SourceTest} it */
export function sourceTestText(it) {
  if (!(it.frames > 0)) return "";
  const rate = it.rate_hz > 0 ? `${fixed(it.rate_hz, 1)} frames per second` : "one frame";
  const promised = it.promised_rate_hz > 0 ? ` (${fixed(it.promised_rate_hz, 1)} promised)` : "";
  const broken = it.broken > 0 ? ` ${whole(it.broken)} arrived broken.` : "";
  const roundels = it.roundels === 1 ? "one roundel" : `${whole(it.roundels)} roundels`;
  return `${whole(it.width)} × ${whole(it.height)} pixels, ${rate}${promised}; ${roundels} in the newest frame.${broken} Decoding takes ${fixed(it.decode_ms, 1)} ms, detection ${fixed(it.detect_ms, 1)} ms.`;
}
