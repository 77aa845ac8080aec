// Makes the page, one file that needs nothing beside it: the bundle of src/page.ts and the style in the frame of src/page.html.
//   node build.mjs OUTPUT.html
import { readFileSync, writeFileSync } from "node:fs";
import { build } from "esbuild";

const { outputFiles } = await build({
  entryPoints: ["src/page.ts"], bundle: true, format: "esm", target: "es2022", minify: true, legalComments: "inline", write: false,
});
const fill = { "/* page.css */": readFileSync("src/page.css", "utf8"), "/* page.js */": outputFiles[0].text };
const page = readFileSync("src/page.html", "utf8").replace(/\/\* page\.(css|js) \*\//g, (hole) => fill[hole]);
writeFileSync(process.argv[2], page);
