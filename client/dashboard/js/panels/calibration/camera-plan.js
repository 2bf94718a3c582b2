/** Dialog with a map of predicted accuracy or coverage. */

import { fetchFile } from "../../wire/api-client.js";
import { findDialog } from "../forms/dialog.js";
import { element, find } from "../../base/dom.js";
import { fetchRoundelKinds } from "../../wire/roundel-kinds.js";
import { FormErrors } from "../forms/form-errors.js";

/** Delay between the last input and the request of a new map, ms. */
const PAUSE_MS = 400;

/** @param {import("../../state/store.js").Store} store */
export function showCameraPlan(store) {
  const dialog = findDialog("#plan");
  const form = /** @type {HTMLFormElement} */ (find("#plan-form"));
  const roundel = /** @type {HTMLSelectElement} */ (find("#plan-roundel"));
  const picture = /** @type {HTMLImageElement} */ (find("#plan-picture"));
  const words = find("#plan-words");
  const errors = new FormErrors("plan", ["show", "roundel", "height"]);
  let timer = 0;
  let asked = 0;
  let shown = "";

  const forget = () => {
    if (shown) URL.revokeObjectURL(shown);
    shown = "";
    picture.removeAttribute("src");
  };

  const look = async () => {
    clearTimeout(timer);
    errors.clear();
    const query = new URLSearchParams({ format: "svg" });
    for (const name of ["show", "roundel", "height"]) {
      const { value } = /** @type {HTMLInputElement} */ (find(`#plan-${name}`));
      if (value.trim() !== "") query.set(name, value.trim());
    }
    asked += 1;
    const mine = asked;
    words.hidden = false;
    const { answer, error } = await fetchFile(`plan?${query}`);
    if (mine !== asked || !dialog.open) return;
    words.hidden = true;
    picture.hidden = Boolean(error);
    if (error) return errors.showApiError(error);
    forget();
    shown = URL.createObjectURL(answer);
    picture.src = shown;
  };

  const open = async () => {
    dialog.showModal();
    const kinds = await fetchRoundelKinds(store);
    const before = roundel.value;
    const options = kinds.map(({ name }) => element("option", { value: name }, [name]));
    roundel.replaceChildren(...(options.length > 0 ? options : [element("option", { value: "" }, ["first kind"])]));
    if (kinds.some(({ name }) => name === before)) roundel.value = before;
    if (dialog.open) await look();
  };

  find("#plan-open").addEventListener("click", () => void open());
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    void look();
  });
  form.addEventListener("input", () => {
    clearTimeout(timer);
    timer = setTimeout(() => void look(), PAUSE_MS);
  });
  dialog.addEventListener("close", forget);
}
