/**
 * An attacker's web server, and a proxy in front of Roundel that logs what browsers send to it. Requests that a page may
 * not read, or that a preflight prevents, are invisible to the page, but not to the proxy.
 */

import { createServer, request as forward } from "node:http";

const BLANK = "<!doctype html><title>Nice pictures</title><body></body>";
/** Path of the attacker's page. */
export const PAGE = "/pictures.html";

/**
 * @typedef {{method: string, path: string, host: string, origin: string | undefined, contentType: string | undefined,
 * hasCookie: boolean, isUpgrade: boolean, status: number}} Logged
 */

async function listen(server) {
  await new Promise((resolve) => server.listen(0, "127.0.0.1", resolve));
  return server.address().port;
}

/** Serves the attacker's page at any path and for any name. */
export async function startAttacker() {
  const server = createServer((_, response) => response.setHeader("content-type", "text/html").end(BLANK));
  const port = await listen(server);
  return {
    port,
    close: () => {
      server.closeAllConnections();
      return new Promise((resolve) => server.close(resolve));
    },
  };
}

/**
 * Passes requests on with all their headers. With DNS rebinding, the attacker's page comes from the same host and port as
 * Roundel: the proxy answers `PAGE` as the attacker's server did before the name changed its address.
 * @param {string} url
 */
export async function startLoggingProxy(url) {
  const { hostname, port: target } = new URL(url);
  /** @type {Logged[]} */
  const log = [];
  const entry = ({ method, url: path, headers }, isUpgrade) => {
    const { host, origin, cookie } = headers;
    const all = { method, path, host, origin, contentType: headers["content-type"], hasCookie: cookie !== undefined, isUpgrade, status: 0 };
    log.push(all);
    return all;
  };
  const options = ({ method, url: path, headers }) => ({ hostname, port: target, method, path, headers, agent: false });

  const server = createServer((request, response) => {
    if (request.url === PAGE) return response.setHeader("content-type", "text/html").end(BLANK);
    const logged = entry(request, false);
    const far = forward(options(request), (answer) => {
      logged.status = answer.statusCode;
      response.writeHead(answer.statusCode, answer.headers);
      answer.pipe(response);
    });
    far.on("error", () => response.destroy());
    response.on("close", () => far.destroy());
    return request.pipe(far);
  });
  server.on("upgrade", (request, socket, head) => {
    const logged = entry(request, true);
    const far = forward(options(request));
    const lines = ({ statusCode, statusMessage, headers }) => {
      logged.status = statusCode;
      const fields = Object.entries(headers).map(([name, value]) => `${name}: ${value}\r\n`);
      return `HTTP/1.1 ${statusCode} ${statusMessage}\r\n${fields.join("")}\r\n`;
    };
    far.on("upgrade", (answer, farSocket) => {
      socket.write(lines(answer));
      farSocket.on("error", () => socket.destroy());
      socket.on("close", () => farSocket.destroy());
      farSocket.pipe(socket).pipe(farSocket);
    });
    far.on("response", (answer) => {
      socket.write(lines(answer));
      answer.pipe(socket);
    });
    far.on("error", () => socket.destroy());
    socket.on("error", () => far.destroy());
    far.end(head);
  });
  const port = await listen(server);
  return {
    port,
    url: `http://127.0.0.1:${port}`,
    log,
    close: () => {
      server.closeAllConnections();
      return new Promise((resolve) => server.close(resolve));
    },
  };
}
