// Where the parts of a car are now, as server/viewer/parts.h computes it: each has a frame, which moves rigidly, as the nodes of the
// skin around it move on average. Positions are in the car's frame, m.

/** In the order of the format. */
export const partKinds = ["body", "panel", "glass", "light", "wheel", "interior", "point"] as const;
export type PartKind = (typeof partKinds)[number];

export interface Part {
  name: string;
  kind: PartKind;
  /** Its frame at rest. A wheel has its hub there and turns about y of the frame; other parts have the middle of their vertices there. */
  position: number[];
  /** Unit quaternion: x, y, z, w. */
  orientation: number[];
  /** Of a wheel, m. */
  radius: number;
  width: number;
}

/** The nodes around a part, numbered as in keyframes, and their weights. */
export interface NodesAround {
  node: Uint32Array;
  weight: Float64Array;
}

/** A rigid motion away from rest: it turns about `center`, then moves by `shift`. */
export interface Motion {
  turn: number[];
  center: number[];
  shift: number[];
}

const reachOfWheel = 1.5; // radii
const reachOfOthers = 0.4; // m
const leastNodes = 12;
const beyondLast = 1.1;
const towardsNone = 1e-8;

/** rest: 3 numbers for each node of the skin. */
export function nodesAround(part: Part, rest: Float32Array): NodesAround {
  const [x, y, z] = part.position;
  const distance = Float64Array.from({ length: rest.length / 3 }, (_, i) => Math.hypot(rest[3 * i] - x, rest[3 * i + 1] - y, rest[3 * i + 2] - z));
  const last = distance.slice().sort()[Math.min(leastNodes, distance.length) - 1];
  const reach = Math.max(part.kind === "wheel" ? reachOfWheel * part.radius : reachOfOthers, beyondLast * last, 1e-6);
  const node = Uint32Array.from(distance.keys()).filter((i) => distance[i] < reach);
  const weight = Float64Array.from(node, (i) => (1 - (distance[i] / reach) ** 2) ** 2), sum = weight.reduce((a, b) => a + b, 0);
  return { node, weight: weight.map((each) => each / sum) };
}

/** The motion with the least sum of weighted squared distances to the nodes now (Horn 1987). */
export function motionOf(around: NodesAround, rest: Float32Array, { quanta, quantum }: { quanta: Int16Array; quantum: number }): Motion {
  const { node, weight } = around, center = [0, 0, 0], shift = [0, 0, 0];
  let still = true;
  node.forEach((i, k) => {
    for (let axis = 0; axis < 3; ++axis) {
      const by = quantum * quanta[3 * i + axis];
      center[axis] += weight[k] * rest[3 * i + axis];
      shift[axis] += weight[k] * by;
      still &&= by === 0;
    }
  });
  if (still) return { turn: [0, 0, 0, 1], center: [0, 0, 0], shift: [0, 0, 0] };
  const s = new Float64Array(9);
  let spread = 0;
  node.forEach((i, k) => {
    const p = [0, 1, 2].map((axis) => rest[3 * i + axis] - center[axis]);
    const q = [0, 1, 2].map((axis) => p[axis] + quantum * quanta[3 * i + axis] - shift[axis]);
    for (let row = 0; row < 3; ++row) {
      for (let column = 0; column < 3; ++column) s[3 * row + column] += weight[k] * p[row] * q[column];
      spread += weight[k] * p[row] * p[row];
    }
  });
  for (const diagonal of [0, 4, 8]) s[diagonal] += towardsNone * spread + 1e-12;
  const [xx, xy, xz, yx, yy, yz, zx, zy, zz] = s;
  const [w, x, y, z] = lastEigenvector([
    [xx + yy + zz, yz - zy, zx - xz, xy - yx],
    [yz - zy, xx - yy - zz, xy + yx, zx + xz],
    [zx - xz, xy + yx, yy - xx - zz, yz + zy],
    [xy - yx, zx + xz, yz + zy, zz - xx - yy],
  ]);
  const sign = w < 0 ? -1 : 1;
  return { turn: [sign * x, sign * y, sign * z, sign * w], center, shift };
}

/** Turns a vector by a unit quaternion. */
export function turned([x, y, z, w]: number[], [a, b, c]: number[]): number[] {
  const u = 2 * (y * c - z * b), v = 2 * (z * a - x * c), t = 2 * (x * b - y * a);
  return [a + w * u + y * t - z * v, b + w * v + z * u - x * t, c + w * t + x * v - y * u];
}

/** Where a place at rest is after the motion. */
export function moved({ turn, center, shift }: Motion, place: ArrayLike<number>): number[] {
  const from = center.map((at, axis) => place[axis] - at);
  return turned(turn, from).map((to, axis) => place[axis] + (to - from[axis] + shift[axis]));
}

// Jacobi's method for a symmetric matrix, which it destroys.
function lastEigenvector(m: number[][]): number[] {
  const size = m.length, v = m.map((_, i) => m.map((_, j) => Number(i === j)));
  for (let sweep = 0; sweep < 20; ++sweep)
    for (let p = 0; p < size; ++p)
      for (let q = p + 1; q < size; ++q) {
        if (m[p][q] === 0) continue;
        const half = (m[q][q] - m[p][p]) / (2 * m[p][q]);
        const t = (half < 0 ? -1 : 1) / (Math.abs(half) + Math.sqrt(half * half + 1)), c = 1 / Math.sqrt(t * t + 1), s = t * c;
        for (let k = 0; k < size; ++k) [m[k][p], m[k][q]] = [c * m[k][p] - s * m[k][q], s * m[k][p] + c * m[k][q]];
        for (let k = 0; k < size; ++k) {
          [m[p][k], m[q][k]] = [c * m[p][k] - s * m[q][k], s * m[p][k] + c * m[q][k]];
          [v[k][p], v[k][q]] = [c * v[k][p] - s * v[k][q], s * v[k][p] + c * v[k][q]];
        }
      }
  const last = m.reduce((best, row, i) => (row[i] > m[best][best] ? i : best), 0);
  return v.map((row) => row[last]);
}
