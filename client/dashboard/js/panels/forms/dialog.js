/** Helper for dialogs. */

import { find } from "../../base/dom.js";

/**
 * Returns a dialog that closes on a click outside of it.
 * @param {string} selector
 * @returns {HTMLDialogElement}
 */
export function findDialog(selector) {
  const dialog = find(selector);
  if (!(dialog instanceof HTMLDialogElement)) throw new Error(`index.html's ${selector} is not a dialog`);
  dialog.addEventListener("click", (event) => {
    if (event.target === dialog) dialog.close();
  });
  return dialog;
}
