/** What all dialogs have in common. */

import { find } from "../../base/dom.js";

/**
 * A dialog that a click beside it closes.
 * @param {string} selector
 * @returns {HTMLDialogElement}
 */
export function findDialog(selector) {
  const dialog = find(selector);
  if (!(dialog instanceof HTMLDialogElement)) throw new Error(`index.html's ${selector} is no dialog`);
  dialog.addEventListener("click", (event) => {
    if (event.target === dialog) dialog.close();
  });
  return dialog;
}
