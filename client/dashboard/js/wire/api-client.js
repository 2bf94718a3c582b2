/** Calls the server's REST API and returns its answer or its error. */

/**
 * @typedef {object} ApiError
 * @property {number} status 0: no response
 * @property {string} field API name of the field with the error; empty if it concerns no field
 * @property {string} message without the field's name
 */
/** @typedef {{answer: any, error: null} | {answer: null, error: ApiError}} Reply */

const UNAUTHENTICATED = 401;
/** In place of the server's message, which is for programs. Forms show it after the next sign-in. */
const SIGNED_OUT = "The session had ended. Try again.";

/** How requests depend on the sign-in, which sets both. */
export const access = {
  /** Requests wait for it: pending while the page asks for credentials. @type {Promise<void>} */
  ready: Promise.resolve(),
  /** Called when a request is refused because it has no valid credentials. */
  onRefused: () => {},
};

/**
 * @param {string} path below api/v1/
 * @param {RequestInit} [options]
 */
export async function request(path, options) {
  await access.ready;
  const response = await fetch(`api/v1/${path}`, { cache: "no-store", ...options });
  if (response.status === UNAUTHENTICATED) access.onRefused();
  return response;
}

/**
 * @param {string} method
 * @param {object} [body] sent as JSON
 * @returns {RequestInit}
 */
export function requestOptions(method, body) {
  const headers = body === undefined ? undefined : { "content-type": "application/json" };
  return { method, headers, body: body && JSON.stringify(body), cache: "no-store" };
}

/**
 * @param {string} method
 * @param {string} path below api/v1/
 * @param {object} [body]
 * @returns {Promise<Reply>}
 */
export async function callApi(method, path, body) {
  return reworded(await answered(() => request(path, requestOptions(method, body))));
}

/**
 * Requests a file, such as a picture.
 * @param {string} path below api/v1/
 * @returns {Promise<Reply>} the answer is a Blob
 */
export async function fetchFile(path) {
  return reworded(await answered(() => request(path), (response) => response.blob()));
}

/** @param {Reply} reply @returns {Reply} */
function reworded(reply) {
  return reply.error?.status === UNAUTHENTICATED ? { answer: null, error: { ...reply.error, message: SIGNED_OUT } } : reply;
}

/**
 * @param {() => Promise<Response>} send
 * @param {(response: Response) => Promise<any>} [read]
 * @returns {Promise<Reply>}
 */
export async function answered(send, read = (response) => response.json()) {
  try {
    const response = await send();
    if (response.ok) return { answer: await read(response), error: null };
    const body = await response.json().catch(() => null);
    return { answer: null, error: readApiError(response.status, body?.error?.message) };
  } catch {
    return { answer: null, error: { status: 0, field: "", message: "No response from the server. Try again." } };
  }
}

/**
 * Parses an error message. If it concerns a field, it begins with the field's name.
 * @param {number} status
 * @param {string} [message]
 * @returns {ApiError}
 */
export function readApiError(status, message = `The server responded with status ${status}.`) {
  const named = /^([a-z_]+): (.*)$/s.exec(message);
  return named ? { status, field: named[1], message: named[2] } : { status, field: "", message };
}
