// The panel's tools where the gateway takes commands: tune and paint, for one car of the scene.
import type * as THREE from "three";
import type { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { Control } from "./control.js";
import { Paint } from "./paint.js";
import type { LiveCar } from "./scene.js";
import type { CarMesh } from "./three.js";
import { Tune } from "./tune.js";

/** A car as the page shows it. */
export interface Shown {
  car: LiveCar;
  group: THREE.Group;
  mesh: CarMesh | null;
}

/** What the page lends its tools. */
export interface Stage {
  canvas: HTMLCanvasElement;
  camera: THREE.PerspectiveCamera;
  controls: OrbitControls;
  /** By id; none while a recording is shown. */
  cars(): Map<string, Shown>;
  followed(): string;
  wake(): void;
}

export interface Tools {
  /** With every picture. */
  update(): void;
  paint: Paint;
}

/** null: this gateway only shows. */
export async function startTools(root: HTMLElement, stage: Stage): Promise<Tools | null> {
  const control = await Control.find(location.href);
  if (!control) return null;
  root.innerHTML = `<label class="row">Car <select id="tool-car"></select></label><p id="tool-answer" role="status"></p>`;
  const choice = root.querySelector<HTMLSelectElement>("#tool-car")!, answer = root.querySelector<HTMLElement>("#tool-answer")!;
  const tell = (text: string, bad = false) => {
    answer.textContent = text;
    answer.className = bad ? "bad" : "";
    stage.wake();
  };
  const chosen = () => stage.cars().get(choice.value) ?? null;
  const tune = new Tune(control, chosen, tell), paint = new Paint(control, stage, chosen, tell);
  root.append(tune.root, paint.root, answer);
  let ids = "", followed = "";
  const update = () => {
    const now = [...stage.cars().keys()].join(" ");
    if (now !== ids) {
      const before = choice.value;
      choice.replaceChildren(...now.split(" ").filter(Boolean).map((id) => new Option(id, id)));
      if (stage.cars().has(before)) choice.value = before;
      ids = now;
      root.hidden = !now && !before;
    }
    if (stage.followed() !== followed) {
      followed = stage.followed();
      if (stage.cars().has(followed)) choice.value = followed;
    }
    tune.update();
    paint.update();
  };
  return { update, paint };
}

/** Bytes or text as a file of the user's. */
export function download(name: string, data: BlobPart, type: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([data], { type }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
}

/** Asks for a file and gives its text. */
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
