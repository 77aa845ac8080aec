// Shows a recording (MCAP, as `crumple serve --record` writes it) as a scene at any moment. It needs nothing but the file, which has
// the baked cars as attachments, or as messages if they came later. It reads a file that was cut off as far as that is whole.
import { McapStreamReader } from "@mcap/core";
import { decompress as fromZstd } from "fzstd";
import { decompress as fromLz4 } from "lz4js";
import { ByteBuffer } from "flatbuffers";
import { readCar } from "./baked.js";
import { Asset } from "./crumple/schema/asset.js";
import { Answer } from "./crumple/schema/answer.js";
import { Command } from "./crumple/schema/command.js";
import { Order } from "./crumple/schema/order.js";
import { digits, hashOf, readReactions } from "./decode.js";
import { Scene, type Entry } from "./scene.js";

/** s without a contact after which the next contact is another hit; the gateway has the same. */
const hitEnds = 1;
/** Bytes that a chunk may hold, and for each that it takes; as the server's reader has it. */
const mostOfChunk = 64 * 1024 * 1024, mostRatio = 256;
const shown = /^(health|host\/[^/]+\/(poses|obstacles)|car\/[^/]+\/(key|delta)\/0)$/;

/** Throws where a chunk would fill the memory. */
function sizeOf(data: Uint8Array, claimed: bigint): number {
  const size = Number(claimed);
  if (size > mostOfChunk || size > mostRatio * data.length) throw new Error(`a chunk of ${data.length} bytes claims to hold ${size}`);
  return size;
}

/** From when to when a car lived, s. */
interface Life {
  id: string;
  from: number;
  to: number;
}

interface Told {
  /** s since the first tick */
  time: number;
  payload: Uint8Array;
}

export class Film extends Scene {
  /** s, counted in ticks: a late tick counts like any other. */
  duration = 0;
  /** The moment that it shows, s. */
  time = 0;
  /** The time of the first tick in which a car touched something, s; null: none did. */
  firstContact: number | null = null;

  #told = new Map<string, Told[]>(); // by key, in order of time
  #taken = new Map<string, Told>(); // by key: the message that the scene has
  #lives: Life[] = [];
  #peaks = new Map<string, { impulse: number; time: number }>(); // by car: greatest impulse of its last hit, time of its last contact
  #despawning = ""; // the key of a Command whose Answer has not come
  #showing = 0;

  override now(): number {
    return 1000 * this.time;
  }

  /** Throws an Error with a sentence if the bytes are no recording. */
  static read(bytes: Uint8Array): Film {
    const film = new Film();
    // A server compresses by LZ4; programs that write a recording anew often compress by zstd.
    const decompressHandlers = {
      lz4: (data: Uint8Array, size: bigint) => fromLz4(data, sizeOf(data, size)),
      zstd: (data: Uint8Array, size: bigint) => fromZstd(data, new Uint8Array(sizeOf(data, size))),
    };
    const reader = new McapStreamReader({ decompressHandlers });
    const topics = new Map<number, string>();
    let first: number | null = null, rate = 60;
    reader.append(bytes);
    for (let record; (record = reader.nextRecord()); ) {
      if (record.type === "Channel") topics.set(record.id, record.topic.split("/").slice(3).join("/"));
      if (record.type === "Attachment" && /^application\/vnd\.crumple\.(given\.)?car$/.test(record.mediaType))
        film.give(record.name, readCar(record.data.slice(), record.name));
      if (record.type === "Metadata") rate = Number(record.metadata.get("rate")) || rate;
      if (record.type !== "Message") continue;
      first ??= record.sequence; // the tick
      const time = Math.max(0, record.sequence - first) / rate;
      film.duration = Math.max(film.duration, time);
      film.#tell(topics.get(record.channelId) ?? "", { time, payload: record.data.slice() });
    }
    if (first === null) throw new Error("there is no message in this recording");
    film.seek(0);
    return film;
  }

  /** Goes to this moment, s, forwards or backwards. */
  seek(time: number): void {
    if (time < this.time) {
      ++this.#showing; // so that the cars of this showing are other ones
      this.#taken.clear();
      this.obstacles.clear();
      this.health = null;
    }
    this.time = Math.min(Math.max(time, 0), this.duration);
    const living = this.#lives.filter(({ from, to }) => from <= this.time && this.time < to);
    const lines = living.map(({ id, from }) => `car ${id} ${this.#showing}:${from}\n`);
    const entries: Entry[] = [{ key: "alive", at: this.now(), payload: new TextEncoder().encode(`server\n${lines.join("")}`) }];
    for (const [key, all] of this.#told) {
      const [kind, id] = key.split("/"), since = kind === "car" ? living.find((life) => life.id === id)?.from : 0;
      const last = since === undefined ? undefined : all[after(all, this.time) - 1];
      if (!last || last.time < since! || this.#taken.get(key) === last) continue;
      this.#taken.set(key, last);
      // a surface may have several parts, which have the same time
      for (let i = after(all, this.time) - 1; i >= 0 && all[i].time === last.time; --i)
        entries.push({ key, at: 1000 * last.time, payload: all[i].payload });
    }
    entries.sort((a, b) => Number(a.key.includes("/delta/")) - Number(b.key.includes("/delta/"))); // keyframes first
    this.take(entries);
  }

  #add(key: string, told: Told): void {
    if (!this.#told.has(key)) this.#told.set(key, []);
    this.#told.get(key)!.push(told);
  }

  #tell(key: string, told: Told): void {
    const [kind, id, what] = key.split("/");
    if (kind === "host" && what === "reactions") this.#tellReactions(told);
    else if (kind === "asset") this.#tellAsset(told.payload);
    else if (kind === "car" && (!what || what === "answer")) this.#tellDespawn(key, id, told);
    else if (shown.test(key)) this.#add(key, told);
    const lives = this.#lives.some((life) => life.id === id && life.to === Infinity);
    if (what === "key" && !lives) this.#lives.push({ id, from: told.time, to: Infinity });
  }

  // A car that the server refused does not read here either.
  #tellAsset(payload: Uint8Array): void {
    try {
      const car = Asset.getRootAsAsset(new ByteBuffer(payload)).carArray()!.slice(), asset = digits(hashOf(car));
      this.give(asset, readCar(car, asset));
    } catch {
      return;
    }
  }

  #tellReactions(told: Told): void {
    for (const { car, impulse, contacts } of readReactions(told.payload)?.cars ?? []) {
      this.#add(`car/${car}/reactions`, told);
      if (contacts === 0) continue;
      this.firstContact ??= told.time;
      const size = Math.hypot(...impulse), peak = this.#peaks.get(car);
      const another = !peak || told.time - peak.time > hitEnds;
      this.#peaks.set(car, { impulse: another ? size : Math.max(size, peak.impulse), time: told.time });
      if (another || size > peak.impulse) this.#add(`car/${car}/peak`, told);
    }
  }

  #tellDespawn(key: string, id: string, told: Told): void {
    if (key === `car/${id}`) {
      if (Command.getRootAsCommand(new ByteBuffer(told.payload)).orderType() === Order.Despawn) this.#despawning = key;
    } else if (key === `${this.#despawning}/answer`) {
      const life = this.#lives.find((one) => one.id === id && one.to === Infinity);
      if (life && Answer.getRootAsAnswer(new ByteBuffer(told.payload)).ok()) life.to = told.time;
      this.#despawning = "";
    }
  }
}

/** How many of these messages came up to this time. */
function after(all: Told[], time: number): number {
  let low = 0, high = all.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (all[middle].time <= time) low = middle + 1;
    else high = middle;
  }
  return low;
}
