// Binds the vertices of any mesh of a car, such as a game's own with its seams, hard edges and levels of detail, to the surface of the
// baked car, and moves them with it: as server/viewer/mapping.h does. Positions are in the car's frame, m, 3 numbers for each vertex.
import type { BakedCar } from "./baked.js";

/** A mapped vertex that is nearer to a vertex of the surface than this lies on it, m. */
const samePlace = 1e-4;
/** A triangle turns a normal if the angle between both is less than 60 degrees. So hard edges stay hard. This is the cosine. */
const sameSide = 0.5;
/** So many triangles around a vertex turn normals, those with the lowest indices: a hostile car may have all around one vertex. */
const aroundLimit = 256;
const leaf = 4; // most triangles of a leaf of the tree

export interface Mapping {
  /** For each mapped vertex the triangle that it moves with: three vertices of the baked car, and their weights, which sum to 1. */
  corner: Uint32Array;
  weight: Float32Array;
  /** The triangles that turn its normal: turning[first[i]] to turning[first[i + 1] - 1], as 2 * triangle + (1 if it faces the other way). */
  first: Uint32Array;
  turning: Uint32Array;
  /** Their mean normal at rest, of length 1. */
  facing: Float32Array;
  /** m, from each mapped vertex to the surface. */
  distance: Float32Array;
  /** How many mapped vertices lie on a vertex of the baked car. */
  onVertices: number;
}

/** normal: of the mapped vertices, of length 1; null: all triangles around a vertex turn its normal. */
export function mapVertices(car: BakedCar, position: Float32Array, normal: Float32Array | null = null): Mapping {
  const count = position.length / 3, triangles = car.triangle.length / 3;
  const tree = new Tree(car.vertex, car.triangle), cross = crosses(car, car.vertex);
  const { first: aroundFirst, list: around } = trianglesAround(car);
  const out: Mapping = {
    corner: new Uint32Array(3 * count), weight: new Float32Array(3 * count), first: new Uint32Array(count + 1), turning: new Uint32Array(0),
    facing: new Float32Array(3 * count), distance: new Float32Array(count), onVertices: 0,
  };
  const turning: number[] = [], seen = new Int32Array(triangles).fill(-1), found = { triangle: 0, weight: [1, 0, 0], distance: 0, onVertex: false };
  for (let i = 0; i < count; ++i) {
    tree.nearest(position[3 * i], position[3 * i + 1], position[3 * i + 2], found);
    out.distance[i] = found.distance;
    out.onVertices += Number(found.onVertex);
    const near: number[] = [];
    for (let k = 0; k < 3; ++k) {
      const vertex = car.triangle[3 * found.triangle + k];
      out.corner[3 * i + k] = vertex;
      out.weight[3 * i + k] = found.weight[k];
      if (found.weight[k] === 0) continue;
      const begin = aroundFirst[vertex], end = Math.min(aroundFirst[vertex + 1], begin + aroundLimit);
      for (let j = begin; j < end; ++j) {
        if (seen[around[j]] === i) continue;
        seen[around[j]] = i;
        near.push(around[j]);
      }
    }
    near.sort((a, b) => a - b);
    for (const t of near) {
      const length = Math.hypot(cross[3 * t], cross[3 * t + 1], cross[3 * t + 2]);
      const side = !normal ? 1 : length > 0 ? dot(cross, 3 * t, normal, 3 * i) / length : normal[3 * i + 2];
      if (Math.abs(side) > sameSide) turning.push(2 * t + Number(side < 0));
    }
    if (turning.length === out.first[i]) for (const t of near) turning.push(2 * t); // its normal has nothing to do with the surface's
    out.first[i + 1] = turning.length;
  }
  out.turning = Uint32Array.from(turning);
  for (let i = 0; i < count; ++i) meanNormal(out, i, cross, out.facing, 3 * i);
  return out;
}

/** Writes the displacement of mapped vertex i into `to` at `at`. now: the positions of the baked car's vertices. */
export function displacementOf(mapping: Mapping, i: number, car: BakedCar, now: Float32Array, to: Float32Array | number[], at: number): void {
  to[at] = to[at + 1] = to[at + 2] = 0;
  for (let k = 3 * i; k < 3 * i + 3; ++k) {
    const v = 3 * mapping.corner[k], w = mapping.weight[k];
    for (let axis = 0; axis < 3; ++axis) to[at + axis] += w * (now[v + axis] - car.vertex[v + axis]);
  }
}

/** Turns a direction of mapped vertex i, such as its normal at rest, by as much as its triangles have turned. cross: of `crosses`, now. */
export function turn(mapping: Mapping, i: number, cross: Float32Array, from: Float32Array, to: Float32Array | number[], at: number): void {
  meanNormal(mapping, i, cross, now, 0);
  const { facing } = mapping, f = 3 * i, cosine = dot(facing, f, now, 0);
  const x = facing[f + 1] * now[2] - facing[f + 2] * now[1], y = facing[f + 2] * now[0] - facing[f] * now[2],
    z = facing[f] * now[1] - facing[f + 1] * now[0];
  const vx = from[f], vy = from[f + 1], vz = from[f + 2], half = cosine < -0.9999;
  const along = half ? 0 : (x * vx + y * vy + z * vz) / (1 + cosine);
  // Rodrigues' formula; a half turn is one about any axis.
  to[at] = half ? -vx : cosine * vx + y * vz - z * vy + along * x;
  to[at + 1] = half ? -vy : cosine * vy + z * vx - x * vz + along * y;
  to[at + 2] = half ? -vz : cosine * vz + x * vy - y * vx + along * z;
}
const now = new Float32Array(3);

/** The cross product of two edges of each triangle: 3 numbers each. at: the positions of the baked car's vertices. */
export function crosses(car: BakedCar, at: Float32Array, out: Float32Array = new Float32Array(car.triangle.length)): Float32Array {
  for (let t = 0; t < out.length; t += 3) {
    const a = 3 * car.triangle[t], b = 3 * car.triangle[t + 1], c = 3 * car.triangle[t + 2];
    const ux = at[b] - at[a], uy = at[b + 1] - at[a + 1], uz = at[b + 2] - at[a + 2];
    const vx = at[c] - at[a], vy = at[c + 1] - at[a + 1], vz = at[c + 2] - at[a + 2];
    out[t] = uy * vz - uz * vy;
    out[t + 1] = uz * vx - ux * vz;
    out[t + 2] = ux * vy - uy * vx;
  }
  return out;
}

function dot(a: Float32Array, i: number, b: Float32Array, j: number): number {
  return a[i] * b[j] + a[i + 1] * b[j + 1] + a[i + 2] * b[j + 2];
}

function meanNormal(mapping: Mapping, i: number, cross: Float32Array, to: Float32Array, at: number): void {
  let x = 0, y = 0, z = 0;
  for (let k = mapping.first[i]; k < mapping.first[i + 1]; ++k) {
    const t = mapping.turning[k], sign = t & 1 ? -1 : 1, c = 3 * (t >> 1);
    x += sign * cross[c];
    y += sign * cross[c + 1];
    z += sign * cross[c + 2];
  }
  const length = Math.sqrt(x * x + y * y + z * z);
  to[at] = length > 0 ? x / length : 0;
  to[at + 1] = length > 0 ? y / length : 0;
  to[at + 2] = length > 0 ? z / length : 1;
}

function trianglesAround(car: BakedCar): { first: Uint32Array; list: Uint32Array } {
  const first = new Uint32Array(car.vertex.length / 3 + 1), list = new Uint32Array(car.triangle.length);
  for (const vertex of car.triangle) ++first[vertex + 1];
  for (let v = 1; v < first.length; ++v) first[v] += first[v - 1];
  const next = first.slice();
  car.triangle.forEach((vertex, i) => (list[next[vertex]++] = Math.floor(i / 3)));
  return { first, list };
}

interface Found {
  triangle: number;
  weight: number[];
  distance: number;
  onVertex: boolean;
}

/** A binary tree of boxes around the triangles, halved at the median of the longest side. */
class Tree {
  #order: Uint32Array; // the triangles, leaf by leaf
  #box: number[] = []; // low x, y, z, high x, y, z of each node
  #second: number[] = []; // the node of the second half; the first half's is the next one

  constructor(readonly vertex: Float32Array, readonly triangle: Uint32Array) {
    this.#order = Uint32Array.from({ length: triangle.length / 3 }, (_, t) => t);
    this.#build(0, this.#order.length);
  }

  #build(begin: number, end: number): void {
    const node = this.#second.push(0) - 1, box = [Infinity, Infinity, Infinity, -Infinity, -Infinity, -Infinity];
    for (let k = begin; k < end; ++k)
      for (let i = 0; i < 3; ++i)
        for (let axis = 0; axis < 3; ++axis) {
          const x = this.vertex[3 * this.triangle[3 * this.#order[k] + i] + axis];
          box[axis] = Math.min(box[axis], x);
          box[3 + axis] = Math.max(box[3 + axis], x);
        }
    this.#box.push(...box);
    if (end - begin <= leaf) return;
    const size = [box[3] - box[0], box[4] - box[1], box[5] - box[2]], axis = size.indexOf(Math.max(...size));
    const middle = begin + Math.floor((end - begin) / 2), { vertex, triangle } = this;
    const centre = (t: number) => vertex[3 * triangle[3 * t] + axis] + vertex[3 * triangle[3 * t + 1] + axis] + vertex[3 * triangle[3 * t + 2] + axis];
    this.#order.subarray(begin, end).sort((a, b) => centre(a) - centre(b) || a - b);
    this.#build(begin, middle);
    this.#second[node] = this.#second.length;
    this.#build(middle, end);
  }

  nearest(x: number, y: number, z: number, best: Found): void {
    best.distance = Infinity;
    best.onVertex = false;
    this.#search(0, 0, this.#order.length, x, y, z, best);
  }

  #away(node: number, x: number, y: number, z: number): number {
    const b = this.#box, i = 6 * node;
    return Math.hypot(Math.max(b[i] - x, 0, x - b[i + 3]), Math.max(b[i + 1] - y, 0, y - b[i + 4]), Math.max(b[i + 2] - z, 0, z - b[i + 5]));
  }

  #search(node: number, begin: number, end: number, x: number, y: number, z: number, best: Found): void {
    const away = this.#away(node, x, y, z);
    if (away >= best.distance && (best.onVertex || away > samePlace)) return;
    if (end - begin <= leaf) {
      for (let k = begin; k < end; ++k) this.#look(this.#order[k], [x, y, z], best);
      return;
    }
    const middle = begin + Math.floor((end - begin) / 2), second = this.#second[node];
    const halves: [number, number, number][] = [[node + 1, begin, middle], [second, middle, end]];
    if (this.#away(second, x, y, z) < this.#away(node + 1, x, y, z)) halves.reverse();
    for (const [half, from, to] of halves) this.#search(half, from, to, x, y, z, best);
  }

  // A vertex in the same place counts before a triangle that passes through it.
  #look(t: number, p: number[], best: Found): void {
    const corners = [0, 1, 2].map((k) => Array.from(this.vertex.subarray(3 * this.triangle[3 * t + k], 3 * this.triangle[3 * t + k] + 3)));
    let weight = nearestOn(p, corners[0], corners[1], corners[2]), onVertex = false;
    let distance = Math.hypot(...[0, 1, 2].map((axis) => p[axis] - weight[0] * corners[0][axis] - weight[1] * corners[1][axis] - weight[2] * corners[2][axis]));
    corners.forEach((corner, k) => {
      const to = Math.hypot(p[0] - corner[0], p[1] - corner[1], p[2] - corner[2]);
      if (to > samePlace || (onVertex && to >= distance)) return;
      weight = [0, 1, 2].map((other) => Number(other === k));
      distance = to;
      onVertex = true;
    });
    if (onVertex !== best.onVertex ? !onVertex : !(distance < best.distance)) return;
    Object.assign(best, { triangle: t, weight, distance, onVertex });
  }
}

// The weights of a triangle's corners at its point nearest to p. Ericson, Real-Time Collision Detection, 5.1.5.
function nearestOn(p: number[], a: number[], b: number[], c: number[]): number[] {
  const minus = (u: number[], v: number[]) => [u[0] - v[0], u[1] - v[1], u[2] - v[2]];
  const times = (u: number[], v: number[]) => u[0] * v[0] + u[1] * v[1] + u[2] * v[2];
  const ab = minus(b, a), ac = minus(c, a), ap = minus(p, a), bp = minus(p, b), cp = minus(p, c);
  const d1 = times(ab, ap), d2 = times(ac, ap), d3 = times(ab, bp), d4 = times(ac, bp), d5 = times(ab, cp), d6 = times(ac, cp);
  if (d1 <= 0 && d2 <= 0) return [1, 0, 0];
  if (d3 >= 0 && d4 <= d3) return [0, 1, 0];
  if (d6 >= 0 && d5 <= d6) return [0, 0, 1];
  const onC = d1 * d4 - d3 * d2, onB = d5 * d2 - d1 * d6, onA = d3 * d6 - d5 * d4;
  const share = (from: number, to: number) => from / (from + to);
  if (onC <= 0 && d1 >= 0 && d3 <= 0) return [1 - share(d1, -d3), share(d1, -d3), 0];
  if (onB <= 0 && d2 >= 0 && d6 <= 0) return [1 - share(d2, -d6), 0, share(d2, -d6)];
  if (onA <= 0 && d4 >= d3 && d5 >= d6) return [0, 1 - share(d4 - d3, d5 - d6), share(d4 - d3, d5 - d6)];
  const sum = onA + onB + onC;
  return sum > 0 ? [1 - onB / sum - onC / sum, onB / sum, onC / sum] : [1, 0, 0];
}
