// Has what one view shows of its scene: cars and obstacles.
import * as THREE from "three";
import type { Scene } from "../scene.js";
import type { Quantity } from "./colours.js";
import type { Comparison } from "./compare.js";
import { element } from "./element.js";
import { ShownObstacles } from "./obstacles.js";
import { ShownCar } from "./shown.js";

// Okabe and Ito's colours, which the colour-blind can tell apart too. Labels have the names as well.
const paints = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];

export class Stage {
  readonly group = new THREE.Group();
  readonly cars = new Map<string, ShownCar>();
  readonly obstacles = new ShownObstacles(this.group);
  /** The user's own model, in place of the surface of cars that were baked from it. */
  model: THREE.Object3D | null = null;
  /** What the view is about; null: nothing yet. */
  about: { center: THREE.Vector3; radius: number } | null = null;

  /** choose: what a click on a car's row in the panel does; null: the cars of this stage have no rows. */
  constructor(readonly source: () => Scene, readonly choose: ((id: string) => void) | null) {}

  updateCars(): void {
    const source = this.source();
    for (const [id, item] of this.cars)
      if (source.cars.get(id) !== item.car) {
        item.remove();
        this.cars.delete(id);
      }
    for (const [id, car] of source.cars) {
      if (!this.cars.has(id)) this.#add(new ShownCar(car, this.#freePaint(), this.source));
      this.cars.get(id)!.update(source.now(), this.model);
    }
  }

  paintCars(heatOf: Quantity | null, comparison: Comparison | null): void {
    for (const item of this.cars.values()) item.paint(heatOf, comparison);
  }

  #add(item: ShownCar): void {
    const { choose } = this, { id } = item.car;
    this.cars.set(id, item);
    this.group.add(item.group, item.arrow);
    element("labels").append(item.label);
    if (!choose) return;
    item.row.onclick = () => choose(id);
    element("cars").append(item.row);
  }

  // Gives the first colour that no car has, or that the fewest cars have.
  #freePaint(): string {
    const uses = (paint: string) => [...this.cars.values()].filter(({ colour }) => colour === paint).length;
    return paints.reduce((best, paint) => (uses(paint) < uses(best) ? paint : best));
  }

  /** Makes obstacles between the eye and a car transparent. */
  seeThrough(eye: THREE.Vector3): void {
    this.obstacles.seeThrough(eye, [...this.cars.values()].filter(({ mesh }) => mesh).map((item) => item.center()));
  }
}
