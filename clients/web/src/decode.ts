// Decodes messages of schema/message.fbs into typed arrays and plain objects. Units are SI. In the world z is up; a car has x forward,
// y left and z up. Functions refuse a malformed message, which changes nothing; they throw nothing and know no network.
import { ByteBuffer } from "flatbuffers";
import xxhash, { type XXHashAPI } from "xxhash-wasm";
import { Delta } from "./crumple/schema/delta.js";
import { Health as HealthTable } from "./crumple/schema/health.js";
import { Keyframe } from "./crumple/schema/keyframe.js";
import { Obstacles } from "./crumple/schema/obstacles.js";
import type { Pose as PoseStruct } from "./crumple/schema/pose.js";
import { Poses } from "./crumple/schema/poses.js";
import { Reactions } from "./crumple/schema/reactions.js";
import { Shape } from "./crumple/schema/shape.js";

export { Shape };

/** Nodes of one block of `packed`. */
const block = 16;
const mostNodes = 200_000;

const hashes: XXHashAPI = await xxhash();

/** Gives the XXH64 of bytes, as messages and the names of assets have it. */
export function hashOf(bytes: Uint8Array): bigint {
  return hashes.h64Raw(bytes);
}

/** Gives a hash as 16 hexadecimal digits, as `crumple watch` prints it. */
export function digits(hash: bigint): string {
  return hash.toString(16).padStart(16, "0");
}

// Beyond the end of a message FlatBuffers' readers give undefined or throw a RangeError; nothing has changed by then.
function attempt<T>(read: () => T): T | null {
  try {
    return read();
  } catch {
    return null;
  }
}

/**
 * Unpacks the numbers of a part as schema/message.fbs packs them: x, y, z of each node, modulo 2^16. null: the words are too few or too
 * many for them.
 */
export function unpack(words: Uint16Array, count: number): Int16Array | null {
  const out = new Int16Array(3 * count);
  const last = [0, 0, 0];
  let at = 0;
  for (let first = 0; first < count; first += block) {
    if (at === words.length) return null;
    const head = words[at++];
    const nodes = Math.min(block, count - first);
    if (head >> 15) return null;
    for (let axis = 0; axis < 3; ++axis) {
      const width = (head >> (5 * axis)) & 31;
      if (width > 16 || at + width > words.length) return null;
      const mask = (1 << width) - 1;
      let waiting = 0, bits = 0, from = at, value = last[axis];
      for (let k = 0; k < nodes; ++k) {
        if (bits < width) {
          waiting |= words[from++] << bits; // below 2^31: fewer than 16 bits wait
          bits += 16;
        }
        const zigzag = waiting & mask;
        waiting >>>= width;
        bits -= width;
        value += (zigzag >> 1) ^ -(zigzag & 1);
        out[3 * (first + k) + axis] = value;
      }
      last[axis] = value & 0xffff;
      at += width;
    }
  }
  return at === words.length ? out : null;
}

/** whole: the surface is a newer one now. part: other parts of this tick are missing. old: the surface is as new already. */
export type Outcome = "whole" | "part" | "old" | "missing keyframe" | "refused";

interface Part {
  first: number;
  nodes: number;
  numbers: Int16Array;
}

function readPart(message: Keyframe | Delta): Part | null {
  const nodes = message.nodeCount(), count = message.count(), first = message.first();
  if (nodes === 0 || nodes > mostNodes || count === 0 || count > nodes || first > nodes - count) return null;
  const words = message.packedArray();
  const numbers = words && unpack(words, count);
  return numbers && { first, nodes, numbers };
}

/** The parts of one tick that have come, while others are missing. */
interface Gathering {
  tick: bigint;
  hash: bigint;
  quanta: Int16Array;
}

function gathers(parts: Gathering | null, tick: bigint, hash: bigint, size: number): parts is Gathering {
  return parts?.tick === tick && parts.hash === hash && parts.quanta.length === size;
}

function complete(parts: Gathering): boolean {
  const { buffer, byteOffset, byteLength } = parts.quanta;
  return hashOf(new Uint8Array(buffer, byteOffset, byteLength)) === parts.hash;
}

/** Holds the surface of one car on one surface level. Messages may be lost, repeated or reordered. */
export class Surface {
  /** The newest tick of which every part has come; 0: none yet. */
  tick = 0n;
  hash = 0n;
  /** m */
  quantum = 0;
  /** Hash of the baked car, 16 digits. */
  asset = "";
  /** Displacements from rest in quanta, 3 for each node of the skin, car's frame. A newer surface is another array. */
  quanta: Int16Array = new Int16Array(0);

  #key: Int16Array = new Int16Array(0);
  #keyTick = 0n;
  #keyParts: Gathering | null = null;
  #deltaParts: Gathering | null = null;

  takeKeyframe(bytes: Uint8Array): Outcome {
    return attempt(() => this.#keyframe(Keyframe.getRootAsKeyframe(new ByteBuffer(aligned(bytes))))) ?? "refused";
  }

  takeDelta(bytes: Uint8Array): Outcome {
    return attempt(() => this.#delta(Delta.getRootAsDelta(new ByteBuffer(aligned(bytes))))) ?? "refused";
  }

  #keyframe(message: Keyframe): Outcome {
    const part = readPart(message);
    const tick = message.tick(), hash = message.hash(), asset = message.asset(), quantum = message.quantum();
    if (!part || !(quantum > 0 && quantum <= 1) || asset?.length !== 16) return "refused";
    if (this.#key.length > 0 && tick <= this.#keyTick) return "old";
    if (this.#keyParts && tick < this.#keyParts.tick) return "old";
    const size = 3 * part.nodes;
    const parts = gathers(this.#keyParts, tick, hash, size) ? this.#keyParts : { tick, hash, quanta: new Int16Array(size) };
    this.#keyParts = parts;
    parts.quanta.set(part.numbers, 3 * part.first);
    if (!complete(parts)) return "part";
    this.#key = parts.quanta;
    this.#keyTick = tick;
    this.#keyParts = null;
    const newer = this.quanta.length === 0 || tick > this.tick;
    this.asset = asset;
    this.quantum = quantum;
    if (!newer) return "old"; // deltas gave the surface of this very tick; the next deltas are against this keyframe
    this.tick = tick;
    this.hash = hash;
    this.quanta = this.#key;
    return "whole";
  }

  #delta(message: Delta): Outcome {
    const part = readPart(message);
    const tick = message.tick(), hash = message.hash(), keyframe = message.keyframe();
    if (!part || keyframe > tick) return "refused";
    if (this.quanta.length > 0 && tick <= this.tick) return "old";
    if (this.#key.length === 0 || keyframe > this.#keyTick) return "missing keyframe";
    if (keyframe < this.#keyTick) return "old";
    const size = 3 * part.nodes;
    if (this.#key.length !== size) return "refused";
    if (this.#deltaParts && tick < this.#deltaParts.tick) return "old";
    const parts = gathers(this.#deltaParts, tick, hash, size) ? this.#deltaParts : { tick, hash, quanta: this.#key.slice() };
    this.#deltaParts = parts;
    for (let i = 0, at = 3 * part.first; i < part.numbers.length; ++i, ++at)
      parts.quanta[at] = this.#key[at] + part.numbers[i]; // an Int16Array wraps around, as the schema says
    if (!complete(parts)) return "part";
    this.tick = tick;
    this.hash = hash;
    this.quanta = parts.quanta;
    this.#deltaParts = null;
    return "whole";
  }
}

// FlatBuffers reads vectors in place, so a message has to begin at a multiple of 8.
function aligned(bytes: Uint8Array): Uint8Array {
  return bytes.byteOffset % 8 === 0 ? bytes : bytes.slice();
}

export type Vec3 = [number, number, number];

/** world = orientation (x, y, z, w) * local + position */
export interface Pose {
  position: Vec3;
  orientation: [number, number, number, number];
}

interface Triple {
  x(): number;
  y(): number;
  z(): number;
}
const vec3 = (v: Triple | null): Vec3 => (v ? [v.x(), v.y(), v.z()] : [0, 0, 0]);

function poseOf(pose: PoseStruct | null): Pose {
  const q = pose!.orientation()!;
  return { position: vec3(pose!.position()), orientation: [q.x(), q.y(), q.z(), q.w()] };
}

function* each<T>(length: number, at: (i: number) => T | null): Generator<T> {
  for (let i = 0; i < length; ++i) yield at(i)!;
}

export interface CarPose {
  car: string;
  pose: Pose;
  velocity: Vec3;
  /** The tick of the last reaction that the pose contains. */
  seen: bigint;
}

export function readPoses(bytes: Uint8Array): CarPose[] | null {
  return attempt(() => {
    const message = Poses.getRootAsPoses(new ByteBuffer(bytes));
    return Array.from(each(message.carsLength(), (i) => message.cars(i)), (car) => ({
      car: car.car()!, pose: poseOf(car.pose()), velocity: vec3(car.velocity()), seen: car.seen(),
    }));
  });
}

export interface Reaction {
  car: string;
  tick: bigint;
  /** In this tick, N s, world. */
  impulse: Vec3;
  pose: Pose;
  velocity: Vec3;
  /** J since spawn. */
  absorbed: number;
  contacts: number;
  /** The cars that touched it in this tick, and what each of them gave it, N s, world. */
  partners: { car: string; host: string; impulse: Vec3; contacts: number }[];
}

/** time: s, by the server's ticks */
export function readReactions(bytes: Uint8Array): { tick: bigint; time: number; cars: Reaction[] } | null {
  return attempt(() => {
    const message = Reactions.getRootAsReactions(new ByteBuffer(bytes));
    const tick = message.tick();
    const cars = Array.from(each(message.carsLength(), (i) => message.cars(i)), (car) => ({
      car: car.car()!, tick, impulse: vec3(car.impulse()), pose: poseOf(car.pose()), velocity: vec3(car.velocity()),
      absorbed: car.energyAbsorbed(), contacts: car.contacts(),
      partners: Array.from(each(car.partnersLength(), (i) => car.partners(i)), (it) => ({
        car: it.car()!, host: it.host()!, impulse: vec3(it.impulse()), contacts: it.contacts(),
      })),
    }));
    return { tick, time: message.time(), cars };
  });
}

export interface Obstacle {
  id: number;
  shape: Shape;
  /** box: half extents; sphere: radius; capsule: radius, half the length of its axis (local z). */
  size: Vec3;
  /** Of a hull: m, in its own frame. */
  points: Vec3[];
  pose: Pose;
  velocity: Vec3;
  angularVelocity: Vec3;
}

export function readObstacles(bytes: Uint8Array): Obstacle[] | null {
  return attempt(() => {
    const message = Obstacles.getRootAsObstacles(new ByteBuffer(bytes));
    return Array.from(each(message.obstaclesLength(), (i) => message.obstacles(i)), (it) => ({
      id: it.id(), shape: it.shape(), size: vec3(it.size()),
      points: Array.from(each(it.pointsLength(), (i) => it.points(i)), vec3),
      pose: poseOf(it.pose()), velocity: vec3(it.velocity()), angularVelocity: vec3(it.angularVelocity()),
    }));
  });
}

export interface Count {
  name: string;
  value: number;
  /** 0: none */
  limit: number;
}

export interface Health {
  tick: number;
  /** Ticks a second. */
  rate: number;
  /** How many ticks began late. */
  late: number;
  /** What the parts of a tick took in the last second, ms: mean and worst; the room "tick" is all of it. */
  rooms: { name: string; mean: number; worst: number }[];
  counts: Count[];
  refusals: Count[];
}

export function readHealth(bytes: Uint8Array): Health | null {
  return attempt(() => {
    const message = HealthTable.getRootAsHealth(new ByteBuffer(bytes));
    const count = (it: { name(): string | null; value(): bigint; limit(): bigint }): Count =>
      ({ name: it.name()!, value: Number(it.value()), limit: Number(it.limit()) });
    return {
      tick: Number(message.tick()), rate: message.rate(), late: Number(message.late()),
      rooms: Array.from(each(message.roomsLength(), (i) => message.rooms(i)), (room) =>
        ({ name: room.name()!, mean: room.milliseconds(), worst: room.worst() })),
      counts: Array.from(each(message.countsLength(), (i) => message.counts(i)), count),
      refusals: Array.from(each(message.refusalsLength(), (i) => message.refusals(i)), count),
    };
  });
}
