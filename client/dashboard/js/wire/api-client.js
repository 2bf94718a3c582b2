/** Calls the server's REST API and returns its answer or its error. */

/**
 * @typedef {object} ApiError
 * @property {number} status 0: no answer came
 * @property {string} field what the error is about, as the API calls it; empty: none of the fields
 * @property {string} message without the field's name
 */
/** @typedef {{answer: any, error: null} | {answer: null, error: ApiError}} Reply */

/**
 * @param {string} method
 * @param {string} path below api/v1/
 * @param {object} [body]
 * @returns {Promise<Reply>}
 */
export async function callApi(method, path, body) {
  const headers = body === undefined ? undefined : { "content-type": "application/json" };
  return answered(() => fetch(`api/v1/${path}`, { method, headers, body: body && JSON.stringify(body), cache: "no-store" }), (response) => response.json());
}

/**
 * A file: a picture, a page.
 * @param {string} path below api/v1/
 * @returns {Promise<Reply>} the answer is a Blob
 */
export function fetchFile(path) {
  return answered(() => fetch(`api/v1/${path}`, { cache: "no-store" }), (response) => response.blob());
}

/**
 * @param {() => Promise<Response>} send
 * @param {(response: Response) => Promise<any>} read
 * @returns {Promise<Reply>}
 */
async function answered(send, read) {
  try {
    const response = await send();
    if (response.ok) return { answer: await read(response), error: null };
    const said = await response.json().catch(() => null);
    return { answer: null, error: readApiError(response.status, said?.error?.message) };
  } catch {
    return { answer: null, error: { status: 0, field: "", message: "No answer from the server. Try again." } };
  }
}

/**
 * An error begins with the field that it is about, if it is about one.
 * @param {number} status
 * @param {string} [message]
 * @returns {ApiError}
 */
export function readApiError(status, message = `The server answers with ${status}.`) {
  const named = /^([a-z_]+): (.*)$/s.exec(message);
  return named ? { status, field: named[1], message: named[2] } : { status, field: "", message };
}
