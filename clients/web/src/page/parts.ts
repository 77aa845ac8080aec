// Shows the parts of a baked car and changes them. A baked car cannot change, so what the user gets is a parts file (schema/parts.fbs),
// with which the bake of the surface makes such a car.
import * as THREE from "three";
import type { BakedCar } from "../baked.js";
import { partKinds, type PartKind } from "../parts.js";
import { palette } from "./colours.js";
import { History } from "./history.js";
import { body, entriesOf, firstUnknown, hasSurface, readEntries, writeEntries, type Entry } from "./part_entries.js";
import { bare, StandIn, type Hit } from "./stand_in.js";
import { download, pick, pointOf, sentence, type Shown, type Workbench } from "./workbench.js";

type Mark = THREE.Mesh<THREE.BufferGeometry, THREE.MeshBasicMaterial>;

const nameLimit = 64;
const sizeOfPoint = 0.05; // m, its radius in the picture
const command = "crumple bake FILE --parts parts.json -o car.car";

export class Parts {
  readonly root = document.createElement("details");
  #histories = new Map<string, History<readonly Entry[]>>(); // by the parts of the baked car, which stay when it is painted anew
  #history = new History<readonly Entry[]>([], () => {});
  #standIn: StandIn | null = null;
  #marks: Mark[] = []; // the points, and the part that is lit, also where others hide them
  #chosen = -1; // the entry that the user edits
  #under = -1; // the entry that the pointer is on in the list
  #places = false; // the next click on the car places a point
  #down: { x: number; y: number } | null = null;

  constructor(readonly workbench: Workbench, readonly chosen: () => Shown | null, readonly tell: (text: string, bad?: boolean) => void) {
    this.root.id = "parts";
    this.root.innerHTML = `<summary>Parts</summary><div id="parts-all">
      <p class="note">Choose a part here, or click on it. What is in no part belongs to the body.</p>
      <ul id="parts-list" aria-label="Parts of the car"></ul><p id="parts-none">There is only the body.</p>
      <div id="parts-edit"><label class="row">Name <input id="parts-name" maxlength="${nameLimit}" autocomplete="off"></label>
      <label class="row">Kind <select id="parts-kind">${partKinds.map((kind) => `<option>${kind}</option>`).join("")}</select></label>
      <label class="row" id="parts-of">Source names <textarea id="parts-source" rows="2" spellcheck="false" placeholder="*window*&#10;glass" title="Of materials, meshes and nodes in the file that you bake, a line each; * is any text, ? any character"></textarea></label></div>
      <div class="buttons"><button id="parts-undo">Undo</button><button id="parts-redo">Redo</button><button id="parts-remove">Remove</button>
      <button id="parts-point" aria-pressed="false">Add a point</button><button id="parts-middle">Point in the middle</button></div>
      <div class="buttons"><button id="parts-save" class="main">Save parts</button><button id="parts-load">Load parts</button></div>
      <p class="note">Save the parts, then bake your file again: <code>${command}</code></p>
      <input id="parts-file" type="file" accept=".json" hidden></div>`;
    const press = (id: string, action: () => void) => (this.#find<HTMLButtonElement>(`#parts-${id}`).onclick = action);
    press("undo", () => this.#history.undo());
    press("redo", () => this.#history.redo());
    press("remove", () => this.#change({ name: body, kind: "body" }));
    press("point", () => this.#place(!this.#places));
    press("middle", () => this.#addPoint(this.#standIn?.middle() ?? null));
    press("save", () => this.#save());
    press("load", () => pick(this.#find("#parts-file"), (text, name) => this.#load(text, name)));
    this.#find<HTMLInputElement>("#parts-name").onchange = () => this.#rename();
    this.#find<HTMLSelectElement>("#parts-kind").onchange = ({ target }) => this.#change({ kind: (target as HTMLSelectElement).value as PartKind });
    const source = this.#find<HTMLTextAreaElement>("#parts-source");
    source.onchange = () => this.#change({ source: source.value.split("\n").map((line) => line.trim()).filter(Boolean) });
    source.onkeydown = (event) => event.stopPropagation(); // its letters are not keys of the page
    this.root.ontoggle = () => workbench.wake();
    this.#listen();
  }

  /** While its section is open, the page shows the car undamaged, each part in a colour. */
  update(): void {
    const shown = this.root.open ? this.chosen() : null, wanted = shown?.mesh ?? null;
    this.#standIn?.hideCar();
    if (wanted === (this.#standIn?.instead ?? null)) return;
    this.#standIn?.remove();
    this.#standIn = wanted && new StandIn(this.workbench, shown!, wanted);
    this.#place(false);
    if (wanted) this.#take(wanted.baked);
    this.#find("#parts-all").hidden = !wanted;
  }

  #take(baked: BakedCar): void {
    const key = JSON.stringify(baked.parts), history = this.#histories.get(key) ?? new History(entriesOf(baked), () => this.#changed());
    this.#histories.set(key, history);
    if (this.#history !== history) this.#chosen = -1;
    this.#history = history;
    this.#changed();
  }

  /** Whether the page shows the parts now. */
  get showing(): boolean {
    return this.#standIn !== null;
  }

  /** Gives the place on the page of a point of the car, m in its frame; for tests. */
  screen(point: [number, number, number]): { x: number; y: number } {
    return this.#standIn!.screen(point);
  }

  #find<T extends HTMLElement>(what: string): T {
    return this.root.querySelector<T>(what)!;
  }

  get #entries(): readonly Entry[] {
    return this.#history.now;
  }
  get #baked(): BakedCar {
    return this.#standIn!.instead.baked;
  }

  // ---- the pointer ----

  // A click chooses the part that it is on; the pointer turns the view while it is pressed.
  #listen(): void {
    const { canvas } = this.workbench;
    canvas.addEventListener("pointerdown", ({ clientX: x, clientY: y, button }) => (this.#down = button === 0 ? { x, y } : null));
    canvas.addEventListener("pointerup", (event) => {
      if (!this.#standIn || !this.#down || Math.hypot(event.clientX - this.#down.x, event.clientY - this.#down.y) > 4) return;
      if (this.#places) this.#addPoint(this.#standIn.hit(event));
      else this.#click(event);
    });
  }

  #click(event: PointerEvent): void {
    const [point] = this.#standIn!.aim(event).intersectObjects(this.#marks.filter(({ userData }) => userData.isPoint)); // they are before all else
    if (point) return this.#choose(point.object.userData.entry);
    const hit = this.#standIn!.hit(event), part = hit && this.#baked.vertexPart[hit.vertex];
    this.#choose(part ? this.#entries.findIndex((entry) => entry.of === part && hasSurface(entry)) : -1);
    if (hit && this.#chosen < 0) this.tell("this is the body: it is in no other part");
  }

  #place(places: boolean): void {
    if (places === this.#places) return;
    this.#places = places;
    this.#find("#parts-point").setAttribute("aria-pressed", String(places));
    this.workbench.canvas.style.cursor = places ? "crosshair" : "";
    if (places) this.tell("click on the car where the point is");
  }

  #addPoint(hit: Hit | null): void {
    if (!hit) return this.tell("there is nothing of the car: a point lies on its surface", true);
    this.#place(false);
    this.#chosen = this.#entries.length;
    const position = pointOf(hit.at), { x, y, z } = position;
    this.#history.become([...this.#entries, { name: this.#freeName("point"), kind: "point", position }]);
    this.tell(`a point at x ${x}, y ${y}, z ${z} m; give it a name`);
    this.#find<HTMLInputElement>("#parts-name").select();
  }

  #freeName(wanted: string): string {
    for (let name = wanted, count = 2; ; name = `${wanted} ${count++}`) if (!this.#entries.some((entry) => entry.name === name)) return name;
  }

  // ---- the entries ----

  #choose(entry: number): void {
    this.#chosen = entry;
    this.#show();
    this.#find(`#parts-list [aria-pressed="true"]`)?.scrollIntoView({ block: "nearest" });
  }

  #change(change: Partial<Entry>): void {
    if (this.#entries[this.#chosen]) this.#history.become(this.#entries.map((entry, i) => (i === this.#chosen ? { ...entry, ...change } : entry)));
  }

  #rename(): void {
    const name = this.#find<HTMLInputElement>("#parts-name").value.trim();
    const taken = name === body || this.#entries.some((entry, i) => i !== this.#chosen && entry.name === name);
    if (/^[ -~]+$/.test(name) && !taken) return this.#change({ name });
    this.tell(taken ? `there is a part "${name}" already` : `a part needs a name of 1 to ${nameLimit} letters, digits and signs of ASCII`, true);
    this.#show();
  }

  #save(): void {
    const unknown = firstUnknown(this.#entries, this.#baked);
    if (unknown < 0) {
      download("parts.json", writeEntries(this.#entries, this.#baked), "application/json");
      return this.tell(`now bake your file again, with the options that you gave then: ${command}`);
    }
    this.#choose(unknown);
    const { name } = this.#entries[unknown];
    this.tell(`the car does not say which names "${name}" has in your file: type them, or load the file that bake --write-parts wrote`, true);
    const source = this.#find("#parts-source");
    source.focus({ preventScroll: true });
    source.scrollIntoView({ block: "center" }); // the answer covers what is below
  }

  #load(text: string, file: string): void {
    try {
      const entries = readEntries(text, this.#baked), missing = entries.filter(({ name, of }) => name !== body && !of);
      this.#chosen = -1;
      this.#history.become(entries);
      this.tell(`${file}: ${entries.length} parts${missing.length ? `; not in this car yet: ${missing.map(({ name }) => name).join(", ")}` : ""}`);
    } catch (error) {
      this.tell(`${file} is not a parts file in strict JSON: ${sentence(error)}`, true);
    }
  }

  // ---- what the page shows ----

  #changed(): void {
    const rows = this.#entries.map(({ name, kind }, i) => {
      const row = document.createElement("li"), button = row.appendChild(document.createElement("button"));
      button.innerHTML = `<i style="background: #${colourOf(i).getHexString()}"></i><span></span><small>${kind}</small>`;
      button.querySelector("span")!.textContent = name;
      button.dataset.entry = `${i}`;
      button.onclick = () => this.#choose(i);
      button.onpointerenter = button.onfocus = () => this.#light(i);
      button.onpointerleave = button.onblur = () => this.#light(-1);
      row.hidden = name === body;
      return row;
    });
    this.#find("#parts-list").replaceChildren(...rows);
    this.#find("#parts-none").hidden = rows.some(({ hidden }) => !hidden);
    this.#find<HTMLButtonElement>("#parts-undo").disabled = !this.#history.past;
    this.#find<HTMLButtonElement>("#parts-redo").disabled = !this.#history.future;
    this.#under = -1;
    this.#show();
  }

  #light(entry: number): void {
    this.#under = entry;
    this.#show();
  }

  #show(): void {
    if (!this.#standIn) return;
    const entry = this.#entries[this.#chosen];
    if (!entry || entry.name === body) this.#chosen = -1;
    for (const button of this.root.querySelectorAll<HTMLElement>("#parts-list button"))
      button.setAttribute("aria-pressed", String(button.dataset.entry === `${this.#chosen}`));
    this.#find("#parts-edit").hidden = this.#chosen < 0;
    this.#find<HTMLButtonElement>("#parts-remove").disabled = this.#chosen < 0;
    if (entry) {
      this.#find<HTMLInputElement>("#parts-name").value = entry.name;
      this.#find<HTMLSelectElement>("#parts-kind").value = entry.kind;
      this.#find<HTMLTextAreaElement>("#parts-source").value = (entry.source ?? []).join("\n");
      this.#find("#parts-of").hidden = entry.kind === "point" || (entry.kind === "wheel" && !!entry.radius);
    }
    this.#draw(this.#under < 0 ? this.#chosen : this.#under);
  }

  // lit: the entry in full colour, while others are paler; none: all are.
  #draw(lit: number): void {
    const { mesh, group } = this.#standIn!, baked = this.#baked, colours = Array.from({ length: Math.max(2, baked.parts.length) }, () => bare);
    const shade = (i: number) => (lit < 0 || i === lit ? colourOf(i) : colourOf(i).clone().lerp(bare, 0.75));
    this.#entries.forEach((entry, i) => entry.of && hasSurface(entry) && (colours[entry.of] = shade(i)));
    mesh.paint(colours, colours.length - 1, Float32Array.from(mesh.moved, (_, v) => baked.vertexPart[v] ?? 0));
    for (const mark of this.#marks) {
      mark.removeFromParent();
      mark.geometry.dispose();
      mark.material.dispose();
    }
    const marks: Mark[] = (this.#marks = []);
    const add = (entry: number, isPoint: boolean, geometry: THREE.BufferGeometry, opacity: number) => {
      const mark = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial({ color: colourOf(entry), depthTest: false, transparent: true, opacity, side: THREE.DoubleSide }));
      Object.assign(mark.userData, { entry, isPoint });
      marks.push(mark);
    };
    this.#entries.forEach(({ kind, position }, i) => {
      if (kind !== "point" || !position) return;
      const { x, y, z } = position, radius = i === lit ? 1.6 * sizeOfPoint : sizeOfPoint;
      add(i, true, new THREE.SphereGeometry(radius, 24, 12).translate(x, y, z), lit < 0 || i === lit ? 1 : 0.4);
    });
    const entry = this.#entries[lit];
    if (entry?.of && hasSurface(entry)) add(lit, false, surfaceOf(baked, entry.of), 0.55);
    if (marks.length) group.add(...marks);
    this.workbench.wake();
  }
}

// Those of regions, and more, because a car has up to 255 parts; black is for tyres only.
function colourOf(entry: number): THREE.Color {
  return entry < palette.length - 1 ? palette[entry] : new THREE.Color().setHSL((0.618034 * entry) % 1, 0.6, 0.35 + 0.1 * (entry % 3));
}

/** The triangles of a part. */
function surfaceOf(baked: BakedCar, part: number): THREE.BufferGeometry {
  const corner: number[] = [];
  baked.triangle.forEach((v) => baked.vertexPart[v] === part && corner.push(v));
  return new THREE.BufferGeometry().setAttribute("position", new THREE.BufferAttribute(baked.vertex, 3)).setIndex(corner);
}

