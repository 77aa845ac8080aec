// A brush on the undamaged surface. A dab is a sphere of schema/regions.fbs, the eraser paints spheres of "body", and the last one
// counts. So a painted mask is a regions file.
import * as THREE from "three";
import { TessellateModifier } from "three/addons/modifiers/TessellateModifier.js";
import { readCar, type BakedCar } from "../baked.js";
import type { Control } from "../control.js";
import { digits, hashOf, type Vec3 } from "../decode.js";
import { palette } from "./colours.js";
import { History } from "./history.js";
import { bare, StandIn } from "./stand_in.js";
import { download, inJson, pick, pointOf, sentence, type Point, type Shown, type Workbench } from "./workbench.js";

/** An entry of a regions file. It has either a sphere or a box. */
interface Entry {
  name: string;
  anchored?: boolean;
  sphere?: { center: Point; radius: number };
  box?: { center: Point; half: Point; orientation?: Point & { w: number } };
}

/** Distance from dab to dab of a stroke, as a share of the radius. */
const spacing = 0.4;
const radii = { low: 0.05, high: 0.8, first: 0.2 }; // m
const eraser = "body";
/** Divides the triangles of the mask, because flat sheets of a car have few vertices. */
const tiles = new TessellateModifier(0.06, 10); // m, halvings
/** Width of the cells that the corners of the mask are sorted into, so that a dab looks only at those near it, m. */
const cellWidth = 0.2;

export class Paint {
  readonly root = document.createElement("details");
  #history = new History<readonly Entry[]>([], () => this.#changed());
  #tinted: readonly Entry[] = []; // the entries that the mask shows
  #on = false;
  #stroke: Entry[] | null = null; // the one that the pointer paints now
  #pointers = new Set<number>();
  #standIn: StandIn | null = null;
  #mask: THREE.Mesh<THREE.BufferGeometry, THREE.Material> | null = null; // what the page shows of it
  #cells: { center: THREE.Vector3; corners: number[] }[] = [];
  #tip = new THREE.Mesh(new THREE.SphereGeometry(1, 32, 16), new THREE.MeshBasicMaterial({ color: "#111418", transparent: true, opacity: 0.22, depthWrite: false }));
  #baked: { bytes: Uint8Array; name: string } | null = null;

  constructor(readonly control: Control, readonly workbench: Workbench, readonly chosen: () => Shown | null, readonly tell: (text: string, bad?: boolean) => void) {
    this.root.id = "paint";
    this.root.innerHTML = `<summary>Paint</summary>
      <button id="paint-on" aria-pressed="false" aria-keyshortcuts="m" title="Key M">Paint with the pointer</button>
      <p class="note">Right button, two fingers or arrow keys turn the view meanwhile. Anchors hold the car on its pose.</p>
      <label class="row">Brush <select id="paint-kind"><option value="region">region</option><option value="anchor">anchors</option><option value="eraser">eraser</option></select></label>
      <label class="row">Name <input id="paint-name" value="front" maxlength="32" list="paint-names" autocomplete="off"></label><datalist id="paint-names"></datalist>
      <div class="slider"><label for="paint-radius">radius</label><output id="paint-size"></output><input id="paint-radius" type="range" min="${radii.low}" max="${radii.high}" step="0.01" value="${radii.first}"></div>
      <ul id="paint-legend" aria-label="What is painted"></ul>
      <div class="buttons"><button id="paint-undo" aria-keyshortcuts="Control+z">Undo</button><button id="paint-redo" aria-keyshortcuts="Control+y">Redo</button><button id="paint-dab">Dab in the middle</button>
      <button id="paint-save">Save regions</button><button id="paint-load">Load regions</button><button id="paint-clear">Clear</button></div>
      <div class="buttons"><button id="paint-bake" class="main">Re-bake</button><button id="paint-car" disabled>Download car</button></div>
      <input id="paint-file" type="file" accept=".json" hidden>`;
    const press = (id: string, action: () => void) => (this.#find<HTMLButtonElement>(`#paint-${id}`).onclick = action);
    press("on", () => this.toggle(!this.#on));
    press("undo", () => this.#history.undo());
    press("redo", () => this.#history.redo());
    press("clear", () => this.#history.become([]));
    press("dab", () => this.#dabInTheMiddle());
    press("save", () => download("regions.json", this.json(), "application/json"));
    press("load", () => pick(this.#find("#paint-file"), (text, name) => this.#load(text, name)));
    press("bake", () => void this.#bake());
    press("car", () => this.#baked && download(this.#baked.name, this.#baked.bytes as Uint8Array<ArrayBuffer>, "application/octet-stream"));
    const radius = this.#find<HTMLInputElement>("#paint-radius"), size = this.#find("#paint-size");
    radius.oninput = () => (size.textContent = `${Number(radius.value).toFixed(2)} m`);
    radius.dispatchEvent(new Event("input"));
    this.root.ontoggle = () => !this.root.open && this.toggle(false);
    this.#tip.visible = false;
    this.#tip.renderOrder = 5;
    this.#listen();
    this.#changed();
  }

  /** While this is on, the page shows the car undamaged, and the pointer paints it. */
  toggle(on: boolean): void {
    this.#on = on;
    if (on) this.root.open = true;
    this.#find("#paint-on").setAttribute("aria-pressed", String(on));
    const { controls } = this.workbench;
    controls.mouseButtons = { LEFT: on ? null : THREE.MOUSE.ROTATE, MIDDLE: THREE.MOUSE.DOLLY, RIGHT: on ? THREE.MOUSE.ROTATE : THREE.MOUSE.PAN };
    controls.touches = { ONE: on ? null : THREE.TOUCH.ROTATE, TWO: on ? THREE.TOUCH.DOLLY_ROTATE : THREE.TOUCH.DOLLY_PAN };
    this.workbench.canvas.style.cursor = on ? "crosshair" : "";
    this.update();
    this.workbench.wake();
  }

  /** Gives the regions file. */
  json(): string {
    return inJson("regions", this.#history.now);
  }

  update(): void {
    const shown = this.chosen();
    if (this.#on && !shown) return this.toggle(false);
    const wanted = this.#on ? shown!.mesh : null;
    this.#standIn?.hideCar();
    if (wanted === (this.#standIn?.instead ?? null)) return;
    this.#drop();
    if (!wanted) return;
    this.#standIn = new StandIn(this.workbench, shown!, wanted);
    const { mesh, material } = this.#standIn;
    mesh.visible = false;
    this.#mask = new THREE.Mesh(tiles.modify(mesh.geometry), material);
    this.#mask.castShadow = true;
    const { position, color } = this.#mask.geometry.attributes;
    this.#cells = inCells(position);
    for (let i = 0; i < color.count; ++i) color.setXYZ(i, bare.r, bare.g, bare.b);
    this.#standIn.group.add(this.#mask, this.#tip);
    this.#changed();
  }

  /** Whether the pointer can paint now. */
  get showing(): boolean {
    return this.#mask !== null;
  }

  /** Gives the place on the page of a point of the car, m in its frame; for tests. */
  screen(point: Vec3): { x: number; y: number } {
    return this.#standIn!.screen(point);
  }

  #find<T extends HTMLElement>(what: string): T {
    return this.root.querySelector<T>(what)!;
  }

  #drop(): void {
    this.#standIn?.remove();
    this.#mask?.geometry.dispose();
    this.#standIn = this.#mask = null;
    this.#tinted = this.#cells = [];
  }

  // ---- the pointer ----

  #listen(): void {
    const { canvas } = this.workbench;
    canvas.addEventListener("pointerdown", (event) => {
      if (!this.#on) return;
      this.#pointers.add(event.pointerId);
      if (this.#pointers.size > 1) return this.#end(false); // a second finger turns the view
      if (event.button !== 0) return;
      this.#stroke = [];
      this.#dab(this.#hit(event));
    });
    canvas.addEventListener("pointermove", (event) => {
      if (!this.#on) return;
      const point = this.#hit(event);
      this.#point(point);
      if (this.#stroke && this.#pointers.has(event.pointerId)) this.#dab(point);
    });
    const up = (event: PointerEvent) => {
      this.#pointers.delete(event.pointerId);
      this.#end(event.type === "pointerup");
    };
    canvas.addEventListener("pointerup", up);
    canvas.addEventListener("pointercancel", up);
    canvas.addEventListener("pointerleave", () => this.#point(null));
    addEventListener("keydown", (event) => {
      if (event.target instanceof HTMLInputElement && event.target.type !== "range") return;
      const key = event.key.toLowerCase();
      if (key === "m" && !event.ctrlKey && !event.metaKey && !event.altKey && this.chosen()) return this.toggle(!this.#on);
      if (!this.#on || !(event.ctrlKey || event.metaKey)) return;
      if (key === "z" || key === "y") {
        event.preventDefault();
        if (key === "z" && !event.shiftKey) this.#history.undo();
        else this.#history.redo();
      }
    });
  }

  #hit(event: { clientX: number; clientY: number }): THREE.Vector3 | null {
    return this.#standIn?.hit(event)?.at ?? null;
  }

  #point(at: THREE.Vector3 | null): void {
    this.#tip.visible = at !== null;
    if (at) this.#tip.position.copy(at);
    this.#tip.scale.setScalar(this.#radius);
    this.workbench.wake();
  }

  get #radius(): number {
    return Number(this.#find<HTMLInputElement>("#paint-radius").value);
  }

  #dab(at: THREE.Vector3 | null): void {
    if (!at || !this.#stroke) return;
    const radius = this.#radius, last = this.#stroke.at(-1)?.sphere?.center;
    if (last && at.distanceTo(new THREE.Vector3(last.x, last.y, last.z)) < spacing * radius) return;
    const kind = this.#find<HTMLSelectElement>("#paint-kind").value;
    const name = kind === "eraser" ? eraser : this.#find<HTMLInputElement>("#paint-name").value.trim() || "front";
    this.#stroke.push({ name, ...(kind === "anchor" ? { anchored: true } : {}), sphere: { center: pointOf(at), radius } });
    this.#changed();
  }

  #end(whole: boolean): void {
    const stroke = this.#stroke;
    this.#stroke = null;
    if (whole && stroke?.length) this.#history.become([...this.#history.now, ...stroke]);
    else if (stroke) this.#changed();
  }

  #dabInTheMiddle(): void {
    if (!this.#on) this.toggle(true);
    const point = this.#standIn?.middle()?.at;
    if (!point) return this.tell("the middle of the view is not on the car", true);
    this.#stroke = [];
    this.#dab(point);
    this.#end(true);
  }

  // ---- what is painted ----

  #load(text: string, name: string): void {
    try {
      const { regions } = JSON.parse(text) as { regions?: Entry[] };
      if (!Array.isArray(regions) || regions.some((entry) => typeof entry.name !== "string" || (!entry.sphere && !entry.box)))
        throw new Error('it needs a list "regions", each with a name and a sphere or a box');
      this.#history.become(regions);
      this.tell(`${name}: ${regions.length} entries`);
    } catch (error) {
      this.tell(`${name} is not a regions file in strict JSON: ${sentence(error)}`, true);
    }
  }

  #changed(): void {
    const entries = [...this.#history.now, ...(this.#stroke ?? [])], legend = new Map<string, { colour: THREE.Color; label: string }>();
    const key = ({ name, anchored }: Entry) => `${name} ${anchored ?? false}`;
    for (const entry of entries) {
      if ((entry.name === eraser && !entry.anchored) || legend.has(key(entry))) continue;
      const colour = palette[legend.size % palette.length];
      legend.set(key(entry), { colour, label: entry.name + (entry.anchored ? ", anchored" : "") });
    }
    if (this.#mask) this.#tint(this.#mask.geometry.attributes, entries, (entry) => legend.get(key(entry))?.colour ?? bare);
    const rows = [...legend.values()].map(({ colour, label }) => {
      const row = document.createElement("li"), swatch = document.createElement("i");
      swatch.style.background = `#${colour.getHexString()}`;
      row.append(swatch, label);
      return row;
    });
    this.#find("#paint-legend").replaceChildren(...rows);
    this.#find("#paint-names").replaceChildren(...[...new Set(entries.map(({ name }) => name))].map((name) => new Option(name)));
    this.#find<HTMLButtonElement>("#paint-undo").disabled = !this.#history.past;
    this.#find<HTMLButtonElement>("#paint-redo").disabled = !this.#history.future;
    this.workbench.wake();
  }

  // Colours corners anew: those of entries that went, by the remaining entries; then those of entries that came.
  #tint({ position, color }: THREE.NormalBufferAttributes, entries: readonly Entry[], colourOf: (entry: Entry) => THREE.Color): void {
    const before = this.#tinted, point = new THREE.Vector3();
    let same = 0;
    while (same < before.length && before[same] === entries[same]) ++same;
    const held = (entry: Entry) => {
      const holds = inside(entry), center = (entry.sphere ?? entry.box)!.center as THREE.Vector3;
      const reach = (entry.sphere?.radius ?? point.copy(entry.box!.half as THREE.Vector3).length()) + (Math.sqrt(3) / 2) * cellWidth;
      const near = this.#cells.filter((cell) => cell.center.distanceTo(center) <= reach).flatMap(({ corners }) => corners);
      return near.filter((i) => holds(point.fromBufferAttribute(position, i)));
    };
    const tint = (i: number, { r, g, b }: THREE.Color) => color.setXYZ(i, r, g, b);
    const stand = entries.slice(0, same).reverse().map((entry) => ({ holds: inside(entry), colour: colourOf(entry) }));
    for (const i of new Set(before.slice(same).flatMap(held))) {
      point.fromBufferAttribute(position, i);
      tint(i, stand.find(({ holds }) => holds(point))?.colour ?? bare);
    }
    for (const entry of entries.slice(same)) for (const i of held(entry)) tint(i, colourOf(entry));
    color.needsUpdate = true;
    this.#tinted = entries;
  }

  // ---- the car ----

  async #bake(): Promise<void> {
    const shown = this.chosen();
    if (!shown?.car.baked) return this.tell("there is no car to paint", true);
    const { id, surface } = shown.car;
    const button = this.#find<HTMLButtonElement>("#paint-bake"), begun = performance.now();
    button.disabled = true;
    this.tell("re-baking …");
    try {
      const bytes = await this.control.paint(surface.asset, this.json());
      const asset = digits(hashOf(bytes)), baked: BakedCar = readCar(bytes, asset), took = Math.round(performance.now() - begun);
      this.#baked = { bytes, name: `${baked.name}-painted.car` };
      this.#find<HTMLButtonElement>("#paint-car").disabled = false;
      if (asset !== surface.asset) await this.control.replace(id, asset);
      this.toggle(false);
      this.tell(`${id} is now ${asset}: ${baked.regions.join(", ")}; baked in ${took} ms`);
    } catch (error) {
      this.tell(`not re-baked: ${sentence(error)}`, true);
    }
    button.disabled = false;
  }
}

function inCells(position: THREE.BufferAttribute | THREE.InterleavedBufferAttribute): { center: THREE.Vector3; corners: number[] }[] {
  const cells = new Map<string, { center: THREE.Vector3; corners: number[] }>(), at = new THREE.Vector3();
  for (let i = 0; i < position.count; ++i) {
    at.fromBufferAttribute(position, i).divideScalar(cellWidth).floor();
    const key = `${at.x} ${at.y} ${at.z}`, cell = cells.get(key);
    if (cell) cell.corners.push(i);
    else cells.set(key, { center: at.clone().addScalar(0.5).multiplyScalar(cellWidth), corners: [i] });
  }
  return [...cells.values()];
}

/** Gives a function that says whether a point, m in the car's frame, is in the entry. */
function inside({ sphere, box }: Entry): (point: THREE.Vector3) => boolean {
  const at = new THREE.Vector3(), center = new THREE.Vector3();
  if (sphere) {
    center.copy(sphere.center as THREE.Vector3);
    return (point) => point.distanceToSquared(center) <= sphere.radius ** 2;
  }
  const { x, y, z, w } = box!.orientation ?? { x: 0, y: 0, z: 0, w: 1 }, back = new THREE.Quaternion(x, y, z, w).invert();
  center.copy(box!.center as THREE.Vector3);
  return (point) => {
    at.copy(point).sub(center).applyQuaternion(back);
    return Math.abs(at.x) <= box!.half.x && Math.abs(at.y) <= box!.half.y && Math.abs(at.z) <= box!.half.z;
  };
}
