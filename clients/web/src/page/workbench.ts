// What the page lends its tools, and what they do with files and refusals.
import type * as THREE from "three";
import type { OrbitControls } from "three/addons/controls/OrbitControls.js";
import type { LiveCar } from "../scene.js";
import type { CarMesh } from "../three.js";

/** A car as the page shows it. */
export interface Shown {
  car: LiveCar;
  group: THREE.Group;
  mesh: CarMesh | null;
  own: THREE.Object3D | null; // the user's model, in place of the mesh
}

/** As the files that the page reads and writes have it, m in the car's frame. */
export interface Point {
  x: number;
  y: number;
  z: number;
}

/** Gives a place that the pointer has found: to a tenth of a millimetre. */
export function pointOf(at: THREE.Vector3): Point {
  const [x, y, z] = at.toArray().map((value) => Number(value.toFixed(4)));
  return { x, y, z };
}

/** Gives the text of a regions or parts file: a line for each entry. */
export function inJson(name: string, entries: readonly object[]): string {
  return `{\n  "${name}": [${entries.map((entry) => `\n    ${JSON.stringify(entry)}`).join(",")}\n  ]\n}\n`;
}

/** What the page lends its tools. */
export interface Workbench {
  canvas: HTMLCanvasElement;
  camera: THREE.PerspectiveCamera;
  controls: OrbitControls;
  /** By id; none while a recording is shown. */
  cars(): Map<string, Shown>;
  followed(): string;
  wake(): void;
}

/** Gives bytes or text to the user as a file. */
export function download(name: string, data: BlobPart, type: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([data], { type }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** Asks the user for a file and gives its text. */
export function pick(input: HTMLInputElement, take: (text: string, name: string) => void): void {
  input.onchange = async () => {
    const [file] = input.files ?? [];
    if (file) take(await file.text(), file.name);
    input.value = "";
  };
  input.click();
}

export function sentence(error: unknown): string {
  return error instanceof Error ? error.message : `${error}`;
}
