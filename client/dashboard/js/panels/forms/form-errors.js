/** Shows errors of a form beside their fields, and other errors above the form's buttons. */

import { find, setText } from "../../base/dom.js";

/** A form's elements have ids that begin with its name: `print-page`, `print-page-trouble`, and `print-trouble`. */
export class FormErrors {
  /**
   * @param {string} form
   * @param {string[]} fields with an element for their error
   * @param {Record<string, string>} [marked] ids of elements marked in place of `form-field`, by field
   */
  constructor(form, fields, marked = {}) {
    this.form = form;
    this.fields = fields;
    this.marked = marked;
    this.clear();
  }

  /** @param {import("../../wire/api-client.js").ApiError} error */
  showApiError({ field, message }) {
    if (this.fields.includes(field)) this.showError(field, message);
    else this.showError("", field ? `${field}: ${message}` : message);
  }

  /** @param {string} field empty for an error of the whole form @param {string} message */
  showError(field, message) {
    const trouble = this.place(field);
    setText(trouble, message);
    trouble.hidden = false;
    if (field === "") return;
    const input = this.input(field);
    input.setAttribute("aria-invalid", "true");
    input.closest("details")?.setAttribute("open", "");
    if (input.tabIndex >= 0) input.focus();
  }

  clear() {
    for (const field of ["", ...this.fields]) {
      const trouble = this.place(field);
      setText(trouble, "");
      trouble.hidden = true;
      if (field !== "") this.input(field).removeAttribute("aria-invalid");
    }
  }

  /** @param {string} field */
  place(field) {
    return find(field === "" ? `#${this.form}-trouble` : `#${this.form}-${field}-trouble`);
  }

  /** @param {string} field */
  input(field) {
    return find(`#${this.marked[field] ?? `${this.form}-${field}`}`);
  }
}
