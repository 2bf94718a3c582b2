/** Dialog for printing roundels and the calibration board, with a preview. */

import { callApi, fetchFile } from "../../wire/api-client.js";
import { findDialog } from "../forms/dialog.js";
import { element, find, setText } from "../../base/dom.js";
import { fetchRoundelKinds } from "../../wire/roundel-kinds.js";
import { FormErrors } from "../forms/form-errors.js";

/** Delay between the last input and the request of a new preview, ms. */
const PAUSE_MS = 300;
const FIELDS = ["marker", "code", "ids", "copies", "polarity", "board", "pitch", "page", "sheet"];
/** Largest number of codes listed. */
const MOST_LISTED = 500;
/** Value of the option for a custom roundel. */
const OWN = "";

/** @param {import("../../state/store.js").Store} store */
export function showPrint(store) {
  const form = new PrintForm(store);
  find("#print-open").addEventListener("click", () => void form.open());
}

class PrintForm {
  /** @param {import("../../state/store.js").Store} store */
  constructor(store) {
    this.store = store;
    this.dialog = findDialog("#print");
    this.form = /** @type {HTMLFormElement} */ (find("#print-form"));
    this.kind = /** @type {HTMLSelectElement} */ (find("#print-kind"));
    this.picture = /** @type {HTMLImageElement} */ (find("#print-picture"));
    this.files = find("#print-files");
    this.errors = new FormErrors("print", FIELDS);
    /** @type {import("../../wire/roundel-kinds.js").Kind[]} */
    this.kinds = [];
    this.timer = 0;
    this.asked = 0;
    this.shown = "";
    /** The code whose list is shown. */
    this.listed = "";
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.preview();
    });
    this.form.addEventListener("input", (event) => {
      if (event.target === this.kind) this.fill();
      this.showFields();
      clearTimeout(this.timer);
      this.timer = setTimeout(() => void this.preview(), PAUSE_MS);
    });
    this.dialog.addEventListener("close", () => this.forget());
  }

  /** @param {string} name */
  field(name) {
    return /** @type {HTMLInputElement} */ (find(`#print-${name}`));
  }

  async open() {
    this.dialog.showModal();
    // Without known kinds, a custom roundel and the board can be printed.
    this.kinds = await fetchRoundelKinds(this.store);
    const options = this.kinds.map(({ name }) => element("option", { value: name }, [name]));
    const board = element("option", { value: "/board" }, ["Calibration board, for lenses"]);
    this.kind.replaceChildren(...options, element("option", { value: OWN }, ["Custom roundel"]), board);
    this.fill();
    this.showFields();
    void this.preview();
  }

  get isBoard() {
    return this.kind.value === "/board";
  }

  /** Fills the fields with the values of the selected kind. */
  fill() {
    const kind = this.kinds.find(({ name }) => name === this.kind.value);
    if (!kind) return;
    this.field("marker").value = [kind.outer_mm, kind.inner_mm, kind.inner_minor_mm].filter((one) => one !== null).join(":");
    this.field("code").value = kind.code_bits === null ? "" : [kind.code_bits, kind.code_min_distance].filter((one) => one !== null).join(":");
    this.field("polarity").value = kind.polarity.replace("_", "-");
    this.field("ids").value = kind.code_bits === null ? "" : "1-4";
  }

  /** Shows the fields of the selected item. */
  showFields() {
    find("#print-of-board").hidden = !this.isBoard;
    find("#print-of-roundels").hidden = this.isBoard;
    this.field("ids").disabled = this.field("code").value.trim() === "";
  }

  query() {
    const query = new URLSearchParams();
    for (const name of this.isBoard ? ["board", "pitch", "page"] : ["marker", "code", "ids", "copies", "polarity", "page"]) {
      const input = this.field(name);
      if (input.value.trim() !== "" && !input.disabled) query.set(name, input.value.trim());
    }
    return query;
  }

  async preview() {
    clearTimeout(this.timer);
    this.errors.clear();
    const query = this.query();
    this.asked += 1;
    const mine = this.asked;
    const sheet = this.field("sheet").value || "1";
    const { answer, error } = await fetchFile(`print?${query}&format=svg&sheet=${encodeURIComponent(sheet)}`);
    if (mine !== this.asked || !this.dialog.open) return;
    this.files.hidden = Boolean(error);
    this.picture.hidden = Boolean(error);
    if (error) {
      this.errors.showApiError(error);
      return;
    }
    this.forget();
    this.shown = URL.createObjectURL(answer);
    this.picture.src = this.shown;
    this.picture.alt = `Preview of page ${sheet}`;
    find("#print-pdf").setAttribute("href", `api/v1/print?${query}`);
    for (const format of ["svg", "png"]) {
      find(`#print-${format}`).setAttribute("href", `api/v1/print?${query}&format=${format}&sheet=${encodeURIComponent(sheet)}`);
      setText(find(`#print-${format}`), `${format.toUpperCase()}, page ${sheet}`);
    }
    await this.listCodes(mine);
  }

  /** Shows the codes of the selected family. An invalid code has been reported already.
   * @param {number} mine */
  async listCodes(mine) {
    const code = this.field("code").value.trim();
    const list = find("#print-codes");
    if (code === this.listed) return;
    list.hidden = true;
    this.listed = "";
    if (code === "") return;
    const { answer } = await callApi("GET", `codes?${new URLSearchParams({ code })}`);
    if (mine !== this.asked || !Array.isArray(answer)) return;
    const rows = answer.slice(0, MOST_LISTED).map((one) => element("tr", {}, [one.number, one.word, one.distance, one.own_distance].map((cell) => element("td", {}, [String(cell)]))));
    find("#print-code-rows").replaceChildren(...rows);
    const more = answer.length > MOST_LISTED ? `, the first ${MOST_LISTED} listed` : "";
    setText(find("#print-codes > summary"), `${answer.length} codes with their Hamming distances${more}`);
    list.hidden = false;
    this.listed = code;
  }

  /** Releases the preview. */
  forget() {
    if (this.shown) URL.revokeObjectURL(this.shown);
    this.shown = "";
    this.picture.removeAttribute("src");
  }
}
