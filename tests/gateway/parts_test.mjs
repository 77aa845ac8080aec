// Tests that TypeScript sees a part where C++ sees it: the numbers below are also in tests/viewer/parts_test.cpp.
//   node tests/gateway/parts_test.mjs WEB
// WEB: the folder build/web.
import assert from "node:assert/strict";
import { resolve } from "node:path";
import { pathToFileURL } from "node:url";

const { moved, motionOf, nodesAround, turned } = await import(pathToFileURL(resolve(process.argv[2], "dist/index.js")));

// A generator that every language can have: Park and Miller's.
let state = 1;
const draw = (below) => (state = (state * 16807) % 2147483647) % below;
const rest = Float32Array.from({ length: 3 * 200 }, () => draw(2001) / 1000 - 1);
const quanta = Int16Array.from({ length: 3 * 200 }, () => draw(401) - 200);
const part = { name: "wheel", kind: "wheel", position: [0.25, -0.5, 0.125], orientation: [0, 0, 0, 1], radius: 0.5, width: 0.25 };
const around = nodesAround(part, rest);
const motion = motionOf(around, rest, { quanta, quantum: 0.0009765625 });
const near = (found, wanted) => found.forEach((x, i) => assert.ok(Math.abs(x - wanted[i]) < 1e-6, `${found} is not ${wanted}`));

assert.equal(around.node.length, 42);
near(motion.turn, [-0.0649238014, -0.0487328136, -0.0249397659, 0.9963874853]);
near(moved(motion, part.position), [0.2294125792, -0.4571187885, 0.0960060809]);

// At rest nothing moves, to the last bit; a turn of the whole turns the part.
assert.deepEqual(moved(motionOf(around, rest, { quanta: new Int16Array(600), quantum: 1 }), part.position), part.position);
const turn = [0, 0, Math.sin(0.4), Math.cos(0.4)], whole = new Int16Array(600);
for (let i = 0; i < 200; ++i) {
  const from = [...rest.subarray(3 * i, 3 * i + 3)];
  turned(turn, from).forEach((x, axis) => (whole[3 * i + axis] = Math.round((x - from[axis]) / 0.0001)));
}
const found = motionOf(around, rest, { quanta: whole, quantum: 0.0001 });
found.turn.forEach((x, i) => assert.ok(Math.abs(x - turn[i]) < 1e-4, `${found.turn} is not ${turn}`));
