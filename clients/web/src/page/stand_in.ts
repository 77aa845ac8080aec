// The undamaged car that a tool shows in place of a car: matt, with colours of its vertices, and hit by rays.
import * as THREE from "three";
import type { Vec3 } from "../decode.js";
import { CarMesh } from "../three.js";
import type { Shown, Workbench } from "./workbench.js";

export const bare = new THREE.Color("#e3e3df");

/** Where the pointer is on the car, in its frame, and a vertex nearby. */
export interface Hit {
  at: THREE.Vector3;
  vertex: number;
}

export class StandIn {
  readonly group = new THREE.Group();
  readonly mesh: CarMesh;
  readonly material = new THREE.MeshStandardMaterial({ vertexColors: true, roughness: 0.75, side: THREE.DoubleSide });
  #ray = new THREE.Raycaster();

  /** instead: the mesh of the car, until that is painted anew. */
  constructor(readonly workbench: Workbench, readonly car: Shown, readonly instead: CarMesh) {
    this.mesh = new CarMesh(instead.baked, this.material);
    car.group.add(this.group.add(this.mesh));
    this.hideCar();
  }

  /** Call this for every picture, because the page shows the car again with each. */
  hideCar(): void {
    this.instead.visible = false;
    if (this.car.own) this.car.own.visible = false;
  }

  remove(): void {
    this.group.removeFromParent();
    this.mesh.geometry.dispose();
    this.material.dispose();
  }

  /** Points the ray at a place on the page. */
  aim({ clientX, clientY }: { clientX: number; clientY: number }): THREE.Raycaster {
    const box = this.workbench.canvas.getBoundingClientRect();
    this.#ray.setFromCamera(new THREE.Vector2((2 * (clientX - box.left)) / box.width - 1, 1 - (2 * (clientY - box.top)) / box.height), this.workbench.camera);
    return this.#ray;
  }

  hit(on: { clientX: number; clientY: number }): Hit | null {
    const [hit] = this.aim(on).intersectObject(this.mesh, false);
    return hit ? { at: this.mesh.worldToLocal(hit.point.clone()), vertex: this.mesh.vertexOf(hit.face!.a) } : null;
  }

  /** In the middle of the part of the window that the panel leaves free, where the camera looks. */
  middle(): Hit | null {
    const { x, y } = this.#onPage(this.workbench.controls.target.clone());
    return this.hit({ clientX: x, clientY: y });
  }

  /** Gives the place on the page of a point of the car, m in its frame; for tests. */
  screen(point: Vec3): { x: number; y: number } {
    return this.#onPage(new THREE.Vector3(...point).applyMatrix4(this.mesh.matrixWorld));
  }

  #onPage(world: THREE.Vector3): { x: number; y: number } {
    const at = world.project(this.workbench.camera), box = this.workbench.canvas.getBoundingClientRect();
    return { x: box.left + ((at.x + 1) / 2) * box.width, y: box.top + ((1 - at.y) / 2) * box.height };
  }
}
