// Bundle the report's scripts into ../assets: `npm ci && node build.mjs`, or `make viewer`.

import { createHash } from "node:crypto";
import { copyFileSync, readdirSync, readFileSync, writeFileSync } from "node:fs";
import { build } from "esbuild";

const sources = ["build.mjs", "package-lock.json", "package.json", ...readdirSync("src").sort().map((name) => `src/${name}`)];
const digest = createHash("sha256");
for (const name of sources) digest.update(`${name}\n`).update(readFileSync(name));
const banner = `/* sources ${digest.digest("hex")} */`;

for (const name of ["page", "viewer"]) {
  const result = await build({
    entryPoints: [`src/${name}.js`],
    bundle: true,
    minify: true,
    format: "iife",
    target: ["es2022"],
    legalComments: "none",
    write: false,
  });
  const notice = name === "viewer" ? "/* contains three.js, MIT licence, see three.LICENSE.txt */" : "";
  writeFileSync(`../assets/${name}.js`, [banner, notice, result.outputFiles[0].text].filter(Boolean).join("\n"));
}
copyFileSync("node_modules/three/LICENSE", "../assets/three.LICENSE.txt");
