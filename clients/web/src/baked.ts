// Reads of the baked car (schema/car.fbs) what a viewer needs: its surface at rest, and the nodes that each vertex moves with.
import { ByteBuffer } from "flatbuffers";
import { Car } from "./crumple/schema/car.js";
import { digits, hashOf } from "./decode.js";
import { motionOf, moved, nodesAround, partKinds, type Motion, type NodesAround, type Part } from "./parts.js";

/** What a material of the source looks like, as in glTF: numbers from 0 to 1, the colour in linear light. */
export interface Look {
  name: string;
  /** red, green, blue, opacity */
  color: [number, number, number, number];
  metallic: number;
  roughness: number;
}

export interface BakedCar {
  name: string;
  /** Must be shown where the car is shown. */
  attribution: string;
  /** kg */
  mass: number;
  /** m, car's frame */
  centerOfMass: [number, number, number];
  /** Names of the regions. The first is "body", which has all that nobody painted. */
  regions: string[];
  /** Positions at rest, 3 numbers for each vertex, m, car's frame. */
  vertex: Float32Array;
  /** 3 vertices for each triangle. */
  triangle: Uint32Array;
  /** Rows of the 3 x 4 matrix from the coordinates of the file from which the car was baked to the car's frame; null: not known. */
  sourceToCar: Float64Array | null;
  /** How many nodes the skin uses. Keyframes and deltas have these nodes, in this order. */
  nodes: number;
  /** Four nodes for each vertex, numbered as in keyframes and deltas, and their weights. */
  node: Uint32Array;
  weight: Float32Array;
  /** Part 0 is the body. Empty: there is only a body. */
  parts: Part[];
  /** The part of each vertex; empty if there are no parts. */
  vertexPart: Uint8Array;
  looks: Look[];
  /** The look of each triangle; noLook: it has no material, or one with a texture. Empty if there are no looks. */
  triangleLook: Uint8Array;
  /** 3 numbers for each node of the skin, at rest, m; empty if there are no parts. */
  nodeRest: Float32Array;
  /** Of each part. */
  around: NodesAround[];
}

export const noLook = 255;

/** asset: the hash of the car, 16 digits. Throws an Error with a sentence if the bytes are not this car. */
export function readCar(bytes: Uint8Array, asset: string): BakedCar {
  const found = digits(hashOf(bytes));
  if (found !== asset) throw new Error(`the bytes of asset ${asset} have the hash ${found}: ask again`);
  const buffer = new ByteBuffer(bytes);
  if (!Car.bufferHasIdentifier(buffer)) throw new Error(`asset ${asset} is not a baked car`);
  const car = Car.getRootAsCar(buffer);
  if (car.version() !== 1) throw new Error(`asset ${asset} is a baked car of version ${car.version()}; this program reads version 1`);
  const vertices = car.vertexLength(), nodes = car.nodeLength();
  const words = (at: number, count: number) => bytes.slice(at, at + 4 * count).buffer;
  const vertex = new Float32Array(words(car.vertex(0)!.bb_pos, 3 * vertices));
  const triangle = car.triangleArray()!.slice();
  const skin = words(car.skin(0)!.bb_pos, 8 * vertices);
  if (car.skinLength() !== vertices || triangle.some((i) => i >= vertices))
    throw new Error(`asset ${asset}: skin or triangles do not fit its vertices`);
  const center = car.centerOfMass(), skinned = readSkin(new Uint32Array(skin), new Float32Array(skin), vertices, nodes);
  const parts = readParts(car, triangle, asset), nodeRest = new Float32Array(parts.length ? 3 * skinned.used.length : 0);
  if (parts.length) {
    const rest = new Float32Array(words(car.node(0)!.bb_pos, 3 * nodes));
    skinned.used.forEach((i, k) => nodeRest.set(rest.subarray(3 * i, 3 * i + 3), 3 * k));
    if (!nodeRest.every(Number.isFinite)) throw new Error(`asset ${asset}: a node is not a finite number`);
  }
  return {
    name: car.name() ?? "", attribution: car.attribution() ?? "", mass: car.mass(),
    centerOfMass: center ? [center.x(), center.y(), center.z()] : [0, 0, 0],
    regions: Array.from({ length: car.regionLength() }, (_, i) => car.region(i)),
    sourceToCar: car.sourceToCarLength() === 12 ? Float64Array.from({ length: 12 }, (_, i) => car.sourceToCar(i)!) : null,
    vertex, triangle, nodes: skinned.used.length, node: skinned.node, weight: skinned.weight, parts, nodeRest,
    ...readLooks(car, triangle, asset),
    vertexPart: parts.length ? car.vertexPartArray()!.slice() : new Uint8Array(), around: parts.map((part) => nodesAround(part, nodeRest)),
  };
}

// The server and the gateway have checked names and sizes already; this checks what would break the page.
function readParts(car: Car, triangle: Uint32Array, asset: string): Part[] {
  const count = car.partLength(), of = car.vertexPartArray();
  if (!count) return [];
  const parts = Array.from({ length: count }, (_, i) => {
    const part = car.part(i)!, p = part.position()!, q = part.orientation()!;
    const position = [p.x(), p.y(), p.z()], orientation = [q.x(), q.y(), q.z(), q.w()], sizes = [part.radius(), part.width()];
    if (part.kind() >= partKinds.length || ![...position, ...orientation, ...sizes].every(Number.isFinite))
      throw new Error(`asset ${asset}: part ${i} has no kind or no frame`);
    return { name: part.name() ?? "", kind: partKinds[part.kind()], position, orientation, radius: sizes[0], width: sizes[1] };
  });
  const fits = of?.length === car.vertexLength() && of.every((part) => part < count) && triangle.every((v, i) => of[v] === of[triangle[i - (i % 3)]]);
  if (!fits) throw new Error(`asset ${asset}: its parts do not fit its vertices`);
  return parts;
}

function readLooks(car: Car, triangle: Uint32Array, asset: string): Pick<BakedCar, "looks" | "triangleLook"> {
  const count = car.lookLength(), of = car.triangleLookArray();
  if (!count) return { looks: [], triangleLook: new Uint8Array() };
  const looks = Array.from({ length: count }, (_, i): Look => {
    const look = car.look(i)!, c = look.color()!;
    const color: Look["color"] = [c.red(), c.green(), c.blue(), c.opacity()], metallic = look.metallic(), roughness = look.roughness();
    if (![...color, metallic, roughness].every((x) => x >= 0 && x <= 1)) throw new Error(`asset ${asset}: a number of look ${i} is not from 0 to 1`);
    return { name: look.name() ?? "", color, metallic, roughness };
  });
  if (of?.length !== triangle.length / 3 || of.some((look) => look >= count && look !== noLook))
    throw new Error(`asset ${asset}: its looks do not fit its triangles`);
  return { looks, triangleLook: of.slice() };
}

// Numbers the nodes that have a weight above 0 in ascending order, as keyframes and deltas do. `skin` has four nodes and four weights
// for each vertex.
function readSkin(skinNode: Uint32Array, skinWeight: Float32Array, vertices: number, nodes: number) {
  const number = new Int32Array(nodes).fill(-1);
  const node = new Uint32Array(4 * vertices), weight = new Float32Array(4 * vertices);
  const corner = (v: number, k: number) => ({ at: skinNode[8 * v + k], share: skinWeight[8 * v + 4 + k] });
  for (let v = 0; v < vertices; ++v)
    for (let k = 0; k < 4; ++k) {
      const { at, share } = corner(v, k);
      if (at >= nodes) throw new Error("the skin of the asset names nodes that it does not have");
      if (share > 0) number[at] = 0;
    }
  const used: number[] = [];
  for (let i = 0; i < nodes; ++i) if (number[i] === 0) number[i] = used.push(i) - 1;
  for (let v = 0; v < vertices; ++v)
    for (let k = 0; k < 4; ++k) {
      const { at, share } = corner(v, k);
      if (!(share > 0)) continue;
      node[4 * v + k] = number[at];
      weight[4 * v + k] = share;
    }
  return { used, node, weight };
}

/** Writes the positions of the vertices into `out`: 3 numbers each, m, car's frame. Returns false if the surface is not of this car. */
export function skin(car: BakedCar, surface: { quanta: Int16Array; quantum: number }, out: Float32Array): boolean {
  const { quanta, quantum } = surface;
  if (quanta.length !== 3 * car.nodes) return false;
  const { vertex, node, weight } = car;
  for (let v = 0, k = 0; v < vertex.length; v += 3, k += 4) {
    let x = 0, y = 0, z = 0;
    for (let i = k; i < k + 4; ++i) {
      const w = weight[i], n = 3 * node[i];
      x += w * quanta[n];
      y += w * quanta[n + 1];
      z += w * quanta[n + 2];
    }
    out[v] = vertex[v] + quantum * x;
    out[v + 1] = vertex[v + 1] + quantum * y;
    out[v + 2] = vertex[v + 2] + quantum * z;
  }
  const motion = wheelMotions(car, surface);
  car.vertexPart.forEach((part, v) => {
    if (motion[part]) out.set(moved(motion[part], vertex.subarray(3 * v, 3 * v + 3)), 3 * v);
  });
  return true;
}

/** The motions of wheels, by part; of other parts null. */
export function wheelMotions(car: BakedCar, surface: { quanta: Int16Array; quantum: number }): (Motion | null)[] {
  return car.parts.map(({ kind }, i) => (kind === "wheel" ? motionOf(car.around[i], car.nodeRest, surface) : null));
}

/** A triangle that is thinner than this share of its longest edge counts as unstrained: rounding of its vertices would be its strain. */
const sliver = 1e-5;

/**
 * Writes the strain of a surface against rest into `out`, a number for each vertex. now: 3 numbers for each vertex, as `skin` writes
 * them. The strain of a triangle is its largest |principal stretch - 1|; that of a vertex is the mean of its triangles, weighted by
 * their area at rest. Principal stretches are sqrt(1 + 2 e), where e are the principal values of the Green strain (G^-1 H - 1) / 2, and
 * G and H have the products of the triangle's edges at rest and now. The strain has an elastic part, which is about 0.01 in this body
 * (Material::yield_strain) and 0.002 in sheet steel. A car that touches nothing shows its plastic strain.
 */
export function strain(car: BakedCar, now: Float32Array, out: Float32Array): void {
  const { vertex: rest, triangle } = car, area = new Float32Array(out.length);
  const g = [0, 0, 0], h = [0, 0, 0];
  out.fill(0);
  for (let t = 0; t < triangle.length; t += 3) {
    const a = triangle[t], b = triangle[t + 1], c = triangle[t + 2];
    products(rest, a, b, c, g);
    const squared = g[0] * g[2] - g[1] * g[1]; // the square of twice the area
    const longest = Math.max(g[0], g[2], g[0] - 2 * g[1] + g[2]);
    if (!(squared > (sliver * longest) ** 2)) continue;
    products(now, a, b, c, h);
    const mean = (g[2] * h[0] - 2 * g[1] * h[1] + g[0] * h[2]) / squared / 2, product = (h[0] * h[2] - h[1] * h[1]) / squared;
    const apart = Math.sqrt(Math.max(0, mean * mean - product)), weight = Math.sqrt(squared);
    const largest = Math.max(Math.sqrt(mean + apart) - 1, 1 - Math.sqrt(Math.max(0, mean - apart)));
    for (let k = t; k < t + 3; ++k) {
      out[triangle[k]] += weight * largest;
      area[triangle[k]] += weight;
    }
  }
  for (let v = 0; v < out.length; ++v) if (area[v]) out[v] /= area[v];
}

// Writes products of the edges from a: that to b with itself, that to b with that to c, that to c with itself.
function products(at: Float32Array, a: number, b: number, c: number, out: number[]): void {
  a *= 3;
  b *= 3;
  c *= 3;
  const ux = at[b] - at[a], uy = at[b + 1] - at[a + 1], uz = at[b + 2] - at[a + 2];
  const vx = at[c] - at[a], vy = at[c + 1] - at[a + 1], vz = at[c + 2] - at[a + 2];
  out[0] = ux * ux + uy * uy + uz * uz;
  out[1] = ux * vx + uy * vy + uz * vz;
  out[2] = vx * vx + vy * vy + vz * vz;
}
