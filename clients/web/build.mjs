// Makes the page, one file that needs nothing beside it: the bundle of src/page/page.ts and the style in the frame of
// src/page/page.html. No other script runs in it, which its policy names by hash, wherever it is served.
//   node build.mjs OUTPUT.html
import { createHash } from "node:crypto";
import { readFileSync, writeFileSync } from "node:fs";
import { build } from "esbuild";

const { outputFiles } = await build({
  entryPoints: ["src/page/page.ts"], bundle: true, format: "esm", target: "es2022", minify: true, legalComments: "inline", write: false,
});
const script = outputFiles[0].text, hash = createHash("sha256").update(script).digest("base64");
const fill = { "/* page.css */": readFileSync("src/page/page.css", "utf8"), "/* page.js */": script, "/* page.hash */": hash };
const page = readFileSync("src/page/page.html", "utf8").replace(/\/\* page\.(css|js|hash) \*\//g, (hole) => fill[hole]);
writeFileSync(process.argv[2], page);
