/** The API page: describes every call in /openapi.json, and sends trial requests. */

import { element, find, setText } from "./base/dom.js";

/** @typedef {Record<string, any>} Json */

/** Longer responses are truncated, characters. */
const MAX_RESPONSE_LENGTH = 20_000;

/**
 * Describes the type of a value, with a link to its schema if it has a name.
 * @param {Json | undefined} schema
 * @returns {Node[]}
 */
function typed(schema) {
  if (!schema) return [document.createTextNode("any")];
  if (schema.$ref) {
    const name = schema.$ref.split("/").at(-1);
    return [element("a", { href: `#shape-${name}` }, [name])];
  }
  const either = schema.oneOf ?? schema.anyOf ?? schema.allOf;
  if (either) return either.flatMap((/** @type {Json} */ one, /** @type {number} */ place) => (place ? [" or ", ...typed(one)] : typed(one)));
  const kind = [schema.type].flat().filter(Boolean).join(" or ") || "any";
  return kind.startsWith("array") ? ["list of ", ...typed(schema.items)] : [kind];
}

/**
 * A table of names, types and descriptions.
 * @param {[string, Node[], string][]} rows
 */
function table(rows) {
  const cells = rows.map(([name, type, text]) =>
    element("tr", {}, [
      element("td", {}, [element("code", {}, [name])]),
      element("td", {}, type),
      element("td", { class: "description" }, [text]),
    ]),
  );
  return element("table", {}, [element("tbody", {}, cells)]);
}

/**
 * A form that sends the request and shows the response.
 * @param {string} method
 * @param {string} path
 * @param {Json[]} parameters
 * @param {boolean} hasBody
 */
function trial(method, path, parameters, hasBody) {
  const fields = parameters.map((one) => {
    const input = element("input", { name: one.name, placeholder: one.example ?? one.description ?? "" });
    return element("label", {}, [element("code", {}, [one.name]), input]);
  });
  const body = element("textarea", { "aria-label": "Body, JSON", placeholder: "JSON" });
  const answer = element("pre", { hidden: "", role: "status" });
  const button = element("button", { type: "submit" }, ["Try it"]);
  const form = element("form", {}, [...fields, ...(hasBody ? [body] : []), button, answer]);
  form.addEventListener("submit", async (event) => {
    event.preventDefault();
    answer.hidden = false;
    setText(answer, "…");
    try {
      setText(answer, await sent(method, path, parameters, form, hasBody ? body : null));
    } catch (error) {
      setText(answer, `Request failed: ${error}`);
    }
  });
  return form;
}

/**
 * @param {string} method
 * @param {string} path
 * @param {Json[]} parameters
 * @param {HTMLElement} form
 * @param {HTMLElement | null} body
 */
async function sent(method, path, parameters, form, body) {
  const query = new URLSearchParams();
  let filled = path;
  for (const one of parameters) {
    const input = form.querySelector(`input[name="${one.name}"]`);
    const value = input instanceof HTMLInputElement ? input.value : "";
    if (one.in === "path") filled = filled.replace(`{${one.name}}`, encodeURIComponent(value));
    else if (value) query.set(one.name, value);
  }
  const address = query.size ? `${filled}?${query}` : filled;
  const text = body instanceof HTMLTextAreaElement ? body.value : undefined;
  const headers = text === undefined ? {} : { "content-type": "application/json" };
  const response = await fetch(address, { method, headers, body: text });
  const kind = response.headers.get("content-type") ?? "";
  if (kind.startsWith("image/")) return `${response.status} ${kind}, ${(await response.blob()).size} bytes`;
  const came = await response.text();
  const shown = kind.startsWith("application/json") ? JSON.stringify(JSON.parse(came), null, 2) : came;
  return `${response.status} ${response.statusText}\n${shown.slice(0, MAX_RESPONSE_LENGTH)}`;
}

/**
 * @param {string} path
 * @param {string} method
 * @param {Json} call
 */
function callPanel(path, method, call) {
  /** @type {Json[]} */
  const parameters = call.parameters ?? [];
  const takes = call.requestBody?.content?.["application/json"]?.schema;
  const parts = [element("p", {}, [[call.summary, call.description].filter(Boolean).join(" ")])];
  if (parameters.length) {
    parts.push(element("h3", {}, ["Parameters"]), table(parameters.map((one) => [one.name, typed(one.schema), one.description ?? ""])));
  }
  if (takes) parts.push(element("h3", {}, ["Body"]), element("p", {}, typed(takes)));
  const answers = Object.entries(call.responses ?? {}).map(([status, one]) => {
    const content = Object.values(one.content ?? {})[0];
    return /** @type {[string, Node[], string]} */ ([status, content?.schema ? typed(content.schema) : [""], one.description ?? ""]);
  });
  parts.push(element("h3", {}, ["Responses"]), table(answers));
  // A WebSocket stream has no single response to show.
  if (!call.responses?.["101"]) parts.push(trial(method.toUpperCase(), path, parameters, Boolean(takes)));
  return element("details", { "data-path": path, "data-method": method }, [
    element("summary", {}, [
      element("span", { class: "method" }, [method.toUpperCase()]),
      element("code", {}, [path]),
      element("span", { class: "description" }, [` ${call.summary ?? ""}`]),
    ]),
    element("div", {}, parts),
  ]);
}

/**
 * @param {string} name
 * @param {Json} schema
 */
function shapePanel(name, schema) {
  const fields = Object.entries(schema.properties ?? {}).map(([field, one]) =>
    /** @type {[string, Node[], string]} */ ([field, typed(one), one.description ?? ""]),
  );
  return element("details", { id: `shape-${name}` }, [
    element("summary", {}, [element("code", {}, [name]), element("span", { class: "description" }, [` ${schema.description ?? ""}`])]),
    element("div", {}, [fields.length ? table(fields) : element("p", {}, typed(schema))]),
  ]);
}

/** Opens the schema that the URL's fragment names. */
function openTarget() {
  const target = location.hash && document.getElementById(location.hash.slice(1));
  if (target instanceof HTMLDetailsElement) {
    target.open = true;
    target.scrollIntoView();
  }
}

async function show() {
  const response = await fetch("openapi.json");
  if (!response.ok) throw new Error(`openapi.json: ${response.status} ${response.statusText}`);
  /** @type {Json} */
  const description = await response.json();
  /** @type {Map<string, HTMLElement[]>} */
  const tags = new Map();
  for (const [path, calls] of Object.entries(description.paths)) {
    for (const [method, call] of Object.entries(/** @type {Json} */ (calls))) {
      const tag = call.tags?.[0] ?? "other";
      tags.set(tag, [...(tags.get(tag) ?? []), callPanel(path, method, call)]);
    }
  }
  for (const [tag, panels] of tags) find("#calls").append(element("h2", {}, [tag]), ...panels);
  const shapes = Object.entries(description.components?.schemas ?? {}).sort(([a], [b]) => (a < b ? -1 : 1));
  find("#shapes").append(...shapes.map(([name, schema]) => shapePanel(name, /** @type {Json} */ (schema))));
  setText(find("#about"), description.info.description);
  addEventListener("hashchange", openTarget);
  openTarget();
}

show().catch((error) => setText(find("#about"), `Cannot load the API description: ${error.message}. Reload the page.`));
