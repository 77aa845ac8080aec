// Runs the conformance table with the package for browsers. run.py specifies its input and output.
//   node client.mjs WEB      WEB: the folder build/web
import { readFileSync } from "node:fs";
import { resolve } from "node:path";
import { createInterface } from "node:readline";
import { pathToFileURL } from "node:url";

const { crosses, digits, displacementOf, hashOf, mapVertices, motionOf, moved, readCar, skin, Surface, turn, turned, wheelMotions } = await import(pathToFileURL(resolve(process.argv[2], "dist/index.js")));

// A mesh of the game's own in the coordinates of the source, which the car turns and scales only, and in the car's frame.
function bind(car, bytes) {
  const m = car.sourceToCar, scale = Math.hypot(m[0], m[4], m[8]), floats = new Float32Array(bytes.buffer.slice(bytes.byteOffset + 4, bytes.byteOffset + bytes.length));
  const rows = Array.from({ length: floats.length / 9 }, (_, i) => [...floats.subarray(9 * i, 9 * i + 9)]);
  const to = (v, by) => [0, 1, 2].map((k) => (m[4 * k] * v[0] + m[4 * k + 1] * v[1] + m[4 * k + 2] * v[2]) * by);
  const from = (v, by) => [0, 1, 2].map((k) => (m[k] * v[0] + m[4 + k] * v[1] + m[8 + k] * v[2]) * by);
  const position = Float32Array.from(rows.flatMap((row) => to(row, 1).map((x, k) => x + m[4 * k + 3])));
  const normal = Float32Array.from(rows.flatMap((row) => to(row.slice(3, 6), 1 / scale)));
  const tangent = Float32Array.from(rows.flatMap((row) => to(row.slice(6, 9), 1 / scale)));
  const mapping = mapVertices(car, position, normal), now = new Float32Array(car.vertex.length);
  const said = { outcome: "mapped", vertices: rows.length, on_vertices: mapping.onVertices, farthest: Math.max(...mapping.distance) };
  const print = (surface) => {
    skin(car, surface, now);
    const cross = crosses(car, now), motions = wheelMotions(car, surface);
    const own = rows.map((row, i) => {
      const by = [0, 0, 0], direction = [0, 0, 0];
      displacementOf(mapping, i, car, now, by, 0);
      const away = from(by, 1 / scale ** 2), out = row.slice(0, 3).map((x, k) => x + away[k]);
      const wheel = motions[car.vertexPart[mapping.corner[3 * i]]];
      for (const of of [normal, tangent]) {
        turn(mapping, i, cross, of, direction, 0);
        out.push(...from(wheel ? turned(wheel.turn, [...of.subarray(3 * i, 3 * i + 3)]) : direction, 1 / scale));
      }
      return out;
    });
    const poses = car.parts.map((part, i) => {
      const motion = motionOf(car.around[i], car.nodeRest, surface);
      return [...moved(motion, part.position), ...product(motion.turn, part.orientation)];
    });
    return { own, poses };
  };
  return { said, print };
}

const product = ([x, y, z, w], [a, b, c, d]) => {
  const q = [w * a + x * d + y * c - z * b, w * b - x * c + y * d + z * a, w * c + x * b - y * a + z * d, w * d - x * a - y * b - z * c];
  return q[3] < 0 ? q.map((each) => -each) : q;
};

let surface = new Surface(), car = null, own = null;
for await (const line of createInterface({ input: process.stdin })) {
  if (!line) {
    surface = new Surface();
    car = own = null;
    continue;
  }
  const bytes = new Uint8Array(readFileSync(line));
  if (line.endsWith(".car")) {
    car = readCar(bytes, digits(hashOf(bytes)));
    console.log(JSON.stringify({ outcome: "held" }));
    continue;
  }
  if (line.endsWith(".own")) {
    own = bind(car, bytes);
    console.log(JSON.stringify(own.said));
    continue;
  }
  const outcome = line.endsWith(".keyframe") ? surface.takeKeyframe(bytes) : surface.takeDelta(bytes);
  const said = { outcome: outcome === "whole" ? "applied" : outcome };
  const { quanta, tick, hash, quantum } = surface;
  if (quanta.length > 0)
    Object.assign(said, {
      tick: Number(tick), hash: digits(hash), nodes: quanta.length / 3, quantum_um: Math.round(1e6 * quantum),
      sum: quanta.reduce((sum, each) => sum + each, 0), moment: quanta.reduce((sum, each, k) => sum + k * each, 0),
    });
  if (own && quanta.length > 0) Object.assign(said, own.print(surface));
  console.log(JSON.stringify(said));
}
