/** The dashboard over TLS, with a self-signed certificate whose key Chromium is configured to trust. */

import assert from "node:assert/strict";
import { execFile } from "node:child_process";
import { createHash, X509Certificate } from "node:crypto";
import { readFile } from "node:fs/promises";
import { join } from "node:path";
import { after, before, describe, test } from "node:test";
import { promisify } from "node:util";

import { launch, PATIENCE_MS } from "./harness.mjs";
import { BINARY, CONFIG, lacking, startLab } from "./lab.mjs";

const TLS = CONFIG.replace("[server]", '[server]\ntls = { certificate = "cert.pem", key = "key.pem", self_signed = true }');

describe("the dashboard over TLS", { skip: lacking }, () => {
  let lab;
  let token;
  /** Trusts the server's key. */
  let trusting;
  /** Trusts the authorities of the system. */
  let strict;
  before(async () => {
    const prepare = async (folder) => {
      const words = ["token", "add", "alice", "--role", "operate", "--config", join(folder, "lab.toml")];
      token = (await promisify(execFile)(BINARY, words)).stdout.trim();
    };
    lab = await startLab(TLS, { prepare });
    const { publicKey } = new X509Certificate(await readFile(join(lab.folder, "cert.pem")));
    const pin = createHash("sha256").update(publicKey.export({ type: "spki", format: "der" })).digest("base64");
    [trusting, strict] = await Promise.all([launch({ flags: [`--ignore-certificate-errors-spki-list=${pin}`] }), launch()]);
  });
  after(async () => {
    await trusting?.close();
    await strict?.close();
    await lab?.close();
  });

  test("loads, signs in with a cookie for TLS only, and streams", async () => {
    assert.match(lab.url, /^https:/);
    const context = await trusting.newContext();
    const page = await context.newPage();
    page.setDefaultTimeout(PATIENCE_MS);
    /** @type {string[]} */
    const complaints = [];
    page.on("console", (message) => {
      if (message.type() === "error" || message.type() === "warning") complaints.push(message.text());
    });
    page.on("pageerror", (error) => complaints.push(String(error)));
    /** Requests that are not encrypted, or go to another server. */
    const plain = [];
    page.on("request", (request) => {
      if (!/^(blob|data):/.test(request.url()) && !request.url().startsWith(lab.url)) plain.push(request.url());
    });
    const sockets = [];
    page.on("websocket", (socket) => sockets.push(socket.url()));

    const response = await page.goto(lab.url);
    const security = await response.securityDetails();
    assert.equal(security.protocol, "TLS 1.3");
    await page.getByRole("dialog", { name: "Sign in" }).waitFor();
    await page.getByRole("radio", { name: "Token" }).check();
    await page.locator("#sign-in-token").fill(token);
    await page.keyboard.press("Enter");
    await page.locator('body[data-phase="live"]').waitFor();
    await page.locator("#object-rows tr").first().waitFor();
    await page.locator('[data-camera-card="door"][data-status="running"]').waitFor();

    const cookies = await context.cookies();
    assert.deepEqual(
      cookies.map(({ name, secure, httpOnly, sameSite }) => ({ name, secure, httpOnly, sameSite })),
      [{ name: "roundel_session", secure: true, httpOnly: true, sameSite: "Lax" }],
    );
    assert.deepEqual(plain, []);
    assert.deepEqual(complaints, []);
    assert.ok(sockets.length > 0);
    for (const url of sockets) assert.ok(url.startsWith(`${lab.url.replace("https:", "wss:")}api/v1/stream`), url);
    await context.close();
  });

  test("is not loaded by a browser that does not know the certificate", async () => {
    const page = await strict.newPage();
    await assert.rejects(page.goto(lab.url), /ERR_CERT_AUTHORITY_INVALID/);
    await page.close();
  });
});
