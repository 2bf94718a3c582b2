#!/usr/bin/env bash
# Rebuilds client/dashboard/vendor from npm packages and the .proto files. To take a newer version, change it here and in
# vendor/README.md.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
out=$(cd "$here/../../client/dashboard/vendor" && pwd)
proto=$(cd "$here/../../proto" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
echo '{"private":true}' >package.json
npm install --silent --no-audit --no-fund three@0.187.0 uplot@1.6.32 protobufjs@8.8.1 protobufjs-cli@2.7.1 esbuild@0.25.12
cat >three.js <<'JS'
export {
  BoxGeometry, BufferAttribute, BufferGeometry, CircleGeometry, Color, DoubleSide, DynamicDrawUsage,
  InstancedBufferAttribute, InstancedMesh, LineBasicMaterial, LineSegments, Matrix4, Mesh, MeshBasicMaterial,
  PerspectiveCamera, Quaternion, RingGeometry, Scene, SphereGeometry, Vector3, WebGLRenderer,
} from "three";
JS
echo 'export { default } from "uplot";' >uplot.js
cp "$here/protobuf-module.mjs" .
node protobuf-module.mjs "$proto" >messages.js
echo 'export { roundel } from "./messages.js";' >protobuf.js
# Without long.js, 64-bit integers are decoded to numbers.
echo 'export default null;' >no-long.js
for name in three uplot protobuf; do
  npx esbuild $name.js --bundle --minify --format=esm --legal-comments=none --log-level=warning --alias:long=./no-long.js --outfile="$out/$name.js"
done
cp node_modules/three/LICENSE "$out/three.LICENSE"
cp node_modules/uplot/LICENSE "$out/uplot.LICENSE"
cp node_modules/protobufjs/LICENSE "$out/protobuf.LICENSE"
cp node_modules/uplot/dist/uPlot.min.css "$out/uplot.css"
