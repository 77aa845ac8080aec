// Compares two scenes: two recordings on one clock, or the live scene and a recording. The difference is the distance between the two
// places of a vertex, each in the frame of its car, so it compares shapes, wherever the cars stand.
import * as THREE from "three";
import type { BakedCar } from "../baked.js";
import type { Film } from "../film.js";
import type { LiveCar } from "../scene.js";
import type { CarMesh } from "../three.js";

export interface Clock {
  /** s */
  readonly time: number;
  readonly duration: number;
  seek(seconds: number): void;
}

/**
 * Shows the first contacts of both at the same moment. Recordings begin when a server was started, some time before anything happens,
 * and if one were a tick ahead in a crash, they would differ by what a tick does. If one has no contact, both begin together.
 */
export class BothClocks implements Clock {
  time = 0;
  readonly duration: number;
  /** What the page says about it. */
  readonly aligned: string;
  #ahead: [number, number]; // s after which each begins

  constructor(readonly first: Film, readonly second: Film) {
    const [a, b] = [first.firstContact, second.firstContact];
    this.#ahead = a === null || b === null ? [0, 0] : [Math.max(0, b - a), Math.max(0, a - b)];
    this.aligned = a === null || b === null ? "both begin together: one has no contact" : "first contacts at the same moment";
    this.duration = Math.max(first.duration + this.#ahead[0], second.duration + this.#ahead[1]);
    this.seek(0);
  }

  seek(seconds: number): void {
    this.time = Math.min(Math.max(seconds, 0), this.duration);
    const past = 1e-6; // s, so that rounding does not put one of them before a tick that the other has
    [this.first, this.second].forEach((film, i) => film.seek(this.time - this.#ahead[i] + past));
  }
}

export interface Rectangle {
  left: number;
  top: number;
  width: number;
  height: number;
}

/** Divides a rectangle in two beside each other, or, on a phone, one above the other. */
export function halves({ left, top, width, height }: Rectangle): Rectangle[] {
  if (width > 480) return [0, 1].map((i) => ({ left: left + (i * width) / 2, top, width: width / 2, height }));
  return [0, 1].map((i) => ({ left, top: top + (i * height) / 2, width, height: height / 2 }));
}

/** A car as a page shows it. */
interface Shown {
  car: LiveCar;
  mesh: CarMesh | null;
}

interface Pair {
  shown: [Shown, Shown];
  meshes: [CarMesh, CarMesh];
  versions: [number, number];
  /** The difference of each vertex, m. */
  apart: Float32Array;
  largest: number;
  rms: number;
}

/** Differences that may have the last colour, m. */
const scales = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5];

export class Comparison {
  /** The difference that has the last colour, m. It grows with the differences and never shrinks, so that colours keep their meaning. */
  most = scales[0];
  /** A sentence for each car that cannot be compared. */
  sentences: string[] = [];
  pairs: Pair[] = [];
  #colours: readonly THREE.Color[] | null = null;

  /** clock: null if one is the live scene, which the page shows as it is now; then the recording has its own clock. */
  constructor(readonly names: [string, string], readonly clock: BothClocks | null) {}

  /** Finds pairs of cars and their differences, and paints both cars of each pair, unless `colours` is null. */
  update(left: ReadonlyMap<string, Shown>, right: ReadonlyMap<string, Shown>, colours: readonly THREE.Color[] | null): void {
    const before = this.pairs;
    this.pairs = [];
    this.sentences = [];
    for (const shown of couples(left, right, this.names, this.sentences)) {
      const [a, b] = shown.map(({ mesh }) => mesh);
      if (!a || !b) continue; // its asset has not come yet
      const known = before.find(({ meshes }) => meshes[0] === a && meshes[1] === b);
      const trouble = known ? "" : differs(a.baked, b.baked);
      if (trouble) this.sentences.push(`${shown[0].car.id}: ${trouble}`);
      else this.pairs.push(known ?? makePair(shown, [a, b]));
    }
    const changed = this.pairs.filter(measure);
    const needed = Math.max(0, ...this.pairs.map(({ largest }) => largest));
    const most = Math.max(this.most, scales.find((scale) => scale >= needed) ?? scales.at(-1)!);
    const again = most !== this.most || colours !== this.#colours;
    this.most = most;
    this.#colours = colours;
    if (colours)
      for (const { meshes, apart } of again ? this.pairs : changed) for (const mesh of meshes) mesh.paint(colours, most, apart);
  }

  /** What it found, as the page says it. */
  lines(): string[] {
    const mm = (metres: number) => `${(1000 * metres).toFixed(1)} mm`;
    const found = this.pairs.map(({ shown, largest, rms }) => {
      const [a, b] = shown.map(({ car }) => car.id);
      return `${a === b ? a : `${a} and ${b}`}: differ by ${mm(largest)} at most, ${mm(rms)} RMS`;
    });
    return [...found, ...this.sentences, this.clock?.aligned ?? "the live scene as it is now, the recording at its own time"];
  }

  has(one: Shown): boolean {
    return this.pairs.some(({ shown }) => shown.includes(one));
  }
}

// Cars belong together by id; if no id is the same, and each scene has one car, these two do.
function couples(left: ReadonlyMap<string, Shown>, right: ReadonlyMap<string, Shown>, names: [string, string], sentences: string[]): [Shown, Shown][] {
  const both = [...left.values()].filter(({ car }) => right.has(car.id)).map((a): [Shown, Shown] => [a, right.get(a.car.id)!]);
  if (!both.length && left.size === 1 && right.size === 1) return [[[...left.values()][0], [...right.values()][0]]];
  for (const [one, other, name] of [[left, right, names[0]], [right, left, names[1]]] as const) {
    const alone = [...one.keys()].filter((id) => !other.has(id));
    if (alone.length) sentences.push(`only in ${name} now: ${alone.join(", ")}`);
  }
  return both;
}

function differs(a: BakedCar, b: BakedCar): string {
  const [count, other] = [a, b].map(({ vertex }) => vertex.length / 3);
  if (count !== other) return `surfaces of ${count} and ${other} vertices: not the same car, so nothing to compare one to one`;
  return a === b || a.vertex.every((x, i) => x === b.vertex[i]) ? "" : `both surfaces have ${count} vertices, but not at the same places when undamaged`;
}

function makePair(shown: [Shown, Shown], meshes: [CarMesh, CarMesh]): Pair {
  return { shown, meshes, versions: [-1, -1], apart: new Float32Array(meshes[0].moved.length), largest: 0, rms: 0 };
}

/** False: neither surface has changed. */
function measure(pair: Pair): boolean {
  const { meshes, versions, apart } = pair;
  if (meshes.every(({ updates }, i) => updates === versions[i])) return false;
  const [a, b] = meshes.map(({ skinned }) => skinned);
  let most = 0, sum = 0;
  for (let v = 0; v < apart.length; ++v) {
    const x = a[3 * v] - b[3 * v], y = a[3 * v + 1] - b[3 * v + 1], z = a[3 * v + 2] - b[3 * v + 2];
    const squared = x * x + y * y + z * z;
    sum += squared;
    most = Math.max(most, squared);
    apart[v] = Math.sqrt(squared);
  }
  pair.versions = [meshes[0].updates, meshes[1].updates];
  pair.largest = Math.sqrt(most);
  pair.rms = Math.sqrt(sum / apart.length);
  return true;
}
