/** Contrast of all text colours with their backgrounds in both themes: WCAG AA, 4.5 to 1. */

import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import { test } from "node:test";

const css = await readFile(new URL("../../../client/dashboard/app.css", import.meta.url), "utf8");

/** The custom properties of the rule that begins with this selector. */
function tokens(selector) {
  const start = css.indexOf(`${selector} {`);
  assert.ok(start >= 0, `app.css has no rule ${selector}`);
  const body = css.slice(start, css.indexOf("}", start));
  return Object.fromEntries([...body.matchAll(/--([a-z-]+): (#[0-9a-f]{6});/g)].map((m) => [m[1], m[2]]));
}

/** Relative luminance as WCAG 2 defines it. */
function luminance(color) {
  const [r, g, b] = [1, 3, 5].map((at) => {
    const part = Number.parseInt(color.slice(at, at + 2), 16) / 255;
    return part <= 0.03928 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4;
  });
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}

function contrast(a, b) {
  const [dark, light] = [luminance(a), luminance(b)].sort((x, y) => x - y);
  return (light + 0.05) / (dark + 0.05);
}

const TEXTS = ["ink", "ink-soft", "tracked", "predicted", "tentative", "lost", "good", "bad", "accent"];
const GROUNDS = ["panel", "sheet", "raised"];
const PAIRS = [["on-accent", "accent"], ["on-banner", "banner"], ["axis-x", "sheet"], ["axis-y", "sheet"]];

for (const selector of [":root", ':root[data-theme="dark"]']) {
  test(`text is legible under ${selector}`, () => {
    const theme = tokens(selector);
    const pairs = [...TEXTS.flatMap((text) => GROUNDS.map((ground) => [text, ground])), ...PAIRS];
    for (const [text, ground] of pairs) {
      const ratio = contrast(theme[text], theme[ground]);
      assert.ok(ratio >= 4.5, `${text} on ${ground}: ${ratio.toFixed(2)}`);
    }
    // Borders of controls need 3 to 1.
    assert.ok(contrast(theme["line-strong"], theme.raised) >= 3);
  });
}
