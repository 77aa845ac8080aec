// Makes an object of three.js from a baked car, and brings it up to a surface as often as that changes. The axes are the car's:
// x forward, y left, z up, metres.
import * as THREE from "three";
import { ConvexGeometry } from "three/addons/geometries/ConvexGeometry.js";
import { noLook, skin, strain, type BakedCar, type Look } from "./baked.js";
import { crosses, displacementOf, mapVertices, turn, type Mapping } from "./mapping.js";
import { Shape, type Obstacle } from "./decode.js";

/** Edges that are sharper than this at rest stay sharp: doors, windows, wheel arches. */
const crease = Math.cos((32 * Math.PI) / 180);

// What parts look like that have no material; the order is that of the materials after the paint.
const looks = {
  glass: new THREE.MeshStandardMaterial({ color: "#1c2a33", roughness: 0.05, metalness: 0.3, transparent: true, opacity: 0.45, side: THREE.DoubleSide, depthWrite: false }),
  light: new THREE.MeshStandardMaterial({ color: "#f4ecd2", roughness: 0.15, metalness: 0.1, side: THREE.DoubleSide }),
  wheel: new THREE.MeshStandardMaterial({ color: "#1b1b1e", roughness: 0.85, side: THREE.DoubleSide }),
  interior: new THREE.MeshStandardMaterial({ color: "#3b3634", roughness: 0.9, side: THREE.DoubleSide }),
};
const lookNames = Object.keys(looks);

/**
 * Materials for a CarMesh: those of the car, and for what has none, this one on body and panels, and others on glass, lights, wheels and
 * interior.
 */
export function partMaterials(paint: THREE.Material, car: BakedCar): THREE.Material[] {
  if (!own.has(car)) own.set(car, car.looks.map(materialOf));
  return [paint, ...Object.values(looks), ...own.get(car)!];
}

const own = new WeakMap<BakedCar, THREE.Material[]>(); // the same ones for all meshes of a car

function materialOf({ color: [red, green, blue, opacity], metallic, roughness }: Look): THREE.Material {
  const clear = opacity < 0.99;
  return new THREE.MeshStandardMaterial({
    color: new THREE.Color(red, green, blue), metalness: metallic, roughness, side: THREE.DoubleSide, transparent: clear, opacity, depthWrite: !clear,
  });
}

/** material: one for the whole car, or what partMaterials gives for it. */
export class CarMesh extends THREE.Mesh<THREE.BufferGeometry, THREE.Material | THREE.Material[]> {
  /** Positions of the vertices as the skin has them, and how far each has moved, m. */
  readonly skinned: Float32Array;
  readonly moved: Float32Array;
  /** How far the vertex has moved that moved most, m. */
  deepest = 0;
  /** How often `update` took a surface. */
  updates = 0;
  #triangle: Uint32Array; // 3 corners each; a vertex has one corner on each side of a crease
  #vertexOf: Uint32Array; // the vertex of each corner
  #strain: Float32Array | null = null;
  #radius: number; // of the bounding sphere at rest, m

  constructor(readonly baked: BakedCar, material: THREE.Material | THREE.Material[]) {
    const { triangle, vertexOf } = splitAtCreases(baked);
    const geometry = new THREE.BufferGeometry();
    groupByLook(baked, triangle, geometry);
    const attribute = () => new THREE.BufferAttribute(new Float32Array(3 * vertexOf.length), 3).setUsage(THREE.DynamicDrawUsage);
    geometry.setAttribute("position", attribute());
    geometry.setAttribute("normal", attribute());
    geometry.setAttribute("color", attribute());
    geometry.setIndex(new THREE.BufferAttribute(triangle, 1));
    geometry.boundingSphere = new THREE.Box3().setFromArray(baked.vertex).getBoundingSphere(new THREE.Sphere());
    super(geometry, material);
    this.#radius = geometry.boundingSphere.radius;
    this.castShadow = this.receiveShadow = true;
    this.#triangle = triangle;
    this.#vertexOf = vertexOf;
    this.skinned = new Float32Array(baked.vertex.length);
    this.moved = new Float32Array(baked.vertex.length / 3);
    this.update({ quanta: new Int16Array(3 * baked.nodes), quantum: 1 });
  }

  /** Takes a surface. Normals follow it; creases are those of the surface at rest. False: the surface is not of this car. */
  update(surface: { quanta: Int16Array; quantum: number }): boolean {
    if (!skin(this.baked, surface, this.skinned)) return false;
    ++this.updates;
    const rest = this.baked.vertex, now = this.skinned;
    this.deepest = 0;
    for (let v = 0; v < this.moved.length; ++v) {
      const x = now[3 * v] - rest[3 * v], y = now[3 * v + 1] - rest[3 * v + 1], z = now[3 * v + 2] - rest[3 * v + 2];
      this.moved[v] = Math.sqrt(x * x + y * y + z * z);
      this.deepest = Math.max(this.deepest, this.moved[v]);
    }
    const { position, normal } = this.geometry.attributes;
    const at = position.array as Float32Array;
    for (let c = 0; c < this.#vertexOf.length; ++c) {
      const v = 3 * this.#vertexOf[c];
      at[3 * c] = now[v];
      at[3 * c + 1] = now[v + 1];
      at[3 * c + 2] = now[v + 2];
    }
    sumNormals(at, this.#triangle, normal.array as Float32Array);
    position.needsUpdate = normal.needsUpdate = true;
    this.geometry.boundingSphere!.radius = this.#radius + this.deepest;
    return true;
  }

  /** The vertex of the baked car that a corner of the geometry is at. */
  vertexOf(corner: number): number {
    return this.#vertexOf[corner];
  }

  /** Computes the strain of each vertex (`strain` in baked.ts). */
  strain(): Float32Array {
    this.#strain ??= new Float32Array(this.moved.length);
    strain(this.baked, this.skinned, this.#strain);
    return this.#strain;
  }

  /** Colours vertices by their values, such as `moved`, for a material with vertexColors. The value `most` has the last colour. */
  paint(colours: readonly THREE.Color[], most: number, values = this.moved): void {
    const { color } = this.geometry.attributes;
    for (let c = 0; c < this.#vertexOf.length; ++c) {
      const share = Math.min(1, values[this.#vertexOf[c]] / most) * (colours.length - 1);
      const i = Math.min(Math.floor(share), colours.length - 2);
      mixed.lerpColors(colours[i], colours[i + 1], share - i);
      color.setXYZ(c, mixed.r, mixed.g, mixed.b);
    }
    color.needsUpdate = true;
  }
}

const mixed = new THREE.Color();

/**
 * A model of yours, such as a loaded glTF file, that shows the dents of a baked car: with its own vertices, materials and textures. It
 * must be in the coordinates of the file from which the car was baked; as a child of the car's frame it then stands where the car is.
 */
export class OwnModel extends THREE.Group {
  /** How many of its vertices lie on a vertex of the baked car; how many there are; and the mean distance to the baked car, m. */
  onVertices = 0;
  vertices = 0;
  meanDistance = 0;
  #parts: { mesh: THREE.Mesh; mapping: Mapping; rest: Float32Array; normal: Float32Array | null; toCar: THREE.Matrix4 }[] = [];
  #cross: Float32Array<ArrayBuffer>;

  /** Throws an Error with a sentence if the baked car does not know its source, or if it is another car. */
  constructor(readonly baked: BakedCar, model: THREE.Object3D) {
    super();
    if (!baked.sourceToCar) throw new Error(`${baked.name} does not say where its source's coordinates are: bake it again`);
    const m = baked.sourceToCar;
    this.matrix.set(m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9], m[10], m[11], 0, 0, 0, 1);
    this.matrixAutoUpdate = false;
    this.add(model);
    model.updateMatrixWorld(true);
    this.#cross = new Float32Array(baked.triangle.length);
    const outside = this.matrix.clone().multiply(model.parent!.matrixWorld.clone().invert());
    model.traverse((object) => {
      if (object instanceof THREE.Mesh && object.geometry.attributes.position) this.#map(object, outside);
    });
    this.meanDistance /= Math.max(1, this.vertices);
    if (!(this.meanDistance < 0.05))
      throw new Error(`the model is not ${baked.name}: its vertices are ${Math.round(1000 * this.meanDistance)} mm from it on average`);
  }

  #map(mesh: THREE.Mesh, outside: THREE.Matrix4): void {
    const toCar = outside.clone().multiply(mesh.matrixWorld), turned = new THREE.Matrix3().getNormalMatrix(toCar);
    const geometry = (mesh.geometry = mesh.geometry.clone()), { position, normal } = geometry.attributes, count = position.count;
    const rest = new Float32Array(3 * count), placed = new Float32Array(3 * count), normals = normal ? new Float32Array(3 * count) : null;
    const v = new THREE.Vector3();
    for (let i = 0; i < count; ++i) {
      v.fromBufferAttribute(position, i).toArray(rest, 3 * i);
      v.applyMatrix4(toCar).toArray(placed, 3 * i);
      if (normals) v.fromBufferAttribute(normal, i).applyMatrix3(turned).normalize().toArray(normals, 3 * i);
    }
    geometry.setAttribute("position", new THREE.BufferAttribute(rest.slice(), 3).setUsage(THREE.DynamicDrawUsage));
    if (normals) geometry.setAttribute("normal", new THREE.BufferAttribute(new Float32Array(3 * count), 3).setUsage(THREE.DynamicDrawUsage));
    mesh.frustumCulled = false; // its bounds move
    mesh.castShadow = mesh.receiveShadow = true;
    const mapping = mapVertices(this.baked, placed, normals);
    this.onVertices += mapping.onVertices;
    this.vertices += count;
    this.meanDistance += mapping.distance.reduce((sum, each) => sum + each, 0);
    this.#parts.push({ mesh, mapping, rest, normal: normals, toCar });
  }

  /** Releases its vertices. Its materials and textures are those of the model that it was made from. */
  dispose(): void {
    for (const { mesh } of this.#parts) mesh.geometry.dispose();
  }

  /** skinned: the positions of the baked car's vertices, as `skin` writes them. */
  update(skinned: Float32Array): void {
    crosses(this.baked, skinned, this.#cross);
    const v = new THREE.Vector3(), moved = [0, 0, 0];
    for (const { mesh, mapping, rest, normal, toCar } of this.#parts) {
      const fromCar = new THREE.Matrix3().setFromMatrix4(toCar).invert(), normalsFromCar = new THREE.Matrix3().setFromMatrix4(toCar).transpose();
      const at = mesh.geometry.attributes.position, to = mesh.geometry.attributes.normal;
      for (let i = 0; i < at.count; ++i) {
        displacementOf(mapping, i, this.baked, skinned, moved, 0);
        v.fromArray(moved).applyMatrix3(fromCar);
        at.setXYZ(i, rest[3 * i] + v.x, rest[3 * i + 1] + v.y, rest[3 * i + 2] + v.z);
        if (!normal) continue;
        turn(mapping, i, this.#cross, normal, moved, 0);
        v.fromArray(moved).applyMatrix3(normalsFromCar).normalize();
        to.setXYZ(i, v.x, v.y, v.z);
      }
      at.needsUpdate = true;
      if (normal) to.needsUpdate = true;
    }
  }
}

// Sorts triangles by their look, and makes a group of each look, in the order of partMaterials.
function groupByLook(car: BakedCar, triangle: Uint32Array, geometry: THREE.BufferGeometry): void {
  const lookOf = car.parts.map(({ kind }) => lookNames.indexOf(kind) + 1), all = triangle.slice();
  const look = Uint16Array.from({ length: triangle.length / 3 }, (_, t) => {
    const own = car.triangleLook[t] ?? noLook;
    return own === noLook ? lookOf[car.vertexPart[car.triangle[3 * t]]] ?? 0 : 1 + lookNames.length + own;
  });
  let at = 0;
  for (let each = 0; each <= lookNames.length + car.looks.length; ++each) {
    const first = at;
    look.forEach((own, t) => {
      if (own !== each) return;
      triangle.set(all.subarray(3 * t, 3 * t + 3), at);
      at += 3;
    });
    if (at > first) geometry.addGroup(first, at - first, each);
  }
}

// Makes the normal of each corner as the sum over its triangles by their area. The shader makes it a unit vector.
function sumNormals(at: Float32Array, triangle: Uint32Array, normal: Float32Array): void {
  normal.fill(0);
  for (let t = 0; t < triangle.length; t += 3) {
    const a = 3 * triangle[t], b = 3 * triangle[t + 1], c = 3 * triangle[t + 2];
    const ux = at[b] - at[a], uy = at[b + 1] - at[a + 1], uz = at[b + 2] - at[a + 2];
    const vx = at[c] - at[a], vy = at[c + 1] - at[a + 1], vz = at[c + 2] - at[a + 2];
    const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
    normal[a] += x;
    normal[a + 1] += y;
    normal[a + 2] += z;
    normal[b] += x;
    normal[b + 1] += y;
    normal[b + 2] += z;
    normal[c] += x;
    normal[c + 1] += y;
    normal[c + 2] += z;
  }
}

// Makes one corner of a vertex for each smooth fan of triangles around it. Triangles of a fan share edges at small angles.
function splitAtCreases(car: BakedCar): { triangle: Uint32Array<ArrayBuffer>; vertexOf: Uint32Array } {
  const count = car.triangle.length / 3;
  const faces = Array.from({ length: count }, (_, t) => faceNormal(car, t));
  const around: number[][] = Array.from({ length: car.vertex.length / 3 }, () => []);
  car.triangle.forEach((v, i) => around[v].push(i));
  const triangle = new Uint32Array(car.triangle.length), vertexOf: number[] = [];
  around.forEach((corners, v) => {
    const fan = corners.map((_, i) => i); // union-find of those that are smooth; a vertex has few
    const root = (i: number): number => (fan[i] === i ? i : root(fan[i]));
    for (let i = 0; i < corners.length; ++i)
      for (let j = 0; j < i; ++j) {
        const a = Math.floor(corners[i] / 3), b = Math.floor(corners[j] / 3);
        if (faces[a].dot(faces[b]) > crease && shareEdge(car.triangle, a, b, v)) fan[root(i)] = root(j);
      }
    const corner = new Map<number, number>();
    corners.forEach((at, i) => {
      const own = root(i);
      if (!corner.has(own)) corner.set(own, vertexOf.push(v) - 1);
      triangle[at] = corner.get(own)!;
    });
  });
  return { triangle, vertexOf: Uint32Array.from(vertexOf) };
}

function shareEdge(triangle: Uint32Array, a: number, b: number, besides: number): boolean {
  for (let i = 3 * a; i < 3 * a + 3; ++i)
    for (let j = 3 * b; j < 3 * b + 3; ++j) if (triangle[i] === triangle[j] && triangle[i] !== besides) return true;
  return false;
}

function faceNormal(car: BakedCar, t: number): THREE.Vector3 {
  const [a, b, c] = [0, 1, 2].map((k) => new THREE.Vector3().fromArray(car.vertex, 3 * car.triangle[3 * t + k]));
  return b.sub(a).cross(c.sub(a)).normalize();
}

/** Makes the geometry of an obstacle in its own frame; null: of a half space, which has no end. */
export function obstacleGeometry(obstacle: Obstacle): THREE.BufferGeometry | null {
  const [x, y, z] = obstacle.size;
  switch (obstacle.shape) {
    case Shape.box:
      return new THREE.BoxGeometry(2 * x, 2 * y, 2 * z);
    case Shape.sphere:
      return new THREE.SphereGeometry(x, 48, 24);
    case Shape.capsule:
      return new THREE.CapsuleGeometry(x, 2 * y, 12, 32).rotateX(Math.PI / 2); // the axis of three's capsule is y
    case Shape.hull:
      return obstacle.points.length < 4 ? null : hull(obstacle.points);
    default:
      return null;
  }
}

function hull(points: [number, number, number][]): THREE.BufferGeometry {
  return new ConvexGeometry(points.map((point) => new THREE.Vector3(...point)));
}
