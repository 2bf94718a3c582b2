/**
 * Mock server with Roundel's HTTP interface and simulated robots, for developing and testing the
 * dashboard without cameras: `node mock.mjs [port]`.
 *
 * It sends the same content security policy as the real server, so that violations appear in the
 * browser's console.
 */

import { readFile } from "node:fs/promises";
import { createServer } from "node:http";
import { dirname, extname, join, normalize } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";

import { WebSocketServer } from "ws";

import { Calibrator } from "./calibrator.mjs";
import { MockConfiguration } from "./mock-configuration.mjs";
import { encode } from "./encode.mjs";
import { MockAccess } from "./mock-access.mjs";
import { World } from "./world.mjs";

const DASHBOARD = join(dirname(fileURLToPath(import.meta.url)), "../../client/dashboard");
const POLICY =
  "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; connect-src 'self'; worker-src 'self'; form-action 'self'; frame-ancestors 'none'; base-uri 'none'";
/** Calls in the mock server's OpenAPI description. */
const OFFERED = {
  "/api/v1/cameras": { get: {}, post: {} },
  "/api/v1/cameras/{name}": { get: {}, patch: {}, delete: {} },
  "/api/v1/calibration": { get: {}, post: {} },
  "/api/v1/sources/test": { post: {} },
};
const PRINT_SIZES = [{ roundel: "robot", factor: 0.97, deviation: 0.0004, state: "measured", cameras: ["north", "south"] }];
const TYPES = {
  ".html": "text/html; charset=utf-8",
  ".css": "text/css; charset=utf-8",
  ".js": "text/javascript; charset=utf-8",
  ".svg": "image/svg+xml",
};

/**
 * @param {{port?: number, world?: World, calibrator?: Calibrator, configuration?: MockConfiguration, access?: MockAccess | null, protocols?: string[], mostHz?: number}} [options] port 0 takes a free one; access null: an older server without sessions
 * @returns {Promise<{url: string, world: World, closeStreams: () => void, close: () => Promise<void>}>}
 */
export async function startMock({
  port = 0,
  world = new World(),
  calibrator,
  configuration = new MockConfiguration(world),
  access = new MockAccess(),
  protocols = ["roundel.v1.json", "roundel.v1.protobuf"],
  mostHz = 60,
} = {}) {
  calibrator ??= new Calibrator(world.cameras().map((camera) => camera.name));
  const server = createServer((request, response) => {
    answer({ world, calibrator, configuration, access }, request, response).catch((error) => {
      response.writeHead(500).end(String(error));
    });
  });
  // Like the real server: the client's first known subprotocol, or JSON if it names none.
  const handleProtocols = (offered) => [...offered].find((one) => protocols.includes(one)) ?? false;
  const verifyClient = ({ req }, done) => {
    const refusal = access?.refusal(req);
    done(!refusal, refusal?.[0]);
  };
  const sockets = new WebSocketServer({ server, path: "/api/v1/stream", handleProtocols, verifyClient });
  sockets.on("connection", (socket, request) => {
    const query = new URL(request.url, "http://mock").searchParams;
    const rateHz = Math.min(mostHz, Number(query.get("max_rate_hz") ?? mostHz));
    const isBinary = socket.protocol === "roundel.v1.protobuf";
    const send = (message) => socket.send(isBinary ? encode(message) : JSON.stringify(message));
    const timers = [
      setInterval(() => send({ snapshot: world.snapshot() }), 1000 / rateHz),
      setInterval(() => send({ cameras: world.cameras() }), 500),
    ];
    for (const event of world.events.slice(-50)) send({ event });
    send({ cameras: world.cameras() });
    const unsubscribe = world.onEvent((event) => send({ event }));
    socket.on("close", () => {
      timers.forEach(clearInterval);
      unsubscribe();
    });
  });
  await new Promise((resolve) => server.listen(port, "127.0.0.1", resolve));
  return {
    url: `http://127.0.0.1:${server.address().port}/`,
    world,
    closeStreams: () => {
      for (const socket of sockets.clients) socket.terminate();
    },
    close: async () => {
      for (const socket of sockets.clients) socket.terminate();
      server.closeAllConnections();
      await new Promise((resolve) => server.close(resolve));
    },
  };
}

async function bodyOf(request) {
  const chunks = [];
  for await (const chunk of request) chunks.push(chunk);
  return chunks.length > 0 ? JSON.parse(Buffer.concat(chunks).toString()) : null;
}

async function answer({ world, calibrator, configuration, access }, request, response) {
  const { pathname } = new URL(request.url, "http://mock");
  const say = ([status, message, headers]) => {
    response.writeHead(status, { "content-type": "application/json", ...headers }).end(JSON.stringify(message));
  };
  const refusal = access?.refusal(request);
  if (refusal) return say(refusal);
  if (access && pathname === "/api/v1/session") return say(access.answer(request, await bodyOf(request)));
  if (pathname.startsWith("/api/v1/calibration")) {
    return say(calibrator.answer(request.method, pathname.slice("/api/v1/calibration".length), await bodyOf(request)));
  }
  const setup = configuration.answer(request.method, pathname.slice("/api/v1".length), await bodyOf(request));
  if (setup) return say(setup);
  const json = (value) => {
    response.writeHead(200, { "content-type": "application/json" }).end(JSON.stringify(value));
  };
  if (pathname === "/openapi.json") return json({ paths: OFFERED });
  if (pathname === "/api/v1/cameras") return json({ cameras: world.cameras() });
  if (pathname === "/api/v1/objects") return json({ objects: world.objects() });
  if (pathname === "/api/v1/snapshot") return json(world.snapshot());
  if (pathname === "/api/v1/print-sizes") return json({ print_sizes: PRINT_SIZES });
  if (pathname === "/api/v1/info") return json(world.info());
  const frame = /^\/api\/v1\/cameras\/([^/]+)\/frame\.jpg$/.exec(pathname);
  if (frame) {
    const picture = world.picture(decodeURIComponent(frame[1]));
    if (!picture) return response.writeHead(404).end("no such camera");
    return response.writeHead(200, { "content-type": "image/jpeg", "cache-control": "no-store" }).end(picture);
  }
  const path = normalize(pathname === "/" ? "/index.html" : pathname);
  const type = TYPES[extname(path)];
  if (!type || path.includes("..")) return response.writeHead(404).end("not found");
  try {
    const body = await readFile(join(DASHBOARD, path));
    response.writeHead(200, { "content-type": type, "content-security-policy": POLICY }).end(body);
  } catch {
    response.writeHead(404).end("not found");
  }
}

if (process.argv[1] && import.meta.url === pathToFileURL(process.argv[1]).href) {
  const { url } = await startMock({ port: Number(process.argv[2] ?? 7671) });
  console.log(`dashboard with simulated robots: ${url}`);
}
