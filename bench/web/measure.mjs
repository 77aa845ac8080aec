// Implements bench/web/run: crumple_load is the server and the host, `crumple view` the gateway, Chromium the browser. It measures the
// time of functions that the page calls anyway, so the page needs no code for it.
//   node bench/web/measure.mjs CAR SECONDS
import { spawn } from "node:child_process";
import { existsSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { resolve } from "node:path";
import { pathToFileURL } from "node:url";

const [car, seconds] = [process.argv[2], Number(process.argv[3])];
const cars = { crashing: 4, driving: 4, asleep: 12 };
const warm = 5; // s until shaders and functions are compiled
const drawn = 15; // s with drawing; the rest runs without drawing, because here the processor would draw
const settles = 12; // s until the page draws as little as it can, and the browser no longer queues frames in advance
const patience = 120; // s
const out = "build/bench/web";
const require = createRequire(pathToFileURL(resolve("build/web/package.json")));
const { chromium } = require("playwright-core"), { McapStreamReader } = require("@mcap/core"), { decompress } = require("lz4js");

const children = [];
function start(program, ...options) {
  const child = spawn(program, options.map(String), { stdio: ["ignore", "pipe", "inherit"] });
  const started = { child, text: "", ended: new Promise((ended) => child.on("exit", ended)) };
  child.stdout.on("data", (data) => (started.text += data));
  children.push(child);
  return started;
}
async function until(what, condition) {
  for (const end = Date.now() + 1000 * patience; Date.now() < end; await new Promise((wait) => setTimeout(wait, 50))) {
    const value = condition();
    if (value) return value;
  }
  throw new Error(`did not come within ${patience} s: ${what}`);
}

/** Runs in the page before its own code: measures the time of each frame, and can switch off drawing. */
function watchFrames() {
  for (const name of ["drawElements", "drawArrays", "drawElementsInstanced", "drawArraysInstanced", "clear"]) {
    const draw = WebGL2RenderingContext.prototype[name];
    WebGL2RenderingContext.prototype[name] = function (...what) {
      if (!window.measured.blank) draw.apply(this, what);
    };
  }
  const request = window.requestAnimationFrame.bind(window);
  window.measured = { frames: [], batches: [], held: [], rendering: 0, on: false, blank: true };
  window.requestAnimationFrame = (call) => request((now) => {
    const measured = window.measured, from = performance.now();
    measured.rendering = 0;
    call(now);
    const to = performance.now();
    if (!measured.on || !measured.rendering) return; // nothing was drawn
    measured.frames.push({ from, all: to - from, rendering: measured.rendering });
    for (const one of measured.held.slice(measured.drawn)) one.drawn = performance.timeOrigin + to;
    measured.drawn = measured.held.length;
  });
}

/** Runs in the page: measures the functions that it calls, and the arrival of each surface. */
function watchCalls() {
  const { renderer, live } = window.crumple, { measured } = window;
  const render = renderer.render.bind(renderer), take = live.take.bind(live), ticks = new Map();
  renderer.render = (...what) => {
    const from = performance.now();
    render(...what);
    measured.rendering += performance.now() - from;
  };
  live.take = (entries) => {
    const from = performance.now();
    take(entries);
    const to = performance.now();
    if (!measured.on) return;
    measured.batches.push(to - from);
    for (const { id, surface } of live.cars.values()) {
      if (ticks.get(id) !== surface.tick && ticks.has(id)) measured.held.push({ car: id, tick: Number(surface.tick), held: performance.timeOrigin + to });
      ticks.set(id, surface.tick);
    }
  };
  measured.drawn = 0;
}

/** The time at which the server had done each tick, ms. */
function readTicks(file) {
  const reader = new McapStreamReader({ decompressHandlers: { lz4: (data, size) => decompress(data, Number(size)) } });
  const ticks = new Map(), channels = new Set();
  reader.append(readFileSync(file));
  for (let record; (record = reader.nextRecord()); ) {
    if (record.type === "Channel" && record.topic.endsWith("/tick")) channels.add(record.id);
    if (record.type === "Message" && channels.has(record.channelId)) ticks.set(record.sequence, Number(record.logTime) / 1e6);
  }
  return ticks;
}

function shares(values) {
  const sorted = values.filter(Number.isFinite).sort((a, b) => a - b), at = (share) => sorted[Math.min(sorted.length - 1, Math.floor(share * sorted.length))];
  return { p50: at(0.5), p99: at(0.99), most: sorted.at(-1), count: sorted.length };
}

async function watch(page, seconds, blank) {
  await page.evaluate((blank) => Object.assign(window.measured, { blank, on: true, frames: [], batches: [], held: [], drawn: 0 }), blank);
  await page.waitForTimeout(1000 * seconds);
  const { frames, batches, held } = await page.evaluate(() => Object.assign(window.measured, { on: false }));
  return {
    frames_a_second: frames.length / seconds,
    frame: shares(frames.slice(1).map(({ from }, i) => from - frames[i].from)),
    our_code: shares(frames.map(({ all, rendering }) => all - rendering)),
    render_call: shares(frames.map(({ rendering }) => rendering)),
    batch: shares(batches),
    held,
  };
}

async function main() {
  rmSync(out, { recursive: true, force: true });
  const counts = Object.entries(cars).flatMap(([kind, count]) => [`--${kind}`, count]);
  const load = start("build/bench/crumple_load", "--car", car, "--out", out, ...counts, "--viewers", 1, "--seconds", seconds + 2 * (drawn + settles) + warm + 30);
  const log = `${out}/server.log`;
  const endpoint = await until("the server", () => existsSync(log) && /(tcp\/[\d.:]+),/.exec(readFileSync(log, "utf8"))?.[1]);
  const gateway = start("build/crumple", "view", "--connect", endpoint, "--scene", "load", "--listen", "127.0.0.1:0");
  const url = await until("the gateway", () => /(http:\S+)/.exec(gateway.text)?.[1]);
  const path = process.env.PATH.split(":").map((folder) => `${folder}/chromium-headless-shell`).find(existsSync);
  const browser = await chromium.launch({ executablePath: path, args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"] });
  const page = await browser.newPage({ viewport: { width: 1280, height: 720 } });
  await page.addInitScript(watchFrames);
  await page.goto(url);
  const all = Object.values(cars).reduce((sum, count) => sum + count, 0);
  await page.waitForFunction((count) => [...window.crumple.shown.values()].filter(({ mesh }) => mesh).length === count, all, { timeout: 1000 * patience });
  await page.evaluate(watchCalls);
  await page.waitForTimeout(1000 * warm);
  const session = await page.context().newCDPSession(page);
  const memory = async () => {
    await session.send("HeapProfiler.collectGarbage");
    const { usedSize, backingStorageSize } = await session.send("Runtime.getHeapUsage");
    return (usedSize + backingStorageSize) / 1e6;
  };
  const before = await memory();
  if (process.env.PROFILE) {
    await session.send("Profiler.enable");
    await session.send("Profiler.start");
  }
  const { held, ...blank } = await watch(page, seconds, true);
  if (process.env.PROFILE) writeFileSync(process.env.PROFILE, JSON.stringify((await session.send("Profiler.stop")).profile));
  const after = await memory();
  // Drawing is measured last, because frames that are not drawn yet delay the next measurement. First in full quality, then as
  // the page chooses.
  const watchPixels = async () => {
    await page.keyboard.press("f");
    await page.evaluate(() => (window.measured.blank = false));
    await page.waitForTimeout(1000 * settles);
    const { held: _, ...measured } = await watch(page, drawn, false);
    return measured;
  };
  const software = await watchPixels(), eased = await watchPixels();
  const vertices = await page.evaluate(() => [...window.crumple.shown.values()][0].car.baked.vertex.length / 3);
  await browser.close();
  if ((await load.ended) !== 0) throw new Error(`crumple_load failed: ${load.text}`);
  const ticks = readTicks(`${out}/load.mcap`), late = (at) => shares(held.map((one) => one[at] - ticks.get(one.tick)));
  const result = {
    cars, vertices, seconds, ...blank, tick_to_held: late("held"), tick_to_drawn: late("drawn"), memory_mb: { before, after },
    with_pixels_by_the_processor: software, with_fewer: eased,
  };
  writeFileSync(`${out}/web.json`, JSON.stringify(result, null, 1));
  const row = (name, { p50, p99, most }) => console.log(`${name.padEnd(58)}${[p50, p99, most].map((x) => x.toFixed(2).padStart(9)).join("")}`);
  console.log(`${all} cars of ${vertices} vertices, ${cars.crashing} crash at once; ${seconds} s`);
  console.log(`frames a second: ${result.frames_a_second.toFixed(1)} without drawing, ${software.frames_a_second.toFixed(1)} with pixels made by the processor, ${eased.frames_a_second.toFixed(1)} with as few as it then makes`);
  console.log(`${"ms".padEnd(58)}      p50      p99     most`);
  row("from frame to frame", result.frame);
  row("a frame in our code: surfaces, view, labels, panel", result.our_code);
  row("a frame in renderer.render (three.js; pixels come after it)", result.render_call);
  row("a batch of messages: decoding, hashes", result.batch);
  row("a surface after its tick: held by the page", result.tick_to_held);
  row("a surface after its tick: given to the browser as a frame", result.tick_to_drawn);
  console.log(`memory of the page, after a collection: ${before.toFixed(1)} MB, at the end ${after.toFixed(1)} MB`);
}

let code = 1;
try {
  await main();
  code = 0;
} catch (error) {
  console.error(`bench/web: ${error.message}`);
} finally {
  for (const child of children) child.kill();
}
process.exit(code);
