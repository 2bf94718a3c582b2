/**
 * Sign-in: the dialog, the user's name in the header, and the end of a session.
 *
 * The session is a cookie that scripts cannot read: the page asks the server who is signed in. While the dialog is open,
 * the page is covered and its requests wait.
 */

import { find, setText } from "../../base/dom.js";
import { permits } from "../../state/session.js";
import { access } from "../../wire/api-client.js";
import { fetchSession, signIn, signOut } from "../../wire/session-client.js";
import { sentence } from "../calibration/lens-text.js";
import { FormErrors } from "../forms/form-errors.js";

/** @typedef {import("../../state/session.js").Session} Session */

const ROLE_TITLES = new Map([
  ["view", "This role may view everything."],
  ["operate", "This role may view everything, record, calibrate the arena and control replays."],
  ["setup", "This role may do everything, including changes of cameras and objects."],
]);
const ENDED = "The session has ended. Sign in again.";

export class SignIn {
  /**
   * @param {import("../../state/store.js").Store} store
   * @param {() => void} onReturn called after another sign-in, and not after the first one
   */
  constructor(store, onReturn) {
    this.store = store;
    this.onReturn = onReturn;
    this.dialog = /** @type {HTMLDialogElement} */ (find("#sign-in"));
    this.reason = find("#sign-in-reason");
    this.byPassword = /** @type {HTMLFieldSetElement} */ (find("#sign-in-by-password"));
    this.byToken = /** @type {HTMLFieldSetElement} */ (find("#sign-in-by-token"));
    this.modes = /** @type {HTMLInputElement[]} */ ([...this.dialog.querySelectorAll("input[name=sign-in-mode]")]);
    [this.name, this.password, this.token] = ["#sign-in-name", "#sign-in-password", "#sign-in-token"].map((id) => /** @type {HTMLInputElement} */ (find(id)));
    this.button = find("#sign-in-send");
    this.errors = new FormErrors("sign-in", []);
    this.isBegun = false;
    /** @type {Promise<void> | null} a running question to the server */
    this.checking = null;
    /** Lets the requests of the page pass; null while the dialog is closed. @type {(() => void) | null} */
    this.release = null;
    this.isSending = false;

    for (const input of this.modes) input.addEventListener("change", () => this.showMode());
    find("#sign-in-form").addEventListener("submit", (event) => {
      event.preventDefault();
      void this.send();
    });
    this.dialog.addEventListener("cancel", (event) => event.preventDefault());
    // Some browsers close a dialog at the second Escape nevertheless.
    this.dialog.addEventListener("close", () => this.release && this.dialog.showModal());
    find("#sign-out").addEventListener("click", () => void this.leave());
    access.onRefused = () => void this.check();
  }

  /** Settles when the page may start. */
  async begin() {
    await this.check();
    await access.ready;
    this.isBegun = true;
  }

  /** Asks the server who is signed in, and asks the user for credentials if they are missing. */
  check() {
    this.checking ??= this.ask().finally(() => {
      this.checking = null;
    });
    return this.checking;
  }

  async ask() {
    const before = this.store.session;
    const { session, error } = await fetchSession();
    const isOutdated = this.store.session !== before;
    // An older server has no sessions. The page's header shows when there is no connection.
    if (!isOutdated && (!error || error.status === 404)) this.take(session);
  }

  /** @param {Session | null} session */
  take(session) {
    if (session?.needsCredentials && !permits(session, "view")) return this.open(session);
    const before = this.store.session;
    // Open forms may show what another user may not see.
    if (before?.needsCredentials && before.name !== session?.name) return location.reload();
    this.store.setSession(session);
    showUser(session);
    this.close();
  }

  /** @param {Session} session without sufficient credentials */
  open({ name, role }) {
    if (this.release) return;
    access.ready = new Promise((resolve) => {
      this.release = resolve;
    });
    const hasEnded = this.store.session?.needsCredentials;
    const reason = name ? roleText(name, role) : hasEnded ? ENDED : "";
    setText(this.reason, reason);
    this.reason.hidden = reason === "";
    this.errors.clear();
    this.showMode();
    this.dialog.showModal();
    if (this.name.value !== "") this.secret.focus();
  }

  close() {
    if (!this.release) return;
    this.release();
    this.release = null;
    this.password.value = "";
    this.token.value = "";
    this.dialog.close();
    if (this.isBegun) this.onReturn();
  }

  async send() {
    if (this.isSending) return;
    this.errors.clear();
    this.isSending = true;
    setText(this.button, "Signing in…");
    const { name, password, token } = this;
    const credentials = this.isByToken ? { token: token.value.trim() } : { name: name.value.trim(), password: password.value };
    const { session, error } = await signIn(credentials);
    this.isSending = false;
    setText(this.button, "Sign in");
    if (session && permits(session, "view")) return this.take(session);
    if (error) this.errors.showApiError({ ...error, message: sentence(error.message) });
    else if (session) this.errors.showError("", roleText(session.name, session.role));
    this.secret.focus();
    this.secret.select();
  }

  async leave() {
    const { error } = await signOut();
    if (error) setText(find("#sign-out"), "Sign-out failed, retry");
    // The reloaded page asks for credentials.
    else location.reload();
  }

  showMode() {
    // Disabled fields are not required.
    this.byPassword.hidden = this.byPassword.disabled = this.isByToken;
    this.byToken.hidden = this.byToken.disabled = !this.isByToken;
    this.errors.clear();
  }

  get isByToken() {
    return this.modes.some((input) => input.checked && input.value === "token");
  }

  /** The field that must not be shown. */
  get secret() {
    return this.isByToken ? this.token : this.password;
  }
}

/** @param {Session | null} session */
function showUser(session) {
  find("#user").hidden = !session?.needsCredentials;
  if (!session?.needsCredentials) return;
  setText(find("#user-name"), session.name);
  find("#user-name").title = session.name;
  setText(find("#user-role"), session.role);
  find("#user-role").title = ROLE_TITLES.get(session.role) ?? "";
}

/** @param {string} name @param {string} role */
function roleText(name, role) {
  return `“${name}” has the role “${role}”, which may not view this page. Sign in with other credentials.`;
}
