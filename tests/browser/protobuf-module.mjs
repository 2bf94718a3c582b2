/**
 * Loads the messages of the stream from the .proto files. `node protobuf-module.mjs PROTO_FOLDER` writes their decoder,
 * static code without `eval`, for vendor.sh.
 */

import { createRequire } from "node:module";
import { join } from "node:path";
import { pathToFileURL } from "node:url";

import protobuf from "protobufjs";

/** Fields that the page does not read. Its decoder skips them as it skips unknown fields. */
const UNUSED = {
  StreamMessage: ["observations"],
  ObjectState: ["angular_velocity", "velocity_covariance", "acceleration"],
  Camera: ["pose_covariance"],
  Intrinsics: ["distortion"],
};

/** All types of `roundel.v1` that a StreamMessage can hold. @param {string} folder with roundel/v1 */
export function loadMessages(folder) {
  const root = new protobuf.Root();
  root.resolvePath = (_origin, path) => (path.startsWith(folder) ? path : join(folder, path));
  return root.loadSync("roundel/v1/stream.proto", { keepCase: true }).resolveAll();
}

/** StreamMessage and the types that it refers to, without the unused fields. @param {string} folder */
export function loadUsedMessages(folder) {
  const root = loadMessages(folder);
  const messages = root.lookup("roundel.v1");
  for (const [type, fields] of Object.entries(UNUSED)) {
    for (const name of fields) {
      const field = messages.lookupType(type).fields[name];
      field.partOf?.remove(field);
      field.parent.remove(field);
    }
  }
  const used = new Set();
  const visit = (type) => {
    if (!type || used.has(type)) return;
    used.add(type);
    for (const field of type.fieldsArray ?? []) visit(field.resolvedType);
  };
  visit(messages.lookupType("StreamMessage"));
  for (const type of messages.nestedArray.filter((one) => !used.has(one))) messages.remove(type);
  return root;
}

if (process.argv[1] && import.meta.url === pathToFileURL(process.argv[1]).href) {
  const generate = createRequire(import.meta.url)("protobufjs-cli/targets/static-module");
  const options = { wrap: "esm", es6: true, decode: true, beautify: true, "keep-case": true, "force-number": true };
  generate(loadUsedMessages(process.argv[2]), options, (error, code) => {
    if (error) throw error;
    process.stdout.write(code);
  });
}
