// Tests the gateway for browsers and its page with a real server, real Zenoh and `crumple view`.
//   node tests/gateway/web_test.mjs client PROGRAM CAR WEB      the package in Node has the server's surface, also after a lost connection
//   node tests/gateway/web_test.mjs page PROGRAM CAR WEB        the page in Chromium shows a known crash like tests/gateway/web_page.png; 77: no Chromium
//   node tests/gateway/web_test.mjs compare PROGRAM CAR WEB     two recordings side by side: difference and strain match their exported surfaces
//   node tests/gateway/web_test.mjs repaint PROGRAM CAR WEB     a car that is repainted many times is shown, and its earlier versions are dropped
//   node tests/gateway/web_test.mjs control PROGRAM CAR WEB     the page in Chromium: a car is tuned, painted, re-baked and hit, its parts change; 77: no Chromium
//   node tests/gateway/web_test.mjs model PROGRAM CAR WEB       a model of the user's shows the dents of the car that was baked from it; 77: no Chromium
//   node tests/gateway/web_test.mjs manual PROGRAM CAR WEB      the page of clients/web/README.md, made by its commands, in Chromium; 77: no Chromium
//   node tests/gateway/web_test.mjs keep PROGRAM CAR WEB        writes tests/gateway/web_page.png again; look at the picture
// WEB: the folder build/web.
import assert from "node:assert/strict";
import { execFileSync, spawn } from "node:child_process";
import { cpSync, existsSync, mkdirSync, mkdtempSync, readdirSync, readFileSync, rmSync, symlinkSync, writeFileSync } from "node:fs";
import { request } from "node:http";
import { createRequire } from "node:module";
import { connect } from "node:net";
import { tmpdir } from "node:os";
import { resolve } from "node:path";
import { fileURLToPath, pathToFileURL } from "node:url";
import { zstdCompressSync } from "node:zlib";

const patience = 90_000; // ms, for a machine under load with sanitizers on
const here = fileURLToPath(new URL(".", import.meta.url));
const mode = process.argv[2], [program, car, web] = process.argv.slice(3).map((path) => resolve(path));
const { Control, digits, Film, hashOf, Live, readCar, Surface } = await import(pathToFileURL(resolve(web, "dist/index.js")));

async function until(what, condition) {
  for (const end = Date.now() + patience; Date.now() < end; await new Promise((wait) => setTimeout(wait, 20))) {
    const value = await condition();
    if (value) return value;
  }
  assert.fail(`did not come within ${patience / 1000} s: ${what}`);
}

const children = [];
function start(...options) {
  const child = spawn(program, options, { stdio: ["ignore", "pipe", "inherit"] });
  const process = { child, text: "", ended: new Promise((ended) => child.on("exit", (code) => ended(code))) };
  child.stdout.on("data", (data) => (process.text += data));
  children.push(process);
  return process;
}
const said = (process, pattern) => until(`${pattern}`, () => pattern.exec(process.text)?.[1]);
async function end(process) {
  process.child.kill("SIGTERM");
  return process.ended;
}

const view = (...options) => start("view", "--page", resolve(web, "index.html"), ...options);
// Starts at the address of an earlier gateway, and retries while another process has the address.
async function viewAgain(host, ...options) {
  return until(`a gateway at ${host} again`, async () => {
    const gateway = view(...options, "--listen", host);
    const listens = said(gateway, /(http:\S+\/) in a browser/).catch(() => null);
    return (await Promise.race([listens, gateway.ended.then(() => null)])) && gateway;
  });
}
const address = (gateway) => said(gateway, /(http:\S+\/) in a browser/);

// Returns the status of a request with these headers.
function status(url, headers) {
  return new Promise((done, failed) => {
    const asked = request(url, { headers }, (answer) => done(answer.statusCode));
    asked.on("upgrade", (answer, socket) => (socket.destroy(), done(answer.statusCode)));
    asked.on("error", failed).end();
  });
}

async function checkWhoMayAsk(url) {
  const { host } = new URL(url);
  const socket = { Connection: "Upgrade", Upgrade: "websocket", "Sec-WebSocket-Version": "13", "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==" };
  assert.equal(await status(url, {}), 200);
  assert.equal(await status(`${url}asset/0000000000000000`, {}), 404);
  assert.equal(await status(`${url}live`, { ...socket, Origin: `http://${host}` }), 101);
  assert.equal(await status(`${url}live`, { ...socket, Origin: "http://another.example" }), 403, "a page of another site reads the scene");
  assert.equal(await status(url, { Host: "another.example" }), 403, "a name of another site that leads here reads the scene");
}

// Returns how many batches a browser gets that reads and never answers.
function neverAnswers(url) {
  const { hostname, port } = new URL(url);
  const socket = connect(port, hostname);
  socket.write(`GET /live HTTP/1.1\r\nHost: ${hostname}:${port}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n` +
    "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n");
  let bytes = Buffer.alloc(0);
  socket.on("data", (data) => (bytes = Buffer.concat([bytes, data])));
  socket.on("error", () => {});
  return {
    close: () => socket.destroy(),
    batches() {
      let at = bytes.indexOf("\r\n\r\n") + 4, count = 0;
      while (at > 3 && at + 2 <= bytes.length) {
        const short = bytes[at + 1], size = short < 126 ? short : short === 126 ? bytes.readUInt16BE(at + 2) : Number(bytes.readBigUInt64BE(at + 2));
        at += (short < 126 ? 2 : short === 126 ? 4 : 10) + size;
        ++count;
      }
      return count;
    },
  };
}

// A truncated message is refused, unless it lacks only the last zeros of a string. It never gives another surface.
function checkPrefixes(made, name, message) {
  const whole = made();
  assert.equal(whole[name](message), "whole");
  for (let size = 0; size < message.length; ++size) {
    const surface = made(), outcome = surface[name](message.slice(0, size));
    assert.ok(outcome === "refused" || (outcome === "whole" && surface.hash === whole.hash), `${name}: ${size} of ${message.length} bytes are ${outcome}`);
  }
}

async function client() {
  const server = start("serve", "--car", car, "--listen", "tcp/127.0.0.1:0", "--scene", "web");
  const endpoint = await said(server, /at (tcp\S+),/);
  const options = ["--connect", endpoint, "--scene", "web"];
  let gateway = view(...options, "--listen", "127.0.0.1:0");
  const url = await address(gateway);
  await checkWhoMayAsk(url);
  await checkBombs();

  // The last keyframe and delta that gave a surface.
  let came = null, keyframe = null, delta = null;
  for (const name of ["takeKeyframe", "takeDelta"]) {
    const original = Surface.prototype[name];
    Surface.prototype[name] = function (bytes) {
      const outcome = original.call(this, bytes);
      if (name === "takeKeyframe" && outcome !== "refused") came = bytes;
      if (name === "takeDelta" && outcome === "whole") [keyframe, delta] = [came, bytes];
      return outcome;
    };
  }
  const live = new Live(url), mute = neverAnswers(url);
  await until("the scene's server", () => live.server);
  const drive = start("drive", resolve(here, "../../clients/scenes/pole.json"), "--car", car, ...options, "--id", "dented", "--leave");
  assert.equal(await drive.ended, 0, "drive failed");
  const dented = live.cars.get("dented");
  assert.ok(dented, "the car did not come");

  // The surface of another viewer, written in C++.
  const held = async () => {
    const watch = start("watch", "--once", ...options);
    assert.equal(await watch.ended, 0);
    return /hash ([0-9a-f]{16})/.exec(watch.text)[1];
  };
  await until("the server's hash", async () => digits(dented.surface.hash) === (await held()));
  const { quanta, quantum } = dented.surface;
  assert.equal(digits(hashOf(new Uint8Array(quanta.buffer))), digits(dented.surface.hash));
  const deepest = 1000 * quantum * quanta.reduce((most, q) => Math.max(most, Math.abs(q)), 0);
  assert.ok(deepest > 100, `a pole at 50 km/h leaves ${deepest} mm`);
  assert.ok(dented.peak?.contacts > 0 && dented.absorbed > 10_000, "no reaction with contact came");
  assert.ok(dented.pose && Math.hypot(...dented.velocity) < 0.1, "the car does not stand");
  assert.equal([...live.obstacles.values()].flatMap(({ list }) => list).length, 1, "the pole is missing");
  await until("its asset", () => dented.baked);
  assert.equal(quanta.length, 3 * dented.baked.nodes);
  assert.equal(dented.refused, 0);
  await until("health", () => live.health && live.health.rooms.length > 3);

  const [key, change] = [keyframe, delta];
  checkPrefixes(() => new Surface(), "takeKeyframe", key);
  const base = () => {
    const surface = new Surface();
    surface.takeKeyframe(key);
    return surface;
  };
  checkPrefixes(base, "takeDelta", change);
  assert.equal(mute.batches(), 4, "a browser that does not answer is sent more than it may have unanswered");
  mute.close();

  // A late viewer gets everything. The first viewer reconnects by itself after the gateway was gone, and has the same surface.
  const late = new Live(url);
  await until("a late browser", () => late.cars.get("dented")?.surface.hash === dented.surface.hash && late.cars.get("dented").pose);
  late.close();
  assert.equal(await end(gateway), 0);
  await until("that the line is lost", () => live.link === "lost");
  gateway = await viewAgain(new URL(url).host, ...options);
  await until("the line again", () => live.link === "live");
  await until("the surface again", async () => digits(live.cars.get("dented")?.surface.hash ?? 0n) === (await held()));
  assert.ok(live.cars.get("dented") !== dented, "a car of another gateway passes for the same");
  const poles = () => [...live.obstacles.values()].flatMap(({ list }) => list).length;
  await until("where the car stands, and the pole, told before this gateway began", () => live.cars.get("dented")?.pose && poles() === 1);
  const [now, then] = [live.cars.get("dented").pose.position, dented.pose.position];
  assert.ok(Math.hypot(...now.map((x, i) => x - then[i])) < 0.05, `it stands at ${now}, not at ${then}`);
  await end(server);
  await until("that the server is gone", () => !live.server && live.cars.size === 0);
  live.close();
  console.log(`${live.received.batches} batches, deepest ${deepest.toFixed(0)} mm, hash ${digits(dented.surface.hash)}`);
}

// ---- the page ----

function chromium() {
  const folders = (process.env.PATH ?? "").split(":");
  const names = ["chromium-headless-shell", "chromium", "chromium-browser", "google-chrome"];
  return names.flatMap((name) => folders.map((folder) => `${folder}/${name}`)).find((path) => existsSync(path));
}

// Returns the hash of the last surface in a recording of one car, by the package in Node. The other test compares it with the
// server's.
async function lastHash(url) {
  const live = new Live(url);
  let last = null, over = false;
  await until("the recording's end", () => {
    const held = [...live.cars.values()][0]?.surface;
    if (held && last && held.tick < last.tick) over = true;
    if (held?.tick && !over) last = { tick: held.tick, hash: held.hash };
    return over;
  });
  live.close();
  return digits(last.hash);
}

// A recording as a scene: any moment, forwards and backwards.
function checkFilm(recording, hash) {
  const film = Film.read(recording), held = () => [...film.cars.values()][0];
  const before = 0.5, after = 2; // s: the wall is hit at 0.8
  for (const time of [before, after, before, after]) {
    film.seek(time);
    if (time === after) assert.equal(digits(held().surface.hash), hash, `another surface after ${time} s`);
    else assert.ok(held().surface.quanta.every((q) => q === 0), "a dent before the crash");
    assert.equal(held().peak !== null, time === after);
    assert.ok(held().baked && film.obstacles.size === 1);
  }
  film.seek(film.duration);
  assert.equal(film.cars.size, 0, "a car that was despawned is there");
  assert.throws(() => Film.read(new Uint8Array(1000)));
}

// A message of zeros, packed by zstd: each chunk expands from a few bytes.
async function checkBombs() {
  const require = createRequire(pathToFileURL(resolve(web, "package.json"))), { McapWriter, TempBuffer } = require("@mcap/core");
  const packed = async (data) => {
    const writable = new TempBuffer();
    const writer = new McapWriter({ writable, compressChunk: (chunk) => ({ compression: "zstd", compressedData: zstdCompressSync(chunk) }) });
    await writer.start({ profile: "crumple", library: "test" });
    const schemaId = await writer.registerSchema({ name: "S", encoding: "", data: new Uint8Array(0) });
    const channelId = await writer.registerChannel({ schemaId, topic: "t", messageEncoding: "", metadata: new Map() });
    await writer.addMessage({ channelId, sequence: 0, logTime: 0n, publishTime: 0n, data });
    await writer.end();
    return writable.get();
  };
  const noise = Uint8Array.from({ length: 1 << 20 }, (_, i) => (Math.imul(i, 2654435761) >>> 24) & 0xff);
  assert.equal(Film.read(await packed(noise)).duration, 0, "what is no bomb is read");
  for (const size of [1 << 20, 70 << 20]) {
    const bomb = await packed(new Uint8Array(size));
    assert.throws(() => Film.read(bomb), /claims to hold/);
  }
}

// The same recording, rewritten by another program: such programs use zstd by default.
async function inZstd(recording) {
  const require = createRequire(pathToFileURL(resolve(web, "package.json")));
  const { McapStreamReader, McapWriter, TempBuffer } = require("@mcap/core"), { decompress } = require("lz4js");
  const reader = new McapStreamReader({ decompressHandlers: { lz4: (data, size) => decompress(data, Number(size)) } });
  const writable = new TempBuffer(), schemas = new Map(), channels = new Map();
  const writer = new McapWriter({ writable, compressChunk: (data) => ({ compression: "zstd", compressedData: zstdCompressSync(data) }) });
  await writer.start({ profile: "crumple", library: "test" });
  reader.append(recording);
  for (let record; (record = reader.nextRecord()); ) {
    if (record.type === "Schema" && !schemas.has(record.id)) schemas.set(record.id, await writer.registerSchema(record));
    if (record.type === "Channel" && !channels.has(record.id))
      channels.set(record.id, await writer.registerChannel({ ...record, schemaId: schemas.get(record.schemaId) }));
    if (record.type === "Message") await writer.addMessage({ ...record, channelId: channels.get(record.channelId) });
    if (record.type === "Attachment") await writer.addAttachment(record);
    if (record.type === "Metadata") await writer.addMetadata(record);
  }
  await writer.end();
  return writable.get();
}

// Opens a page at this address and collects the output of its console.
async function openPage(path, url, options) {
  const { chromium: browsers } = createRequire(pathToFileURL(resolve(web, "package.json")))("playwright-core");
  const browser = await browsers.launch({
    executablePath: path, args: ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"], timeout: patience,
  });
  const opened = await browser.newPage(options);
  opened.setDefaultTimeout(patience);
  const console_ = [];
  opened.on("console", (message) => console_.push(message.text()));
  opened.on("pageerror", (error) => console_.push(`${error}`));
  await opened.goto(url);
  return { browser, opened, console_ };
}

async function scrubTo(opened, time) {
  await opened.evaluate((value) => {
    const scrub = document.querySelector("#scrub");
    scrub.value = value;
    scrub.dispatchEvent(new Event("input"));
  }, `${time}`);
}

async function page(path, keep) {
  const recording = resolve(here, "../../recordings/m130_wall.mcap");
  const gateway = view(recording, "--listen", "127.0.0.1:0");
  const url = await address(gateway);
  const hash = await lastHash(url);
  checkFilm(new Uint8Array(readFileSync(recording)), hash);
  checkFilm(await inZstd(new Uint8Array(readFileSync(recording))), hash);
  const { browser, opened, console_ } = await openPage(path, url, { viewport: { width: 560, height: 320 } });
  // Waits until the crash is over: the page has its last surface, and the car stands. Then stops the recording there.
  await opened.waitForFunction((wanted) => {
    const { live, shown } = window.crumple, [item] = shown.values();
    const whole = item?.mesh?.deepest > 0.1 && item.car.surface.hash === BigInt(`0x${wanted}`) && Math.hypot(...item.car.velocity) < 0.01;
    if (whole) live.close();
    return whole;
  }, hash);
  await opened.waitForFunction(() => /\d+ mm/.test(document.querySelector("#cars .dent").textContent));
  const panel = await opened.innerText("#panel");
  for (const words of ["car", "km/h", "ms a tick", "solve", "bits a vertex"]) assert.ok(panel.includes(words), `the panel does not say "${words}": ${panel}`);
  assert.match(await opened.innerText("#credits"), /mononofu/, "whom to credit is not shown");
  await opened.evaluate(countStrains);
  await opened.keyboard.press("c"); // colours stay on for the picture, because they show the dent best
  assert.equal(await opened.innerText("#legend"), "Dent\n0\n500 mm");
  await opened.keyboard.press("p");
  assert.ok(await opened.isHidden("#details"), "key P does not fold the panel");

  // The picture must equal the kept one, except for small differences between machines.
  const shot = `data:image/png;base64,${await opened.evaluate(() => window.crumple.picture())}`;
  const kept = resolve(here, "web_page.png");
  if (keep) writeFileSync(kept, Buffer.from(shot.split(",")[1], "base64"));
  const difference = await opened.evaluate(compare, [shot, `data:image/png;base64,${readFileSync(kept, "base64")}`]);
  console.log(`hash ${hash}; the picture differs by ${(100 * difference.mean).toFixed(2)} % on average, by much in ${(100 * difference.far).toFixed(2)} % of it`);
  assert.ok(difference.mean < 0.012 && difference.far < 0.02, "the page draws another picture than tests/gateway/web_page.png");

  // The page computes the strain once for each surface, and only while it shows strain.
  const strains = () => opened.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(window.strains)))));
  assert.equal(await strains(), 0);
  await opened.keyboard.press("c");
  await opened.keyboard.press("ArrowLeft");
  assert.equal(await strains(), 1);

  // Opens the same recording as a file, and seeks to a moment before the crash and to one after it.
  await opened.setInputFiles("#file", recording);
  await opened.waitForFunction(() => window.crumple.film());
  for (const [time, dented] of [[2, true], [0.5, false]]) {
    await scrubTo(opened, time);
    await opened.waitForFunction((wanted) => {
      const [item] = window.crumple.shown.values();
      return item?.mesh && item.mesh.deepest > 0.1 === wanted;
    }, dented);
    const strained = await opened.evaluate(() => Math.max(...[...window.crumple.shown.values()][0].mesh.strain()));
    assert.ok(dented ? strained > 0.2 : strained < 1e-5, `strain of ${strained} where ${dented ? "a" : "no"} dent is`);
  }

  // If frames take long, the page draws less and says so, until the user wants full quality.
  const says = (pattern) => opened.waitForFunction((wanted) => new RegExp(wanted).test(document.querySelector("#link").textContent), pattern.source);
  await opened.evaluate(() => {
    const { renderer } = window.crumple, { render } = renderer;
    renderer.render = (...what) => {
      render.apply(renderer, what);
      for (const end = performance.now() + 80; performance.now() < end; );
    };
    window.fast = () => (renderer.render = render);
  });
  await opened.selectOption("#speed", "0.05");
  await opened.click("#play");
  await opened.evaluate(() => document.activeElement.blur());
  const ratio = () => opened.evaluate(() => window.crumple.renderer.getPixelRatio());
  await opened.keyboard.press("f");
  await says(/^recording, drawn in full$/);
  assert.equal(await ratio(), 1);
  await opened.keyboard.press("f");
  await says(/^recording, drawn coarsely to keep up \(key F/);
  assert.equal(await ratio(), 0.4);
  await opened.evaluate(() => window.fast());
  await scrubTo(opened, 0.5);

  // Shows the recording beside the scene, which has stopped with the full dent.
  await opened.keyboard.press("b");
  await opened.waitForFunction(() => window.crumple.comparison()?.pairs.length);
  const deepest = await opened.evaluate(() => [...window.crumple.comparison().pairs[0].shown].map(({ mesh }) => 1000 * mesh.deepest));
  assert.ok(deepest[0] > 100 && deepest[1] === 0, `deepest ${deepest} mm`);
  await differBy(opened, deepest[0]);
  await scrubTo(opened, 2);
  await differBy(opened, 0);
  await opened.keyboard.press("b");
  assert.ok(await opened.isHidden("#comparison"), "key B does not end it");

  // Opens a second recording, beside the first or alone.
  for (const [key, names] of [["Escape", 0], ["Enter", 2]]) {
    await opened.setInputFiles("#file", resolve(here, "../../recordings/built_in_pole.mcap"));
    await opened.waitForSelector("#choice[open]");
    await opened.keyboard.press(key);
    await opened.waitForFunction((count) => !document.querySelector("#choice").open && document.querySelectorAll("#names:not([hidden]) span").length === count, names);
  }
  await opened.waitForFunction(() => /surfaces of (\d+) and (?!\1 )\d+ vertices/.test(document.querySelector("#comparison").textContent));
  await opened.click("#close");
  assert.ok(await opened.isHidden("#player"));
  assert.deepEqual(console_, [], "the console is not clean");
  await browser.close();
  await end(gateway);
}

// Returns the page's figures of the only pair, mm. It waits for them, because the page updates text four times a second.
async function differBy(opened, largest, rms = null) {
  const said = async () => (await opened.innerText("#comparison")).match(/differ by ([\d.]+) mm at most, ([\d.]+) mm RMS/)?.slice(1).map(Number);
  const near = (found, wanted) => wanted === null || Math.abs(found - wanted) < 0.1;
  let last = null;
  await until(`a difference of ${largest} mm, ${rms} RMS; the page says ${last}`, async () => (last = await said()) && near(last[0], largest) && near(last[1], rms))
    .catch(() => assert.fail(`the page says ${last}, not ${largest} mm at most and ${rms} mm RMS`));
}

// Reads an exported recording: the time of the first contact, and the surface after any tick (numbers of an OBJ).
async function exported(recording, folder) {
  assert.equal(await start("export", recording, "-o", folder, "--fps", "1000").ended, 0);
  const rows = readFileSync(`${folder}/reactions.csv`, "utf8").trim().split("\n").slice(1).map((row) => row.split(","));
  const ticks = readdirSync(folder).map((name) => Number(/_(\d+)\.obj$/.exec(name)?.[1] ?? NaN)).filter((tick) => tick >= 0).sort((a, b) => a - b);
  return {
    contact: Number(rows.find((row) => Number(row.at(-1)) > 0)[0]),
    /** kind: "v", or "f" for its triangles, whose vertices are counted from 1. */
    surface(tick, kind = "v") {
      const name = String(ticks.filter((one) => one <= tick).at(-1)).padStart(6, "0");
      const lines = readFileSync(`${folder}/car_${name}.obj`, "utf8").split("\n").filter((line) => line.startsWith(`${kind} `));
      return lines.map((line) => line.split(" ").slice(1, 4).map(Number));
    },
  };
}

// Computes the strain of each vertex in a slow way: the largest change of length of a line in its triangles over all directions,
// weighted by area.
function strainOf(triangles, rest, now) {
  const minus = (a, b) => a.map((x, k) => x - b[k]), dot = (a, b) => a.reduce((sum, x, k) => sum + x * b[k], 0);
  const sum = rest.map(() => 0), area = rest.map(() => 0);
  for (const corners of triangles.map((triangle) => triangle.map((v) => v - 1))) {
    const [[b, c], [p, q]] = [rest, now].map((at) => corners.slice(1).map((v) => minus(at[v], at[corners[0]])));
    const width = Math.hypot(...b), along = dot(b, c) / width, height = Math.hypot(...c.map((x, k) => x - (along / width) * b[k]));
    let most = 0;
    for (let angle = 0; angle < Math.PI; angle += Math.PI / 360) {
      const y = Math.sin(angle) / height, x = (Math.cos(angle) - y * along) / width; // a line of 1 m is x b + y c
      most = Math.max(most, Math.abs(Math.hypot(...p.map((one, k) => x * one + y * q[k])) - 1));
    }
    for (const v of corners) {
      sum[v] += most * width * height;
      area[v] += width * height;
    }
  }
  return sum.map((x, v) => x / area[v]);
}

// Runs in the page: counts from now on how often the page computes the strain of a car.
function countStrains() {
  const made = Object.getPrototypeOf([...window.crumple.shown.values()][0].mesh), { strain } = made;
  window.strains = 0;
  made.strain = function () {
    ++window.strains;
    return strain.call(this);
  };
}

// Reads the legend: "Dent", 500, and the colours as linear light.
async function readLegend(opened) {
  const [quantity, most, bar] = await opened.evaluate(() => [
    ...["#quantity", "#most"].map((id) => document.querySelector(id).textContent), getComputedStyle(document.querySelector("#legend i")).backgroundImage]);
  const linear = (byte) => (byte / 255 <= 0.04045 ? byte / 255 / 12.92 : ((byte / 255 + 0.055) / 1.055) ** 2.4);
  return { quantity, most: parseFloat(most), unit: most.split(" ")[1], stops: [...bar.matchAll(/rgb\((\d+), (\d+), (\d+)\)/g)].map((stop) => stop.slice(1).map(Number).map(linear)) };
}

function checkColours({ quantity, most, stops }, values, drawn) {
  values.forEach((value, v) => {
    const share = Math.min(1, value / most) * (stops.length - 1), i = Math.min(Math.floor(share), stops.length - 2);
    const wanted = stops[i].map((x, k) => x + (share - i) * (stops[i + 1][k] - x));
    assert.ok(drawn[v].some((each) => wanted.every((x, k) => Math.abs(x - each[k]) < 0.01)), `vertex ${v}, ${quantity} ${value}, is drawn as ${drawn[v]}, not ${wanted}`);
  });
}

// Runs in the page: for each vertex of the pair's two cars, returns the colours that are drawn where it is. Where parts touch, two
// vertices may be in one place.
function colours() {
  const [{ shown }] = window.crumple.comparison().pairs;
  return shown.map(({ mesh }) => {
    const { position, color } = mesh.geometry.attributes, key = (array, at) => array.slice(at, at + 3).join();
    const corner = new Map();
    for (let c = 0; c < position.array.length; c += 3) {
      const place = key(position.array, c);
      corner.set(place, [...(corner.get(place) ?? []), [...color.array.slice(c, c + 3)]]);
    }
    return Array.from({ length: mesh.skinned.length / 3 }, (_, v) => corner.get(key(mesh.skinned, 3 * v)));
  });
}

// Runs in the page: returns the car of the pair in each part of the next frame, and whether this is the left part.
function whereDrawn() {
  const { renderer, comparison } = window.crumple, [{ shown }] = comparison().pairs, { render } = renderer, parts = [];
  const place = { copy: (rectangle) => rectangle };
  return new Promise((done) => {
    renderer.render = (scene, camera) => {
      render.call(renderer, scene, camera);
      const visible = (object) => object === scene || (object.visible && visible(object.parent));
      parts.push({ cars: [0, 1].filter((i) => visible(shown[i].mesh)), left: renderer.getViewport(place).x === 0 });
      if (parts.length < 2) return;
      renderer.render = render;
      done(parts);
    };
    document.querySelector("#scrub").dispatchEvent(new Event("input")); // so that there is a next frame
  });
}

// Runs in the page: a seek backwards creates the cars again. Returns which cars of the pair have colours in their first picture.
function colouredAtFirst() {
  const { renderer, comparison } = window.crumple, { render } = renderer, [{ meshes: [before] }] = comparison().pairs;
  return new Promise((done) => {
    renderer.render = (scene, camera) => {
      render.call(renderer, scene, camera);
      const meshes = comparison().pairs[0]?.meshes;
      if (!meshes || meshes[0] === before) return;
      renderer.render = render;
      done(meshes.map(({ material }) => material.vertexColors));
    };
    const scrub = document.querySelector("#scrub");
    scrub.value = `${scrub.value / 2}`;
    scrub.dispatchEvent(new Event("input"));
  });
}

async function comparison(path) {
  const folder = mkdtempSync(`${tmpdir()}/crumple_compare_`);
  const recordings = ["built_in_pole", "built_in_roof_drop"].map((name) => resolve(here, `../../recordings/${name}.mcap`));
  const [a, b] = [await exported(recordings[0], `${folder}/a`), await exported(recordings[1], `${folder}/b`)];
  const apart = (after) => {
    const [from, to] = [a.surface(a.contact + after), b.surface(b.contact + after)];
    const lengths = from.map((at, v) => 1000 * Math.hypot(...at.map((x, k) => x - to[v][k])));
    return { lengths, largest: Math.max(...lengths), rms: Math.sqrt(lengths.reduce((sum, x) => sum + x * x, 0) / lengths.length) };
  };
  const gateway = view(...recordings, "--listen", "127.0.0.1:0");
  const { browser, opened, console_ } = await openPage(path, await said(gateway, /open (http:\S+) in a browser/), { viewport: { width: 820, height: 340 } });
  await opened.waitForFunction(() => window.crumple.comparison()?.pairs.length);
  assert.deepEqual((await opened.innerText("#names")).split(/\s+/), ["built_in_pole.mcap", "built_in_roof_drop.mcap"]);
  // Times are in ticks after the first contact. Recordings begin with tick 1, and on the common clock the later contact keeps its
  // place.
  for (const after of [-2, 2, 1, 100]) {
    const wanted = apart(after);
    await scrubTo(opened, (Math.max(a.contact, b.contact) - 1 + after) / 60);
    await differBy(opened, wanted.largest, wanted.rms);
    console.log(`${after} ticks after contact: ${wanted.largest.toFixed(1)} mm at most, ${wanted.rms.toFixed(1)} mm RMS`);
  }

  // Colours match the legend at the lengths in it.
  const { lengths } = apart(100);
  const difference = await readLegend(opened);
  assert.equal(`${difference.quantity} ${difference.unit}`, "Difference mm");
  for (const drawn of await opened.evaluate(colours)) checkColours(difference, lengths, drawn);
  assert.deepEqual(await opened.evaluate(whereDrawn), [{ cars: [0], left: true }, { cars: [1], left: false }]);
  assert.deepEqual(await opened.evaluate(colouredAtFirst), [true, true], "where frames take long, that picture stays");

  // Strain is shown for each of the two separately.
  await opened.keyboard.press("c");
  const strain = await readLegend(opened);
  assert.equal(`${strain.quantity} ${strain.unit}`, "Strain of the surface %");
  for (const after of [2, 100, -2]) {
    const wanted = [a, b].map(({ contact, surface }) => strainOf(surface(contact, "f"), surface(contact - 2), surface(contact + after)).map((x) => 100 * x));
    await scrubTo(opened, (Math.max(a.contact, b.contact) - 1 + after) / 60);
    await differBy(opened, apart(after).largest);
    for (const [i, drawn] of (await opened.evaluate(colours)).entries()) checkColours(strain, wanted[i], drawn);
    const said = await opened.evaluate(() => window.crumple.comparison().pairs[0].shown.map(({ mesh }) => [...mesh.strain()]));
    said.forEach((values, i) => values.forEach((value, v) => assert.ok(Math.abs(100 * value - wanted[i][v]) < 0.2, `vertex ${v}: strain ${100 * value} %, not ${wanted[i][v]} %`)));
    console.log(`${after} ticks after contact: strain ${wanted.map((values) => Math.max(...values).toFixed(1)).join(" and ")} % at most`);
  }
  await opened.keyboard.press("c");
  assert.ok(await opened.isHidden("#legend"), "the legend stays when colours are off");
  await opened.keyboard.press("c");
  assert.equal((await readLegend(opened)).quantity, "Difference");

  // Two copies of the same recording.
  await opened.setInputFiles("#file", [recordings[0], recordings[0]]);
  await opened.waitForFunction(() => new Set(window.crumple.comparison().names).size === 1);
  await scrubTo(opened, 2);
  await differBy(opened, 0, 0);

  // On a phone the whole comparison fits in the window.
  await opened.setViewportSize({ width: 390, height: 844 });
  for (const what of ["#names span:nth-child(1)", "#names span:nth-child(2)", "#scrub", "#speed", "#close", "#comparison", "#legend"]) {
    await until(`${what} in a phone's window`, () => opened.evaluate((selector) => {
      const { left, top, right, bottom } = document.querySelector(selector).getBoundingClientRect();
      return left >= 0 && top >= 0 && right <= innerWidth && bottom <= innerHeight && left < right && innerWidth === 390;
    }, what));
  }
  assert.deepEqual(console_, [], "the console is not clean");
  await browser.close();
  await end(gateway);
  rmSync(folder, { recursive: true });
}

// ---- the page that commands ----

const none = "0000000000000000";

// Requests to a gateway, with the status and the sentence of their refusal.
async function checkRefusals(url, asset) {
  const ask = async (path, body, headers = {}) => {
    const answer = await fetch(new URL(path, url), { method: "POST", body, headers });
    return `${answer.status} ${await answer.text()}`;
  };
  assert.match(await ask(`paint/${asset}`, "{regions: [}"), /^422 .*regions\.fbs/s);
  assert.match(await ask(`paint/${asset}`, '{regions: [{name: "far", sphere: {center: {x: 99, y: 0, z: 0}, radius: 1}}]}'), /^422 .*holds no node/s);
  assert.match(await ask(`paint/${none}`, "{regions: []}"), /^404 /);
  assert.match(await ask("elsewhere", ""), /^404 /);
  assert.match(await ask("command/car/*", ""), /^400 /, "all cars at once");
  assert.match(await ask(`paint/${asset}`, "x".repeat((1 << 20) + 1)), /^413 /);
  assert.match(await ask(`paint/${asset}`, "{regions: []}", { Origin: "http://another.example" }), /^403 /, "a page of another site commands");
  const control = await Control.find(url);
  await assert.rejects(control.repair("nobody"), /nobody does not live here/);
  await assert.rejects(control.spawn("x", none, "page", origin), /not one of this server's/);
  return control;
}

// A pole hits the car at the origin at 8 m/s. Returns the depth of the car's dent, m. The pole takes 1.1 s of the server's time,
// and the server may be 1.1 s late when drive ends. So drive lasts longer; else the pole would hit the next car.
async function hit(live, folder, options) {
  const scene = resolve(folder, "hit.json"), zero = { x: 0, y: 0, z: 0 };
  writeFileSync(scene, JSON.stringify({
    about: "A pole that comes.",
    obstacles: [{ id: 1, shape: "capsule", size: { x: 0.15, y: 3, z: 0 }, velocity: { x: -8, y: 0, z: 0 },
      pose: { position: { x: 6, y: 0, z: 2 }, orientation: { ...zero, w: 1 } } }],
    hits: [{ position: { x: 0, y: 80, z: 0 }, direction: { x: 1, y: 0, z: 0 }, speed_kmh: 0, seconds: 3 }],
  }));
  const drive = start("drive", scene, "--car", car, ...options, "--id", "bystander");
  assert.equal(await drive.ended, 0, "drive failed");
  const { quanta, quantum } = live.cars.get("painted").surface;
  return quantum * quanta.reduce((most, q) => Math.max(most, Math.abs(q)), 0);
}

const origin = { position: [0, 0, 0], orientation: [0, 0, 0, 1] };
/** Number of baked cars that server and gateway keep in addition to those in use. */
const given = 16, spare = 8;

async function repaint() {
  const server = start("serve", "--car", car, "--listen", "tcp/127.0.0.1:0", "--scene", "web");
  const options = ["--connect", await said(server, /at (tcp\S+),/), "--scene", "web"];
  const gateway = view(...options, "--control", "--listen", "127.0.0.1:0"), url = await address(gateway), live = new Live(url);
  await until("the scene's server", () => live.server);
  const commander = await Control.find(url), info = start("info", car);
  assert.equal(await info.ended, 0);
  const hashes = [/\b[0-9a-f]{16}\b/.exec(info.text)[0]];
  await commander.spawn("painted", hashes[0], "page", origin);
  const shows = (region) => until(`a car with region ${region}`, () => live.cars.get("painted")?.baked?.regions.includes(region));
  await shows("body");
  const painted = live.cars.get("painted");
  const paint = async (name) => {
    const regions = [{ name, sphere: { center: { x: 0, y: 0, z: 0.5 }, radius: 1 } }];
    hashes.push(digits(hashOf(await commander.paint(hashes.at(-1), JSON.stringify({ regions })))));
  };
  for (let k = 0; k < given + 2; ++k) {
    await paint(`part${k}`);
    await commander.replace("painted", hashes.at(-1));
    await shows(`part${k}`);
  }
  assert.equal(live.cars.get("painted"), painted, "the car that was painted anew passes for another");
  const kept = [];
  for (const hash of hashes) if ((await fetch(new URL(`asset/${hash}`, url))).ok) kept.push(hash);
  assert.deepEqual(kept, hashes.slice(-1 - spare), "the gateway keeps others than the car's and the newest of those before it");
  assert.deepEqual([...live.assets.keys()], hashes.slice(-1), "the page keeps what no car is of");
  const late = new Live(url);
  await until("a late page", () => late.cars.get("painted")?.baked?.regions.includes(`part${given + 1}`));
  late.close();

  // The server has dropped the first baked cars too, but not those in use. The gateway asks again for a car that it has dropped.
  await assert.rejects(commander.replace("painted", hashes[1]), /not one of this server's/);
  await commander.replace("painted", hashes[0]);
  await until("what it was at first", () => painted.baked?.regions.every((name) => !name.startsWith("part")));
  for (const hash of hashes.slice(-given)) await commander.spawn(`of-${hash}`, hash, "page", origin);
  await assert.rejects(paint("part"), /no room for one more baked car.*despawn another car first/);
  live.close();
  await end(gateway);
  await end(server);
}

// Runs in the page: counts the corners of what the page shows of the car by colour. It must show one thing.
function tints() {
  const [{ group }] = window.crumple.shown.values(), counts = {}, meshes = [];
  group.traverseVisible(({ geometry }) => geometry?.attributes.color && meshes.push(geometry.attributes));
  if (meshes.length !== 1) throw new Error(`the page shows ${meshes.length} surfaces of the car`);
  const [{ color }] = meshes;
  for (let i = 0; i < color.count; ++i) {
    const key = [color.getX(i), color.getY(i), color.getZ(i)].map((x) => x.toFixed(3)).join(" ");
    counts[key] = (counts[key] ?? 0) + 1;
  }
  return counts;
}

// Two fingers that move apart bring the view nearer, and two fingers that move together turn it, as on a phone.
async function twoFingers(opened) {
  const session = await opened.context().newCDPSession(opened);
  const touch = (type, ...fingers) => session.send("Input.dispatchTouchEvent", { type, touchPoints: fingers.map((x, id) => ({ x, y: 200, id })) });
  const eye = () => opened.evaluate(() => {
    const { camera, controls } = window.crumple.tools().paint.workbench, { x, y, z } = camera.position.clone().sub(controls.target);
    return { away: Math.hypot(x, y, z), azimuth: Math.atan2(y, x) };
  });
  const move = async (from, to) => {
    await touch("touchStart", from[0]);
    await touch("touchStart", ...from);
    await touch("touchMove", ...to);
    await touch("touchEnd");
  };
  const before = await eye();
  await move([220, 260], [190, 290]);
  await until("a nearer view", async () => (await eye()).away < 0.7 * before.away);
  await move([200, 240], [280, 320]);
  await until("a turned view", async () => Math.abs((await eye()).azimuth - before.azimuth) > 0.3);
}

async function download(opened, button, file) {
  const [came] = await Promise.all([opened.waitForEvent("download"), opened.click(button)]);
  await came.saveAs(file);
  return file;
}

// The parts of a baked car, each with the places of its vertices.
function partsIn(file) {
  const bytes = new Uint8Array(readFileSync(file)), { parts, vertex, vertexPart } = readCar(bytes, digits(hashOf(bytes)));
  return parts.map((part, i) => ({ ...part, at: [...vertexPart.keys()].filter((v) => vertexPart[v] === i).map((v) => vertex.slice(3 * v, 3 * v + 3).join()).sort() }));
}

// The page shows the parts of a baked car, and bakes with the files that it saves make the parts that it shows.
async function checkParts(opened, answered, folder) {
  const bake = async (name) => {
    const parts = await download(opened, "#parts-save", resolve(folder, `${name}.json`)), out = resolve(folder, `${name}.car`);
    assert.equal(await start("bake", "built-in", "--mesher", "lattice", "--nodes", "300", "--parts", parts, "-o", out).ended, 0);
    return partsIn(out);
  };
  const list = () => opened.$$eval("#parts-list li:not([hidden]) button", (rows) => rows.map((row) => [...row.children].slice(1).map(({ textContent }) => textContent).join(": ")));
  const choose = (name) => opened.click(`#parts-list button:has(span:text-is("${name}"))`);
  const click = async (point) => {
    const { x, y } = await opened.evaluate((there) => window.crumple.tools().parts.screen(there), point);
    await opened.mouse.click(x, y);
  };
  const was = partsIn(car), wheels = ["front left", "front right", "rear left", "rear right"].map((where) => `wheel ${where}: wheel`);
  await opened.click("#parts summary");
  await opened.waitForFunction(() => window.crumple.tools().parts.showing && !window.crumple.tools().paint.showing);
  assert.deepEqual(await list(), ["glass: glass", "interior: interior", "lights: light", ...wheels]);
  const shown = await opened.evaluate(tints);
  assert.equal(Object.keys(shown).length, 8, "body and seven parts have not a colour each");
  await opened.hover("#parts-list li:nth-child(2) button");
  const lit = await opened.evaluate(tints);
  assert.equal(Object.keys(shown).filter((colour) => colour in lit).length, 2, "more than the part under the pointer, and the body, keep their colour");

  // A baked car does not say which names its glass has; with the file as it is, the parts are the same.
  await opened.click("#parts-save");
  await answered(/does not say which names "glass" has in your file/);
  await opened.fill("#parts-source", "glass");
  await opened.keyboard.press("Tab");
  assert.deepEqual(await bake("same"), was);
  await answered(/crumple bake FILE --parts parts\.json -o car\.car/);
  const [chooser] = await Promise.all([opened.waitForEvent("filechooser"), opened.click("#parts-load")]);
  await chooser.setFiles(resolve(folder, "same.json"));
  await answered(/same\.json: 7 parts$/);

  // Changes a kind, a name, and what is no part; and adds a point.
  await opened.keyboard.press("1"); // the view from ahead and the right
  await opened.waitForFunction(() => window.crumple.tools().parts.screen([1.36, -0.85, 0.3]).x < 400);
  await choose("lights");
  await opened.selectOption("#parts-kind", "panel");
  await click([1.36, -0.85, 0.3]);
  assert.equal(await opened.inputValue("#parts-name"), "wheel front right", "a click on the car chooses another part");
  await opened.fill("#parts-name", "glass");
  await opened.keyboard.press("Enter");
  await answered(/there is a part "glass" already/);
  await opened.fill("#parts-name", "wheel 1");
  await opened.keyboard.press("Enter");
  await choose("interior");
  await opened.click("#parts-remove");
  await click([-1.36, -0.85, 0.3]);
  await opened.click("#parts-remove");
  await opened.click("#parts-undo");
  await opened.click("#parts-point");
  const away = ([x, y, z]) => Math.hypot(x - 1.6, y + 0.3, z - 0.9);
  const bonnet = was[0].at.map((place) => place.split(",").map(Number)).reduce((best, each) => (away(each) < away(best) ? each : best));
  await click(bonnet);
  await opened.fill("#parts-name", "badge");
  await opened.keyboard.press("Enter");
  assert.deepEqual(await list(), ["glass: glass", "lights: panel", wheels[0], "wheel 1: wheel", ...wheels.slice(2), "badge: point"]);
  const [, glass, , lights, left, right, ...rear] = was, now = await bake("changed"), badge = now.at(-1);
  assert.deepEqual(now.slice(1, -1), [glass, { ...lights, kind: "panel" }, left, { ...right, name: "wheel 1" }, ...rear]);
  assert.deepEqual([badge.name, badge.kind], ["badge", "point"]);
  assert.ok(Math.hypot(...badge.position.map((x, k) => x - bonnet[k])) < 0.05, `it lies at ${badge.position}, not at ${bonnet}`);
  await opened.click("#parts summary");
}

async function control(path) {
  const folder = mkdtempSync(resolve(tmpdir(), "crumple-web-"));
  try {
    return await controlIn(path, folder);
  } finally {
    rmSync(folder, { recursive: true });
  }
}

async function controlIn(path, folder) {
  const info = async (file) => {
    const told = start("info", file);
    assert.equal(await told.ended, 0);
    return told.text;
  };
  const asset = /\b[0-9a-f]{16}\b/.exec(await info(car))[0], recording = resolve(folder, "session.mcap");
  const server = start("serve", "--car", car, "--listen", "tcp/127.0.0.1:0", "--scene", "web", "--record", recording);
  const options = ["--connect", await said(server, /at (tcp\S+),/), "--scene", "web"];
  const shows = view(...options, "--listen", "127.0.0.1:0"), urlThatShows = await address(shows);
  assert.equal((await fetch(new URL("command/car/painted", urlThatShows), { method: "POST", body: "" })).status, 403, "it commands without --control");
  assert.equal(await Control.find(urlThatShows), null);
  await end(shows);

  const gateway = view(...options, "--control", "--listen", "127.0.0.1:0"), url = await address(gateway), live = new Live(url);
  await until("the scene's server", () => live.server);
  const commander = await Control.find(url);
  await commander.spawn("painted", asset, "page", origin);
  await until("the asset at the gateway", () => live.cars.get("painted")?.baked);
  await checkRefusals(url, asset);

  const { browser, opened, console_ } = await openPage(path, url, { viewport: { width: 760, height: 480 }, hasTouch: true, acceptDownloads: true });
  await opened.waitForFunction(() => window.crumple.tools() && [...window.crumple.shown.values()][0]?.mesh);
  const answered = (pattern) => opened.waitForFunction((wanted) => new RegExp(wanted).test(document.querySelector("#tool-answer").textContent), pattern.source);

  // Paints a region in a stroke, then another by touch, which is undone, and an anchor.
  await opened.click("#paint summary");
  await opened.click("#paint-on");
  await opened.waitForFunction(() => window.crumple.tools().paint.showing);
  const at = (point) => opened.evaluate((there) => window.crumple.tools().paint.screen(there), point);
  const legend = () => opened.innerText("#paint-legend");
  const stroke = async (...points) => {
    for (const [i, point] of points.entries()) {
      const { x, y } = await at(point);
      await opened.mouse.move(x, y, { steps: 3 });
      if (i === 0) await opened.mouse.down();
    }
    await opened.mouse.up();
  };
  await opened.fill("#paint-name", "hood");
  await stroke([1.6, -0.3, 0.8], [1.6, 0.3, 0.8]);
  assert.equal(await legend(), "hood");
  const hood = await opened.evaluate(tints);
  await opened.fill("#paint-name", "mistake");
  const { x, y } = await at([0, -0.9, 0.5]);
  await opened.touchscreen.tap(x, y);
  assert.equal(await legend(), "hood\nmistake");
  assert.deepEqual([hood, await opened.evaluate(tints)].map((all) => Object.keys(all).length), [2, 3]);
  await opened.click("#paint-undo");
  assert.equal(await legend(), "hood");
  assert.deepEqual(await opened.evaluate(tints), hood, "what was undone is seen");
  await opened.selectOption("#paint-kind", "anchor");
  await opened.fill("#paint-name", "cell");
  await opened.focus("#paint-radius");
  await opened.keyboard.press("End");
  await stroke([-0.2, -0.9, 0.5]);
  assert.equal(await legend(), "hood\ncell, anchored");
  const all = await opened.evaluate(tints);
  assert.equal(Object.keys(all).length, 3);
  await opened.evaluate(() => [false, true].forEach((on) => window.crumple.tools().paint.toggle(on)));
  assert.deepEqual(await opened.evaluate(tints), all, "the mask is another when it is painted at once");
  await twoFingers(opened);
  assert.equal(await legend(), "hood\ncell, anchored", "two fingers paint");

  // After re-baking, the car in the scene equals the car that the program bakes with the saved regions.
  await opened.click("#paint-bake");
  await answered(/is now [0-9a-f]{16}: body, hood, cell;/);
  const regions = await download(opened, "#paint-save", resolve(folder, "regions.json"));
  const painted = await download(opened, "#paint-car", resolve(folder, "painted.car")), byHand = resolve(folder, "by_hand.car");
  assert.equal(await start("bake", car, "--regions", regions, "-o", byHand).ended, 0);
  assert.ok(readFileSync(painted).equals(readFileSync(byHand)), "the page's car is another than that of its regions file");
  const told = await info(painted), hash = /\b[0-9a-f]{16}\b/.exec(told)[0];
  assert.match(told, /regions body hood cell\n/);
  assert.match(told, /\([1-9]\d* anchored\)/);
  assert.notEqual(hash, asset);
  await until("the painted car in the scene", () => live.cars.get("painted")?.surface.asset === hash);

  await checkParts(opened, answered, folder);

  // The car is hit, and hit again after a slider has made it stiff: the server has taken the parameters from the page.
  const soft = await hit(live, folder, options);
  await commander.despawn("painted");
  await commander.spawn("painted", hash, "page", origin);
  await until("the car as new", () => live.cars.get("painted")?.surface.quanta.every((q) => q === 0));
  await opened.click("#tune summary");
  await opened.waitForFunction(() => document.querySelectorAll("#tune-region option").length === 4);
  await opened.fill('[aria-label="young modulus, number"]', "1e12");
  await opened.keyboard.press("Enter");
  await answered(/refused: .*young_modulus.* allowed are 10000 to 1e\+10 Pa/);
  await opened.evaluate(() => {
    const slider = document.querySelector("#tune-young_modulus");
    slider.value = Number(slider.value) + 100;
    slider.dispatchEvent(new Event("input"));
  });
  await answered(/painted, all regions: young_modulus [\d.e]+/);
  const [preset] = JSON.parse(readFileSync(await download(opened, "#tune-save", resolve(folder, "preset.json")), "utf8")).parameters;
  assert.ok(preset.young_modulus > 3e7, "the preset is not what the slider says");
  const stiff = await hit(live, folder, options);
  assert.ok(soft > 0.1 && stiff < 0.8 * soft, `the slider changed nothing: ${soft} m, and ${stiff} m when stiff`);
  await opened.click("#tune-repair");
  await answered(/painted is repaired/);
  await until("that it is repaired", () => live.cars.get("painted").surface.quanta.every((q) => q === 0));
  const [chooser] = await Promise.all([opened.waitForEvent("filechooser"), opened.click("#tune-load")]);
  await chooser.setFiles(resolve(here, "../../clients/presets/stiff_old.json"));
  await answered(/painted has stiff_old\.json/);
  assert.deepEqual(console_, [], "the console is not clean");
  await browser.close();
  live.close();

  // The recording has everything, also the painted car.
  await end(gateway);
  assert.equal(await end(server), 0);
  const verified = start("replay", recording, "--verify");
  assert.equal(await verified.ended, 0, verified.text);
  const film = Film.read(new Uint8Array(readFileSync(recording)));
  film.seek(film.duration);
  assert.deepEqual(film.cars.get("painted")?.baked?.regions, ["body", "hood", "cell"]);
  console.log(`painted ${hash}; dents of ${(1000 * soft).toFixed(0)} mm, and ${(1000 * stiff).toFixed(0)} mm when stiff`);
}

// ---- the package's manual ----

// Makes the page of the manual with the manual's commands. Only npm's packages are linked from WEB, because npm needs the network.
async function manual(path) {
  const root = resolve(here, "../.."), folder = resolve(root, "build/mine"), packages = `${folder}/node_modules`;
  const text = readFileSync(resolve(root, "clients/web/README.md"), "utf8");
  const [, example, install, commands, shows] =
    /```ts\n(.*?)```.*```sh\nserver\/setup crumple web\n.*(^npm install .*?\n)(.*)^\.\.\/crumple (view \S+ --page \S+).*```/ms.exec(text);
  rmSync(folder, { recursive: true, force: true });
  mkdirSync(`${packages}/crumple-web`, { recursive: true });
  for (const name of readdirSync(`${web}/node_modules`)) symlinkSync(`${web}/node_modules/${name}`, `${packages}/${name}`);
  for (const name of ["package.json", "dist"]) cpSync(`${web}/${name}`, `${packages}/crumple-web/${name}`, { recursive: true });
  for (const name of install.match(/(?<= )[a-z@][\w@/]+/g).slice(1)) assert.ok(existsSync(`${packages}/${name}`), `${name} is not there`);
  writeFileSync(`${folder}/page.ts`, example);
  process.chdir(folder);
  execFileSync("bash", ["-ec", `PATH=$PWD/../venv/bin:$PATH\n${commands}`], { stdio: "inherit" });
  const gateway = start(...shows.split(" "), "--listen", "127.0.0.1:0");
  const { browser, opened, console_ } = await openPage(path, await address(gateway), { viewport: { width: 360, height: 240 } });
  await opened.waitForFunction(() => /mononofu/.test(document.querySelector("p")?.textContent));
  const late = new Promise((_, failed) => setTimeout(failed, patience, new Error("no dent came")));
  const [whole, dented] = await Promise.race([opened.evaluate(sizes), late]);
  console.log(`the car is ${(100 * whole).toFixed(1)} % of the picture, and ${(100 * dented).toFixed(1)} % when dented`);
  assert.ok(whole > 0.03, "there is hardly a car");
  assert.deepEqual(console_, [], "the console is not clean");
  await browser.close();
  await end(gateway);
}

// Runs in the page, after its drawing in each frame: returns the largest share of red pixels (the car is red), and a later smaller
// one. The camera follows the car, so the share shrinks only if the car is crushed.
function sizes() {
  const canvas = document.querySelector("canvas"), { width, height } = canvas;
  const pen = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
  let whole = 0;
  return new Promise((done) => {
    const look = () => {
      pen.drawImage(canvas, 0, 0);
      const { data } = pen.getImageData(0, 0, width, height);
      let count = 0;
      for (let i = 0; i < data.length; i += 4) count += data[i] - data[i + 2] > 60;
      const seen = count / (width * height);
      whole = Math.max(whole, seen);
      if (seen > 0.5 * whole && seen < 0.97 * whole) done([whole, seen]);
      else requestAnimationFrame(look);
    };
    requestAnimationFrame(look);
  });
}

// Runs in the page: returns the mean difference of two pictures, and the share of pixels that differ by more than a fifth.
async function compare(pictures) {
  const [a, b] = await Promise.all(pictures.map(async (source) => {
    const picture = new Image();
    picture.src = source;
    await picture.decode();
    const pen = new OffscreenCanvas(picture.width, picture.height).getContext("2d");
    pen.drawImage(picture, 0, 0);
    return pen.getImageData(0, 0, picture.width, picture.height);
  }));
  if (a.width !== b.width || a.height !== b.height) return { mean: 1, far: 1 };
  let sum = 0, far = 0;
  for (let i = 0; i < a.data.length; i += 4) {
    const differs = [0, 1, 2].map((k) => Math.abs(a.data[i + k] - b.data[i + k]) / 255);
    sum += (differs[0] + differs[1] + differs[2]) / 3;
    far += Math.max(...differs) > 0.2;
  }
  return { mean: sum / (a.data.length / 4), far: far / (a.data.length / 4) };
}

// A model as a game has it: in the source's coordinates under a node that is turned, scaled and moved, in centimetres, and each triangle
// with vertices of its own. Returns its vertices in the node's coordinates, the baked vertex of each, and the bytes of a GLB.
function modelOf(baked, THREE, moved) {
  const m = baked.sourceToCar, toCar = new THREE.Matrix4().set(...m, 0, 0, 0, 1);
  const node = new THREE.Matrix4().compose(new THREE.Vector3(1, 2, 3), new THREE.Quaternion(0.5, -0.5, 0.5, 0.5), new THREE.Vector3(0.01, 0.01, 0.01));
  const placed = node.clone().setPosition(1 + moved, 2, 3); // moved: m, out of place
  const inside = toCar.clone().multiply(node).invert(), { triangle, vertex } = baked, v = new THREE.Vector3();
  const position = new Float32Array(3 * triangle.length), normal = new Float32Array(3 * triangle.length);
  triangle.forEach((from, i) => v.fromArray(vertex, 3 * from).applyMatrix4(inside).toArray(position, 3 * i));
  for (let i = 0; i < triangle.length; i += 3) {
    const [a, b, c] = [0, 1, 2].map((k) => new THREE.Vector3().fromArray(position, 3 * (i + k)));
    const flat = b.sub(a).cross(c.sub(a)).normalize();
    for (let k = 0; k < 3; ++k) flat.toArray(normal, 3 * (i + k));
  }
  const bounds = [0, 1, 2].map((axis) => position.filter((_, i) => i % 3 === axis)).map((list) => [Math.min(...list), Math.max(...list)]);
  const bytes = position.byteLength, accessor = { componentType: 5126, count: triangle.length, type: "VEC3" };
  const json = JSON.stringify({
    asset: { version: "2.0" }, scene: 0, scenes: [{ nodes: [0] }], nodes: [{ matrix: placed.elements, mesh: 0 }],
    meshes: [{ primitives: [{ attributes: { POSITION: 0, NORMAL: 1 }, material: 0 }] }],
    materials: [{ pbrMetallicRoughness: { baseColorFactor: [0, 1, 0, 1], metallicFactor: 0 }, emissiveFactor: [0, 1, 0] }],
    accessors: [{ ...accessor, bufferView: 0, min: bounds.map(([low]) => low), max: bounds.map(([, high]) => high) }, { ...accessor, bufferView: 1 }],
    bufferViews: [0, bytes].map((byteOffset) => ({ buffer: 0, byteOffset, byteLength: bytes })), buffers: [{ byteLength: 2 * bytes }],
  });
  const head = Buffer.from(json.padEnd(4 * Math.ceil(json.length / 4))), words = (...list) => Buffer.from(Uint32Array.from(list).buffer);
  const glb = Buffer.concat([words(0x46546c67, 2, 28 + head.length + 2 * bytes, head.length, 0x4e4f534a), head, words(2 * bytes, 0x004e4942),
    Buffer.from(position.buffer), Buffer.from(normal.buffer)]);
  return { position, normal, inside, glb };
}

// Positions must be those of the baked vertices, and normals those of the flat triangles.
async function checkOwnModel(baked, THREE) {
  const { OwnModel } = await import(pathToFileURL(resolve(web, "dist/three.js")));
  const { position, normal, inside } = modelOf(baked, THREE, 0);
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(position, 3));
  geometry.setAttribute("normal", new THREE.BufferAttribute(normal, 3));
  const mesh = new THREE.Mesh(geometry), toCar = new THREE.Matrix4().set(...baked.sourceToCar, 0, 0, 0, 1);
  mesh.applyMatrix4(toCar.clone().invert().multiply(inside.clone().invert()));
  const own = new OwnModel(baked, new THREE.Group().add(mesh)), v = new THREE.Vector3();
  assert.equal(own.onVertices, baked.triangle.length);
  const skinned = baked.vertex.map((x, i) => (i % 3 ? x : x + 0.2 * baked.vertex[i + 2])); // sheared
  own.update(skinned);
  const now = mesh.geometry.attributes;
  let worst = 0, turned = 0;
  for (let i = 0; i < baked.triangle.length; i += 3) {
    const corner = [0, 1, 2].map((k) => new THREE.Vector3().fromArray(skinned, 3 * baked.triangle[i + k]).applyMatrix4(inside));
    corner.forEach((wanted, k) => (worst = Math.max(worst, v.fromBufferAttribute(now.position, i + k).distanceTo(wanted))));
    const flat = corner[1].clone().sub(corner[0]).cross(corner[2].clone().sub(corner[0])).normalize();
    for (let k = 0; k < 3; ++k) turned += v.fromBufferAttribute(now.normal, i + k).dot(flat) / baked.triangle.length;
  }
  assert.ok(worst < 0.01, `${worst} cm from where the baked vertex is`);
  assert.ok(turned > 0.998, `normals and triangles agree by ${turned} on average`);
  own.update(baked.vertex);
  assert.ok(now.position.array.every((x, i) => x === position[i]), "at rest it has its own numbers");
}

async function model(path) {
  const THREE = await import(pathToFileURL(resolve(web, "node_modules/three/build/three.module.js"))); // the one that dist/three.js uses
  const bytes = new Uint8Array(readFileSync(car)), baked = readCar(bytes, digits(hashOf(bytes)));
  assert.ok(baked.sourceToCar, `${car} is from an older program: remove it`);
  await checkOwnModel(baked, THREE);

  const folder = mkdtempSync(resolve(tmpdir(), "crumple_model_"));
  const fits = resolve(folder, "fits.glb"), other = resolve(folder, "other.glb");
  writeFileSync(fits, modelOf(baked, THREE, 0).glb);
  writeFileSync(other, modelOf(baked, THREE, 1.5).glb);
  const server = start("serve", "--car", car, "--listen", "tcp/127.0.0.1:0", "--scene", "model");
  const options = ["--connect", await said(server, /at (tcp\S+),/), "--scene", "model"];
  const url = await address(view(...options, "--listen", "127.0.0.1:0"));
  const { browser, opened } = await openPage(path, url, { viewport: { width: 560, height: 320 } });
  assert.equal(await start("drive", resolve(here, "../../clients/scenes/pole.json"), "--car", car, ...options, "--id", "dented", "--leave").ended, 0);
  await opened.waitForFunction(() => window.crumple.shown.get("dented")?.mesh?.deepest > 0.1);
  const refused = opened.waitForEvent("dialog");
  const choosing = opened.setInputFiles("#file", other);
  const dialog = await refused;
  assert.match(dialog.message(), /other.glb cannot be shown: the model is not built-in/);
  await dialog.accept();
  await choosing;
  await opened.setInputFiles("#file", fits);
  await opened.waitForFunction(() => window.crumple.shown.get("dented").own);
  const shown = await opened.evaluate(() => {
    const { own, mesh } = window.crumple.shown.get("dented");
    return { all: own.vertices === own.onVertices, own: own.visible, mesh: mesh.visible };
  });
  assert.deepEqual(shown, { all: true, own: true, mesh: false });
  const green = async () => (await pixels(opened)).filter(([r, g, b]) => g > 200 && r < 120 && b < 120).length;
  assert.ok((await green()) > 300, "the model is not drawn in its own material");
  await opened.keyboard.press("c"); // colours show the baked surface
  await opened.waitForFunction(() => !window.crumple.shown.get("dented").own.visible && window.crumple.shown.get("dented").mesh.visible);
  await browser.close();
  rmSync(folder, { recursive: true });
}

// The pixels of the page's own small picture: red, green, blue.
async function pixels(opened) {
  return opened.evaluate(async () => {
    const image = new Image();
    image.src = `data:image/png;base64,${window.crumple.picture()}`;
    await image.decode();
    const pen = new OffscreenCanvas(image.width, image.height).getContext("2d");
    pen.drawImage(image, 0, 0);
    const { data } = pen.getImageData(0, 0, image.width, image.height), out = [];
    for (let i = 0; i < data.length; i += 4) out.push([data[i], data[i + 1], data[i + 2]]);
    return out;
  });
}

let code = 1;
try {
  const path = chromium();
  if (mode === "client") await client();
  else if (mode === "repaint") await repaint();
  else if (!path) console.log("skipped: there is no Chromium; apt-get install chromium-headless-shell (tests/run does)");
  else await ({ compare: comparison, control, model, manual }[mode] ?? page)(path, mode === "keep");
  code = mode === "client" || mode === "repaint" || path ? 0 : 77;
} catch (error) {
  console.error(error);
} finally {
  for (const { child } of children) child.kill("SIGKILL");
}
process.exit(code);
