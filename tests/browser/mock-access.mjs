/** Credentials of the mock server: sessions, and the role that each request needs. */

import { randomUUID } from "node:crypto";

const RANKS = ["view", "operate", "setup"];

/** @typedef {{name: string, role: string, password?: string, token?: string}} User */

export class MockAccess {
  /** @param {User[]} [users] empty: no credentials are needed @param {string} [role] of clients without credentials */
  constructor(users = [], role = "setup") {
    this.users = users;
    this.role = role;
    /** @type {Map<string, User>} */
    this.sessions = new Map();
    /** Paths of the requests that were refused. @type {string[]} */
    this.refused = [];
  }

  /** Status and body of the refusal of a request; null if it is permitted. */
  refusal(request) {
    const { pathname } = new URL(request.url, "http://mock");
    if (!pathname.startsWith("/api/") || pathname === "/api/v1/session") return null;
    const user = this.userOf(request);
    const needed = neededRole(request.method, pathname);
    const has = RANKS.indexOf(user?.role) >= RANKS.indexOf(needed);
    if (user && (has || pathname === "/api/v1/info")) return null;
    this.refused.push(`${request.method} ${pathname}`);
    return user
      ? [403, wrong("permission_denied", `this request needs the role "${needed}", and "${user.name}" has "${user.role}"`)]
      : [401, wrong("unauthenticated", "this server needs credentials: send `authorization: Bearer TOKEN`, or sign in on the dashboard")];
  }

  /** Status, body and headers of the response to a request for /api/v1/session. */
  answer(request, body) {
    if (request.method === "GET") return [200, this.describe(this.userOf(request))];
    if (request.method === "DELETE") {
      this.sessions.delete(cookieOf(request));
      return [200, this.describe(undefined), { "set-cookie": "roundel_session=; Path=/; Max-Age=0; HttpOnly; SameSite=Lax" }];
    }
    const { name, password, token } = body;
    const user = this.users.find((each) => (token ? each.token === token : each.name === name && each.password === password));
    if (!user) return [401, wrong("unauthenticated", token ? "the token is not one of this server" : "name or password is wrong")];
    const session = randomUUID();
    this.sessions.set(session, user);
    return [200, this.describe(user), { "set-cookie": `roundel_session=${session}; Path=/; HttpOnly; SameSite=Lax` }];
  }

  userOf(request) {
    return this.users.length === 0 ? { name: "anonymous", role: this.role } : this.sessions.get(cookieOf(request));
  }

  describe(user) {
    return { needs_credentials: this.users.length > 0, name: user?.name ?? null, role: user?.role ?? null };
  }
}

function cookieOf(request) {
  return /roundel_session=([^;]+)/.exec(request.headers.cookie ?? "")?.[1];
}

function neededRole(method, path) {
  if (/\/setup$|\/configuration/.test(path)) return "setup";
  if (method === "GET") return "view";
  return /\/(calibration|recording|replay|simulation)/.test(path) ? "operate" : "setup";
}

function wrong(code, message) {
  return { error: { code, message } };
}
