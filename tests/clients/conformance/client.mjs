// Runs the conformance table with the package for browsers. run.py specifies its input and output.
//   node client.mjs WEB      WEB: the folder build/web
import { readFileSync } from "node:fs";
import { resolve } from "node:path";
import { createInterface } from "node:readline";
import { pathToFileURL } from "node:url";

const { digits, Surface } = await import(pathToFileURL(resolve(process.argv[2], "dist/index.js")));

let surface = new Surface();
for await (const line of createInterface({ input: process.stdin })) {
  if (!line) {
    surface = new Surface();
    continue;
  }
  const bytes = new Uint8Array(readFileSync(line));
  const outcome = line.endsWith(".keyframe") ? surface.takeKeyframe(bytes) : surface.takeDelta(bytes);
  const said = { outcome: outcome === "whole" ? "applied" : outcome };
  const { quanta, tick, hash, quantum } = surface;
  if (quanta.length > 0)
    Object.assign(said, {
      tick: Number(tick), hash: digits(hash), nodes: quanta.length / 3, quantum_um: Math.round(1e6 * quantum),
      sum: quanta.reduce((sum, each) => sum + each, 0), moment: quanta.reduce((sum, each, k) => sum + k * each, 0),
    });
  console.log(JSON.stringify(said));
}
