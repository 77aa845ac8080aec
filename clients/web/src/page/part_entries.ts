// The entries of a parts file (schema/parts.fbs): those that give a baked car its parts, those of a file, and what the page writes.
import * as THREE from "three";
import { noLook, type BakedCar } from "../baked.js";
import { partKinds, type PartKind } from "../parts.js";
import { inJson, pointOf, type Point } from "./workbench.js";

/** It may have more than its kind needs: what the user changes to another kind and back is as it was. */
export interface Entry {
  name: string;
  kind: PartKind;
  source?: string[];
  position?: Point;
  orientation?: Point & { w: number };
  radius?: number;
  width?: number;
  /** The part of the baked car that it is; none: the car has no such part yet. */
  of?: number;
}

/** The name of what is in no part. The entry of a part that was removed has it too, so that no earlier entry takes that part. */
export const body = "body";

export const hasSurface = ({ name, kind }: Entry) => name !== body && kind !== "point";

/** Gives the entries of the car's parts, as far as the car says. */
export function entriesOf(baked: BakedCar): Entry[] {
  return baked.parts.slice(1).map(({ name, kind, position: [x, y, z], orientation: q, radius, width }, i) => {
    const entry: Entry = { name, kind, position: { x: short(x), y: short(y), z: short(z) }, of: i + 1 };
    if (Math.abs(q[3]) < 1) entry.orientation = { x: q[0], y: q[1], z: q[2], w: q[3] };
    return kind === "wheel" ? { ...entry, radius: short(radius), width: short(width) } : { ...entry, source: namesOf(baked, i + 1) };
  });
}

// A car keeps no names of the source, but for two: those of materials, which are enough if the part has all their triangles and no
// others, and the name of a panel, which the bake takes from the source.
function namesOf(baked: BakedCar, part: number): string[] {
  const mine = new Set<string | undefined>(), others = new Set<string | undefined>();
  baked.triangleLook.forEach((look, t) => (baked.vertexPart[baked.triangle[3 * t]] === part ? mine : others).add(look === noLook ? undefined : baked.looks[look].name));
  const { name, kind } = baked.parts[part], enough = mine.size && [...mine].every((each) => each && !others.has(each));
  return (enough ? [...mine] : kind === "panel" ? [name] : []).map((each) => each!.replace(/[*?[\]\\]/g, "\\$&"));
}

/** The shortest number that is the same in 32 bits. */
function short(x: number): number {
  return [6, 7, 8, 9].map((digits) => Number(x.toPrecision(digits))).find((each) => Math.fround(each) === x) ?? x;
}

/** Reads a parts file. Throws an Error with a sentence. */
export function readEntries(text: string, baked: BakedCar): Entry[] {
  const { parts } = JSON.parse(text) as { parts?: Entry[] }, entries: Entry[] = [];
  if (!Array.isArray(parts) || parts.some(({ name, kind = "body", source = [] }) => typeof name !== "string" || !partKinds.includes(kind) || !Array.isArray(source)))
    throw new Error('it needs a list "parts", each with a name and a kind');
  for (const entry of parts) {
    const of = baked.parts.findIndex(({ name }, i) => i > 0 && name === entry.name);
    const before = entries.find(({ name }) => name === entry.name && name !== body); // several entries of one name are one part
    if (before) before.source = [...(before.source ?? []), ...(entry.source ?? [])];
    else entries.push({ ...entry, kind: entry.kind ?? "body", of: of < 0 ? undefined : of });
  }
  return entries;
}

/** Gives the first entry of which it is not known what it takes; -1: none. */
export function firstUnknown(entries: readonly Entry[], { vertexPart }: BakedCar): number {
  const isRound = ({ radius, of }: Entry) => !!radius || (!!of && vertexPart.includes(of));
  return entries.findIndex((entry) => hasSurface(entry) && !entry.source?.length && !(entry.kind === "wheel" && isRound(entry)));
}

/** Gives the text of a parts file. */
export function writeEntries(entries: readonly Entry[], baked: BakedCar): string {
  return inJson("parts", entries.flatMap(({ name, kind, source = [], position, orientation, radius, width, of }): object[] => {
    if (name === body) return source.length ? [{ name, kind, source }] : [];
    if (kind === "point") return [{ name, kind, position, orientation }];
    if (kind !== "wheel") return [{ name, kind, source }];
    const cylinder = radius && width ? { position, radius, width } : source.length || !of ? {} : cylinderOf(baked, of);
    return [{ name, kind, source: source.length ? source : undefined, ...cylinder, orientation }];
  }));
}

// The cylinder about y that holds all of a part.
function cylinderOf({ vertex, vertexPart }: BakedCar, part: number): Pick<Entry, "position" | "radius" | "width"> {
  const places = [...vertexPart.keys()].filter((v) => vertexPart[v] === part).map((v) => new THREE.Vector3().fromArray(vertex, 3 * v));
  const box = new THREE.Box3().setFromPoints(places), hub = box.getCenter(new THREE.Vector3());
  const radius = Math.max(...places.map(({ x, z }) => Math.hypot(x - hub.x, z - hub.z))), width = box.max.y - box.min.y;
  return { position: pointOf(hub), radius: Number(radius.toFixed(4)), width: Number(width.toFixed(4)) };
}
