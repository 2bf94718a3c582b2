#!/usr/bin/env bash
# Makes client/dashboard/vendor anew from the packages of npm. To take a newer version, change it here and in vendor/README.md.
set -euo pipefail
out=$(cd "$(dirname "$0")/../../client/dashboard/vendor" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"
echo '{"private":true}' >package.json
npm install --silent --no-audit --no-fund three@0.187.0 uplot@1.6.32 esbuild@0.25.12
cat >three.js <<'JS'
export {
  BoxGeometry, BufferAttribute, BufferGeometry, CircleGeometry, Color, DoubleSide, DynamicDrawUsage,
  InstancedBufferAttribute, InstancedMesh, LineBasicMaterial, LineSegments, Matrix4, Mesh, MeshBasicMaterial,
  PerspectiveCamera, Quaternion, RingGeometry, Scene, SphereGeometry, Vector3, WebGLRenderer,
} from "three";
JS
echo 'export { default } from "uplot";' >uplot.js
for name in three uplot; do
  npx esbuild $name.js --bundle --minify --format=esm --legal-comments=none --log-level=warning --outfile="$out/$name.js"
  cp node_modules/$name/LICENSE "$out/$name.LICENSE"
done
cp node_modules/uplot/dist/uPlot.min.css "$out/uplot.css"
