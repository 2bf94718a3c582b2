/** Form that adds, changes, names and removes objects. Errors are shown at their fields. */

import { callApi } from "../../wire/api-client.js";
import { findDialog } from "../forms/dialog.js";
import { element, find, setText } from "../../base/dom.js";
import { Mounts } from "./mount-fields.js";
import { changedFields, withoutEmpty } from "../cameras/camera-form.js";
import { FormErrors } from "../forms/form-errors.js";

/** Fields that can have errors, by their API names. */
const FIELDS = ["name", "roundel", "mounts", "code", "offset_m", "motion", "height_m"];
const AXES = /** @type {const} */ (["x", "y", "z"]);

/** @typedef {{name: string, roundel: string, roundels: import("./mount-fields.js").Mount[], code: number | null, offset_m: {x: number, y: number, z: number} | null, motion: string, height_m: number | null}} Setup */

/** @param {import("../../state/store.js").Store} store */
export function showObjectForm(store) {
  const form = new ObjectForm();
  find("#add-object").addEventListener("click", () => void form.open(""));
  const button = find("#name-object");
  button.addEventListener("click", () => {
    const state = store.selectedState;
    if (state?.name) void form.open(state.name);
    else if (state) form.openToName(state);
  });
  // The name of the selected object can change.
  const showWhat = () => setText(button, store.selectedState?.name ? "Set up…" : "Name…");
  store.on("selection", showWhat);
  store.on("snapshot", showWhat);
}

class ObjectForm {
  constructor() {
    this.dialog = findDialog("#object");
    this.form = /** @type {HTMLFormElement} */ (find("#object-form"));
    this.choice = /** @type {HTMLSelectElement} */ (find("#object-choice"));
    this.remove = /** @type {HTMLButtonElement} */ (find("#object-remove"));
    this.save = /** @type {HTMLButtonElement} */ (find("#object-save"));
    this.words = find("#object-words");
    this.errors = new FormErrors("object", FIELDS, { offset_m: "object-offset", mounts: "object-several" });
    this.carries = /** @type {HTMLSelectElement} */ (find("#object-carries"));
    this.mounts = new Mounts();
    /** @type {Setup[]} */
    this.known = [];
    /** @type {Setup | null} the server's version; null for a new object */
    this.before = null;
    /** @type {number | null} id of an unnamed object that is being named */
    this.unnamed = null;
    this.asksBack = false;

    this.choice.addEventListener("change", () => this.fill(this.known.find(({ name }) => name === this.choice.value) ?? null));
    this.carries.addEventListener("change", () => this.showCarried());
    this.form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.store();
    });
    this.remove.addEventListener("click", () => void this.removeIt());
  }

  /** @param {string} name */
  field(name) {
    return /** @type {HTMLInputElement} */ (find(`#object-${name}`));
  }

  /** @param {string} name of a configured object; empty for a new one */
  async open(name) {
    this.show("Objects", null);
    // Old choices may be outdated.
    this.choice.replaceChildren();
    const answer = await this.callApi("GET", "configuration");
    if (!answer || !this.dialog.open) return;
    this.known = answer.objects;
    this.mounts.kinds = answer.roundels.map((/** @type {{name: string}} */ kind) => kind.name);
    const kinds = this.mounts.kinds.map((kind) => element("option", { value: kind }, [kind]));
    this.field("roundel").replaceChildren(element("option", { value: "" }, ["none: located by its own camera"]), ...kinds);
    const others = this.known.map((one) => element("option", { value: one.name }, [one.name]));
    this.choice.replaceChildren(element("option", { value: "" }, ["New object"]), ...others);
    this.choice.value = name;
    this.fill(this.known.find((one) => one.name === name) ?? null);
  }

  /** @param {import("../../state/object-state.js").ObjectState} state */
  openToName(state) {
    this.show(`Name object ${state.id}`, state.id);
    this.say(state.code ? `The object is identified by its code, ${state.code.number}.` : "Without a code, the object is identified by its roundel kind and must be the only one of that kind.");
    setText(this.save, "Save name");
  }

  /** @param {string} title @param {number | null} unnamed */
  show(title, unnamed) {
    this.unnamed = unnamed;
    setText(find("#object-title"), title);
    find("#object-which").hidden = unnamed !== null;
    find("#object-rest").hidden = unnamed !== null;
    this.fill(null);
    this.dialog.showModal();
    this.field("name").focus();
  }

  /** @param {Setup | null} setup */
  fill(setup) {
    this.before = setup;
    this.asksBack = false;
    this.errors.clear();
    this.say("");
    const chosen = this.choice.value;
    this.form.reset();
    this.choice.value = chosen;
    setText(this.save, setup ? "Save" : "Add");
    setText(this.remove, "Remove…");
    this.remove.hidden = setup === null;
    this.mounts.fill(setup?.roundels ?? []);
    this.carries.value = setup && setup.roundels.length > 0 ? "several" : "one";
    this.showCarried();
    if (!setup) {
      // Preselect the first kind.
      const kind = /** @type {HTMLSelectElement} */ (find("#object-roundel"));
      if (kind.options.length > 1) kind.selectedIndex = 1;
      return;
    }
    for (const key of /** @type {const} */ (["name", "roundel", "motion"])) this.field(key).value = setup[key];
    for (const key of /** @type {const} */ (["code", "height_m"])) this.field(key).value = setup[key] === null ? "" : String(setup[key]);
    for (const axis of AXES) this.field(`offset-${axis}`).value = setup.offset_m ? String(setup.offset_m[axis]) : "";
  }

  /** Shows the fields for one or several roundels; with several, at least two rows. */
  showCarried() {
    const several = this.carries.value === "several";
    find("#object-one").hidden = several;
    find("#object-several").hidden = !several;
    if (several && this.mounts.rows.length === 0) for (let row = 0; row < 2; row += 1) this.mounts.add(null);
  }

  /** Reads the form; null after showing an error. @returns {Setup | null} */
  read() {
    const several = this.carries.value === "several";
    const offset = several ? null : this.readOffset();
    const roundels = several ? this.mounts.read() : [];
    if (offset === undefined || roundels === null) return null;
    if (several && roundels.length === 0) {
      this.errors.showError("mounts", "Add roundels, or select one roundel.");
      return null;
    }
    for (const key of ["code", "height_m"]) {
      if (!this.field(key).validity.badInput) continue;
      this.errors.showError(key, "Enter a number, or leave it empty.");
      return null;
    }
    const number = (/** @type {string} */ key) => (this.field(key).value === "" ? null : Number(this.field(key).value));
    return {
      name: this.field("name").value.trim(),
      roundel: several ? "" : this.field("roundel").value,
      roundels,
      code: several ? null : number("code"),
      offset_m: offset,
      motion: this.field("motion").value,
      height_m: number("height_m"),
    };
  }

  /** Returns null if it is empty, undefined if it is incomplete. */
  readOffset() {
    const inputs = AXES.map((axis) => this.field(`offset-${axis}`));
    if (inputs.every((input) => input.value === "" && !input.validity.badInput)) return null;
    if (inputs.some((input) => input.value === "")) {
      this.errors.showError("offset_m", "Enter all three values in metres, or none.");
      return undefined;
    }
    const [x, y, z] = inputs.map((input) => Number(input.value));
    return { x, y, z };
  }

  async store() {
    this.errors.clear();
    const name = this.field("name").value.trim();
    if (name === "") return this.errors.showError("name", "Enter a name.");
    if (this.unnamed !== null) return this.finish(await this.callApi("PUT", `objects/${this.unnamed}/name`, { name }));
    const wanted = this.read();
    if (!wanted) return;
    const { before } = this;
    if (before) this.finish(await this.callApi("PATCH", `configuration/objects/${encodeURIComponent(before.name)}`, changedFields(before, wanted)));
    else this.finish(await this.callApi("POST", "configuration/objects", withoutEmpty({ ...wanted, roundels: wanted.roundels.length > 0 ? wanted.roundels : null })));
  }

  async removeIt() {
    if (!this.before) return;
    this.errors.clear();
    if (!this.asksBack) {
      this.asksBack = true;
      setText(this.remove, `Remove ${this.before.name}`);
      this.say("This also removes it from the configuration. An object with a code is still tracked, without a name. Press again to confirm.");
      return;
    }
    this.finish(await this.callApi("DELETE", `configuration/objects/${encodeURIComponent(this.before.name)}`));
  }

  /** @param {any} done */
  finish(done) {
    if (done) this.dialog.close();
  }

  /** Returns the response, or null after showing the error. @param {string} method @param {string} path @param {object} [body] @returns {Promise<any>} */
  async callApi(method, path, body) {
    for (const button of [this.save, this.remove]) button.disabled = true;
    const { answer, error } = await callApi(method, path, body);
    for (const button of [this.save, this.remove]) button.disabled = false;
    if (error) this.errors.showApiError({ ...error, field: this.fieldOf(error.field) });
    return answer;
  }

  /** Field of the form for a field of the API. @param {string} field */
  fieldOf(field) {
    if (field !== "roundel") return field;
    return this.unnamed !== null ? "" : this.carries.value === "several" ? "mounts" : field;
  }

  /** @param {string} words */
  say(words) {
    setText(this.words, words);
  }
}
