// A connection to `crumple view`: one WebSocket, on which the page is brought up to what the scene is now, again and again. A message
// is a batch of entries, each under the key that zenoh has below the scene's root, with the very bytes that zenoh carries:
//
//   u16 size of the key, u32 size of the payload, u32 its age in ms, the key, the payload      (little endian)
//
// An entry replaces the one before it under its key. The gateway skips what is outdated before it could be sent, and goes on when a
// batch was answered, with an empty message: so a page that was frozen finds the present, not its past.
// The gateway's own are "alive", what zenoh's liveliness tokens say, a line each: "server", "car ID LIFE" (another LIFE is another
// car), and of Reactions, which come here one car each, "car/ID/reactions", the last, and "car/ID/peak", the strongest of the last hit.
import { readCar, type BakedCar } from "./baked.js";
import { readHealth, readObstacles, readPoses, readReactions, Surface } from "./decode.js";
import type { Health, Obstacle, Pose, Reaction, Vec3 } from "./decode.js";

/** Deltas that "bits per vertex and frame" is the mean of. */
const rated = 60;
/** ms, after a lost connection; doubled up to the last. */
const firstRetry = 250, lastRetry = 4000;
/** ms until an asset that was not there yet is asked for again. */
const assetRetry = 300;
/** ms for which the pose of a contact stands against that of a host that follows a script. */
const contactHolds = 250;

export class LiveCar {
  surface = new Surface();
  /** null: the asset has not arrived. */
  baked: BakedCar | null = null;
  /** null: neither its host nor a reaction has told it yet. */
  pose: Pose | null = null;
  velocity: Vec3 = [0, 0, 0];
  /** The last one with contact or impulse, and when it came (performance.now()). */
  hit: Reaction | null = null;
  hitAt = 0;
  /** Of the last hit that with the greatest impulse. */
  peak: Reaction | null = null;
  peakAt = 0;
  /** J since spawn. */
  absorbed = 0;
  /** When the last message about it came. */
  heardAt = 0;
  /** Counts up with every surface held whole. */
  version = 0;
  refused = 0;
  #sizes: number[] = []; // bytes of the last deltas

  constructor(readonly id: string, public life: string) {}

  /** Of the last deltas, at this page; 0: none yet. */
  get bitsPerVertex(): number {
    const vertices = this.baked ? this.baked.vertex.length / 3 : 0;
    if (!vertices || !this.#sizes.length) return 0;
    return (8 * this.#sizes.reduce((sum, size) => sum + size, 0)) / this.#sizes.length / vertices;
  }

  /** @internal */
  takeSurface(keyframe: boolean, bytes: Uint8Array, at: number): void {
    const outcome = keyframe ? this.surface.takeKeyframe(bytes) : this.surface.takeDelta(bytes);
    if (outcome === "whole") ++this.version;
    if (outcome === "refused") ++this.refused;
    if (!keyframe && this.#sizes.push(bytes.length) > rated) this.#sizes.shift();
    this.heardAt = Math.max(this.heardAt, at);
  }

  /** @internal What the server reached in a contact stands until a pose of the host contains it. */
  takeReaction(reaction: Reaction, at: number): void {
    this.heardAt = Math.max(this.heardAt, at);
    this.absorbed = reaction.absorbed;
    if (reaction.contacts === 0 && reaction.impulse.every((x) => x === 0)) return;
    this.hit = reaction;
    this.hitAt = at;
    this.pose = reaction.pose;
    this.velocity = reaction.velocity;
  }

  /** @internal */
  takePose(pose: Pose, velocity: Vec3, seen: bigint, at: number): void {
    this.heardAt = Math.max(this.heardAt, at);
    const stands = this.hit && (seen === 0n ? at - this.hitAt < contactHolds : seen < this.hit.tick);
    if (stands) return;
    this.pose = pose;
    this.velocity = velocity;
  }
}

export interface HostObstacles {
  list: Obstacle[];
  /** When their list came: those with a velocity move on since then. */
  at: number;
}

export type Link = "connecting" | "live" | "lost";

export class Live {
  link: Link = "connecting";
  /** Whether the scene has a server now. */
  server = false;
  cars = new Map<string, LiveCar>();
  /** By host. */
  obstacles = new Map<string, HostObstacles>();
  health: Health | null = null;
  healthAt = 0;
  /** When the last batch came. */
  heardAt = 0;
  received = { batches: 0, bytes: 0 };
  /** Assets that could not be shown: a sentence each. */
  trouble = new Map<string, string>();

  #url: URL;
  #socket: WebSocket | null = null;
  #retry = firstRetry;
  #assets = new Map<string, BakedCar | "asked">();
  #closed = false;

  /** url: of the page that `crumple view` serves, such as http://127.0.0.1:8080/ */
  constructor(url: string | URL) {
    this.#url = new URL(url);
    this.#connect();
  }

  close(): void {
    this.#closed = true;
    this.#socket?.close();
  }

  #connect(): void {
    const url = new URL("live", this.#url);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    const socket = (this.#socket = new WebSocket(url));
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => {
      this.link = "live";
      this.#retry = firstRetry;
      this.#take(new Uint8Array(data as ArrayBuffer));
      if (socket.readyState === WebSocket.OPEN) socket.send(new Uint8Array(0));
    };
    socket.onclose = () => {
      this.link = "lost";
      if (this.#closed) return;
      setTimeout(() => this.#connect(), this.#retry);
      this.#retry = Math.min(2 * this.#retry, lastRetry);
    };
  }

  #take(batch: Uint8Array): void {
    const now = performance.now();
    this.heardAt = now;
    ++this.received.batches;
    this.received.bytes += batch.length;
    const view = new DataView(batch.buffer, batch.byteOffset, batch.length), text = new TextDecoder();
    const entries: { key: string; at: number; payload: Uint8Array }[] = [];
    for (let at = 0; at < batch.length; ) {
      const keySize = view.getUint16(at, true), size = view.getUint32(at + 2, true), age = view.getUint32(at + 6, true);
      const from = at + 10 + keySize;
      // a copy, so that it begins where its fields are aligned
      entries.push({ key: text.decode(batch.subarray(at + 10, from)), at: now - age, payload: batch.slice(from, from + size) });
      at = from + size;
    }
    // Whose messages the others are, before those.
    for (const { key, payload } of entries) if (key === "alive") this.#takeAlive(text.decode(payload));
    for (const { key, payload, at } of entries) this.#takeEntry(key.split("/"), payload, at);
  }

  #takeAlive(lines: string): void {
    const alive = new Set<string>();
    this.server = false;
    for (const line of lines.split("\n")) {
      const [kind, id, life] = line.split(" ");
      if (kind === "server") this.server = true;
      if (kind !== "car") continue;
      alive.add(id);
      if (this.cars.get(id)?.life !== life) this.cars.set(id, new LiveCar(id, life));
    }
    for (const id of this.cars.keys()) if (!alive.has(id)) this.cars.delete(id);
    if (!this.server) this.obstacles.clear();
  }

  #takeEntry(key: string[], payload: Uint8Array, at: number): void {
    const [kind, id, what] = key;
    if (kind === "health") {
      this.health = readHealth(payload) ?? this.health;
      this.healthAt = at;
    } else if (kind === "host" && what === "obstacles") {
      const list = readObstacles(payload);
      if (list) this.obstacles.set(id, { list, at });
    } else if (kind === "host" && what === "poses") {
      for (const { car, pose, velocity, seen } of readPoses(payload) ?? [])
        this.cars.get(car)?.takePose(pose, velocity, seen, at);
    } else if (kind === "car") {
      const car = this.cars.get(id);
      if (!car) return;
      if (what === "reactions") {
        for (const reaction of readReactions(payload)?.cars ?? []) car.takeReaction(reaction, at);
      } else if (what === "peak") {
        car.peak = readReactions(payload)?.cars[0] ?? car.peak;
        car.peakAt = at;
      } else {
        car.takeSurface(what === "key", payload, at);
        if (!car.baked && car.surface.asset) this.#dress(car);
      }
    }
  }

  #dress(car: LiveCar): void {
    const { asset } = car.surface, held = this.#assets.get(asset);
    if (held === "asked") return;
    if (held) car.baked = held;
    else void this.#fetch(asset);
  }

  async #fetch(asset: string): Promise<void> {
    this.#assets.set(asset, "asked");
    try {
      const answer = await fetch(new URL(`asset/${asset}`, this.#url));
      if (answer.status === 404) throw new Error("the gateway does not have it yet");
      if (!answer.ok) throw new Error(`the gateway answers ${answer.status}`);
      this.#assets.set(asset, readCar(new Uint8Array(await answer.arrayBuffer()), asset));
      this.trouble.delete(asset);
    } catch (error) {
      this.trouble.set(asset, `asset ${asset}: ${error instanceof Error ? error.message : error}`);
      this.#assets.delete(asset);
      if (!this.#closed) await new Promise((wait) => setTimeout(wait, assetRetry));
    }
    for (const car of this.cars.values()) if (car.surface.asset === asset && !this.#closed) this.#dress(car);
  }
}
