/**
 * What a hostile page tries: each function runs in the page and returns what the page has learned. A page sees neither the
 * status nor the body of a response that it may not read.
 */

/**
 * @typedef {{method: string, path: string, body?: object}} Call
 * @typedef {{call: string, way: string, read: string | null}} Attempt
 */

/**
 * Sends each call in every way that a page has: as the API describes it, and in the ways that need no preflight.
 * @param {{base: string, calls: Call[], credentials: RequestCredentials}} options
 * @returns {Promise<Attempt[]>}
 */
export async function sendCalls({ base, calls, credentials }) {
  const attempts = [];
  const read = async (url, options) => {
    try {
      return await (await fetch(url, options)).text();
    } catch {
      return null;
    }
  };
  const xhr = (url, body) =>
    new Promise((resolve) => {
      const request = new XMLHttpRequest();
      request.open("POST", url);
      request.withCredentials = credentials === "include";
      request.onload = () => resolve(request.responseText);
      request.onerror = () => resolve(null);
      request.send(body);
    });
  /** The body becomes `{…,"x":"="}`: valid JSON, sent by a form. */
  const form = (url, body, enctype) =>
    new Promise((resolve) => {
      const frame = document.createElement("iframe");
      frame.name = `frame${document.forms.length}`;
      const one = Object.assign(document.createElement("form"), { method: "post", action: url, enctype, target: frame.name });
      const field = document.createElement("input");
      field.name = `${body.slice(0, -1)},"x":"`;
      field.value = '"}';
      one.append(field);
      document.body.append(frame, one);
      frame.addEventListener("load", () => {
        let text = null;
        try {
          text = frame.contentDocument?.body.innerText || null;
        } catch {}
        resolve(text);
      });
      one.submit();
    });
  for (const { method, path, body } of calls) {
    const [url, text] = [base + path, JSON.stringify(body ?? {})];
    const note = (way, content) => attempts.push({ call: `${method} ${path}`, way, read: content || null });
    const described = body && { headers: { "content-type": "application/json" }, body: text };
    note("described", await read(url, { method, credentials, ...described }));
    if (method !== "POST") continue;
    const open = { method, mode: "no-cors", credentials };
    note("no-cors text", await read(url, { ...open, body: text }));
    const urlencoded = { "content-type": "application/x-www-form-urlencoded" };
    note("no-cors urlencoded", await read(url, { ...open, headers: urlencoded, body: text }));
    // The browser removes this content type from a request without CORS.
    note("no-cors json", await read(url, { ...open, headers: { "content-type": "application/json" }, body: text }));
    note("readable text", await read(url, { method, credentials, body: text }));
    note("XHR", await xhr(url, text));
    navigator.sendBeacon(url, text);
    navigator.sendBeacon(url, new Blob([text], { type: "application/json" }));
    for (const enctype of ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data"]) {
      note(`form ${enctype}`, await form(url, text, enctype));
    }
  }
  return attempts;
}

/**
 * Reads paths as data, without CORS, as a script and as a picture.
 * @param {{base: string, paths: string[], picture: string, credentials: RequestCredentials}} options
 * @returns {Promise<Attempt[]>}
 */
export async function readPaths({ base, paths, picture, credentials }) {
  const attempts = [];
  const note = (path, way, read) => attempts.push({ call: `GET ${path}`, way, read: read || null });
  for (const path of paths) {
    for (const mode of ["cors", "no-cors"]) {
      try {
        note(path, mode, await (await fetch(base + path, { mode, credentials })).text());
      } catch {
        note(path, mode, null);
      }
    }
    await new Promise((resolve) => {
      const script = document.createElement("script");
      script.onload = script.onerror = resolve;
      script.src = base + path;
      document.body.append(script);
    });
  }
  const image = new Image();
  const isShown = await new Promise((resolve) => {
    image.onload = () => resolve(true);
    image.onerror = () => resolve(false);
    image.src = base + picture;
  });
  let pixels = null;
  if (isShown) {
    const canvas = Object.assign(document.createElement("canvas"), { width: 8, height: 8 });
    canvas.getContext("2d").drawImage(image, 0, 0, 8, 8);
    try {
      pixels = canvas.toDataURL();
    } catch {}
  }
  note(picture, "shown", isShown ? "the picture" : null);
  note(picture, "pixels", pixels);
  return attempts;
}

/**
 * Opens the WebSocket as text, as protobuf, and with a request in a message.
 * @param {{base: string}} options
 * @returns {Promise<number>} messages received
 */
export async function openSockets({ base }) {
  const open = (protocols) =>
    new Promise((resolve) => {
      const socket = new WebSocket(`${base.replace("http", "ws")}/api/v1/stream`, protocols);
      socket.onopen = () => socket.send(JSON.stringify({ snapshots: {}, cameras: true, events: true }));
      socket.onmessage = () => {
        socket.close();
        resolve(1);
      };
      socket.onclose = () => resolve(0);
    });
  return (await open([])) + (await open(["roundel.v1.protobuf"]));
}
