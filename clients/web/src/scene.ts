// Holds what a viewer knows of a scene. Entries bring it up to date; each replaces the entry before it under its key. Keys and bytes are
// those of zenoh, below the scene's root, and there are three more keys:
//
//   alive             text, a line for each of zenoh's liveliness tokens: "server", "car ID LIFE"; another LIFE means another car
//   car/ID/reactions  Reactions, of which only this car's counts: the last reaction of the car
//   car/ID/peak       Reactions likewise: the strongest reaction of the last hit
import type { BakedCar } from "./baked.js";
import { readHealth, readObstacles, readPoses, readReactions, Surface } from "./decode.js";
import type { Health, Obstacle, Pose, Reaction, Vec3 } from "./decode.js";

/** How many deltas "bits per vertex and frame" is the mean of. */
const rated = 60;
/** ms for which the pose of a contact counts more than the pose of a host that follows a script. */
const contactHolds = 250;

export class LiveCar {
  surface = new Surface();
  /** null: the asset has not come yet. After the car was painted anew it is another one. */
  baked: BakedCar | null = null;
  /** null: neither its host nor a reaction has given one yet. */
  pose: Pose | null = null;
  velocity: Vec3 = [0, 0, 0];
  /** The last reaction with contact or impulse, and when it came. */
  hit: Reaction | null = null;
  hitAt = 0;
  /** The reaction of the last hit with the greatest impulse, and when it came. */
  peak: Reaction | null = null;
  peakAt = 0;
  /** J since spawn. */
  absorbed = 0;
  /** When the last message about the car came. */
  heardAt = 0;
  /** Counts the surfaces of which every part has come. */
  version = 0;
  refused = 0;
  #sizes: number[] = []; // bytes of the last deltas

  constructor(readonly id: string, public life: string) {}

  /** Mean of the last deltas that came to this page; 0: none yet. */
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

  /** @internal The pose that the server reached in a contact counts until a pose of the host contains it. */
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
  /** When the list came. Since then obstacles that have a velocity move on. */
  at: number;
}

export interface Entry {
  key: string;
  /** When the message was sent, by the scene's clock, ms. */
  at: number;
  payload: Uint8Array;
}

export class Scene {
  /** Whether the scene has a server now. */
  server = false;
  cars = new Map<string, LiveCar>();
  /** By host. */
  obstacles = new Map<string, HostObstacles>();
  health: Health | null = null;
  healthAt = 0;
  /** Counts batches of entries and assets that came. */
  version = 0;
  /** Baked cars, by hash. */
  assets = new Map<string, BakedCar>();

  /** The time now by the scene's clock, ms. */
  now(): number {
    return performance.now();
  }

  take(entries: Entry[]): void {
    ++this.version;
    // The tokens come first, because they say which cars the other messages belong to.
    for (const { key, payload } of entries) if (key === "alive") this.#takeAlive(new TextDecoder().decode(payload));
    for (const { key, payload, at } of entries) this.#takeEntry(key.split("/"), payload, at);
  }

  /** Takes the baked car that `want` asked for. */
  give(asset: string, baked: BakedCar): void {
    this.assets.set(asset, baked);
    ++this.version;
    for (const car of this.cars.values()) if (car.surface.asset === asset) car.baked = baked;
  }

  /** The scene calls this for every message of a car whose baked car is missing. */
  protected want(_asset: string): void {}

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
        for (const reaction of readReactions(payload)?.cars ?? []) if (reaction.car === id) car.takeReaction(reaction, at);
      } else if (what === "peak") {
        car.peak = readReactions(payload)?.cars.find((reaction) => reaction.car === id) ?? car.peak;
        car.peakAt = at;
      } else {
        car.takeSurface(what === "key", payload, at);
        if (car.surface.asset) this.#dress(car);
      }
    }
  }

  #dress(car: LiveCar): void {
    const { asset } = car.surface;
    car.baked = this.assets.get(asset) ?? null;
    if (!car.baked) this.want(asset);
  }
}
