// A car as the page shows it: its mesh and colours, the arrow of its last hit, its label, and its row in the panel.
import * as THREE from "three";
import type { LiveCar, Scene } from "../scene.js";
import { CarMesh, OwnModel, partMaterials } from "../three.js";
import { heat, heatMost, type Quantity } from "./colours.js";
import type { Comparison } from "./compare.js";
import { place, release } from "./objects.js";

const gravity = 9.81; // m/s²
const arrowStays = 1500; // ms

export class ShownCar {
  readonly group = new THREE.Group();
  readonly arrow = makeArrow();
  readonly label = document.createElement("div");
  readonly row = document.createElement("button");
  mesh: CarMesh | null = null;
  #paint: THREE.MeshStandardMaterial | null = null; // of its body
  own: OwnModel | null = null; // in place of the mesh
  #model: THREE.Object3D | null = null; // what it was made from
  #version = -1;
  #painted = ""; // the quantity that its vertices show, and the version of the surface
  #extent = new THREE.Box3();

  /** source: the scene that the car is in. */
  constructor(readonly car: LiveCar, readonly colour: string, readonly source: () => Scene) {
    for (const item of [this.label, this.row]) item.style.setProperty("--paint", colour);
    this.label.className = "label";
    this.label.textContent = car.id;
    this.row.innerHTML = `<span class="dent"></span><span class="name"></span><small></small><small></small>`;
    this.row.querySelector(".name")!.textContent = car.id;
    this.group.visible = false;
  }

  remove(): void {
    this.group.removeFromParent();
    this.arrow.removeFromParent();
    this.#undress();
    release(this.arrow);
    this.label.remove();
    this.row.remove();
  }

  #undress(): void {
    this.#takeOff();
    this.mesh?.removeFromParent();
    this.mesh?.geometry.dispose();
    this.#paint?.dispose();
  }

  #takeOff(): void {
    this.own?.removeFromParent();
    this.own?.dispose();
    this.own = this.#model = null;
  }

  // A car that was baked from another file keeps its surface.
  #putOn(model: THREE.Object3D | null): void {
    if (this.#model === model || !this.mesh) return;
    this.#takeOff();
    this.#model = model;
    try {
      if (model) this.group.add((this.own = new OwnModel(this.mesh.baked, model.clone(true))));
    } catch {
      this.own = null;
    }
    this.own?.update(this.mesh.skinned);
  }

  /** now: ms, by the scene's clock. model: the user's own, null: none. */
  update(now: number, model: THREE.Object3D | null): void {
    const { car } = this;
    if (car.baked && this.mesh?.baked !== car.baked) {
      this.#undress();
      this.#version = -1;
      this.#painted = "";
      this.#paint = new THREE.MeshStandardMaterial({ color: this.colour, roughness: 0.3, metalness: 0.25, side: THREE.DoubleSide });
      this.mesh = new CarMesh(car.baked, partMaterials(this.#paint, car.baked));
      this.#extent.setFromBufferAttribute(new THREE.BufferAttribute(car.baked.vertex, 3));
      this.group.add(this.mesh);
    }
    if (!this.mesh) return;
    this.#putOn(model);
    if (this.#version !== car.version && this.mesh.update(car.surface)) {
      this.#version = car.version;
      this.own?.update(this.mesh.skinned);
    }
    // While no pose has come, the car stands at the origin: cars are spawned there more often than anywhere else.
    if (car.pose) place(this.group, car.pose);
    this.group.visible = true;
    this.#point(now);
  }

  /** Gives the car its own colour, or colours by a quantity. In a comparison, call it after that has found the differences. */
  paint(heatOf: Quantity | null, comparison: Comparison | null): void {
    const { mesh } = this, material = this.#paint;
    if (!mesh || !material) return;
    const heated = heatOf === "strain" || (heatOf === "dent" && (!comparison || comparison.has(this)));
    if (material.vertexColors !== heated) {
      material.vertexColors = heated;
      material.color.set(heated ? "#ffffff" : this.colour);
      material.roughness = heated ? 0.7 : 0.3;
      material.needsUpdate = true;
    }
    mesh.material = heated ? material : partMaterials(material, mesh.baked);
    mesh.visible = heated || !this.own;
    if (this.own) this.own.visible = !heated;
    const wanted = !heated ? "" : comparison && heatOf === "dent" ? "difference" : `${heatOf} ${this.#version}`;
    if (this.#painted === wanted) return;
    this.#painted = wanted;
    if (heatOf === "dent" && !comparison) mesh.paint(heat, heatMost.dent);
    if (heatOf === "strain") mesh.paint(heat, heatMost.strain, mesh.strain());
  }

  // The arrow shows the greatest impulse of the last hit as a deceleration: 4 cm for each g.
  #point(now: number): void {
    const { peak, peakAt } = this.car, fade = peak ? 1 - (now - peakAt) / arrowStays : 0;
    this.arrow.visible = fade > 0;
    if (!peak || fade <= 0) return;
    const impulse = new THREE.Vector3(...peak.impulse), g = this.deceleration;
    if (!(g > 0.5)) return void (this.arrow.visible = false);
    const length = Math.min(0.5 + 0.04 * g, 4), along = impulse.normalize();
    this.arrow.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), along);
    this.arrow.position.copy(this.center()).addScaledVector(along, -length);
    stretch(this.arrow, length, Math.min(1, 2 * fade));
  }

  /** In the tick of the greatest impulse of the last hit, g. */
  get deceleration(): number {
    const { peak, baked } = this.car, rate = this.source().health?.rate || 60;
    return peak && baked ? (Math.hypot(...peak.impulse) * rate) / baked.mass / gravity : 0;
  }

  center(): THREE.Vector3 {
    return this.#extent.getCenter(new THREE.Vector3()).applyMatrix4(this.group.matrixWorld);
  }
  get radius(): number {
    return this.mesh ? this.#extent.getSize(new THREE.Vector3()).length() / 2 : 2.5;
  }
  top(): THREE.Vector3 {
    return this.center().add(new THREE.Vector3(0, 0, this.#extent.max.z - this.#extent.min.z));
  }
}

function makeArrow(): THREE.Group {
  const material = new THREE.MeshBasicMaterial({ color: "#111418", transparent: true, depthTest: false });
  const shaft = new THREE.Mesh(new THREE.CylinderGeometry(0.045, 0.045, 1, 16).rotateX(Math.PI / 2).translate(0, 0, 0.5), material);
  const head = new THREE.Mesh(new THREE.ConeGeometry(0.14, 0.36, 24).rotateX(Math.PI / 2).translate(0, 0, -0.18), material);
  const group = new THREE.Group().add(shaft, head);
  group.renderOrder = shaft.renderOrder = head.renderOrder = 10;
  group.visible = false;
  return group;
}

function stretch(arrow: THREE.Group, length: number, opacity: number): void {
  const [shaft, head] = arrow.children as THREE.Mesh<THREE.BufferGeometry, THREE.MeshBasicMaterial>[];
  shaft.scale.z = length - 0.36;
  head.position.z = length;
  shaft.material.opacity = opacity; // the head has the same material
}
