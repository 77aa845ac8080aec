// The tools of the panel, if the gateway takes commands: tune, paint and parts, for one car of the scene.
import { Control } from "../control.js";
import { Paint } from "./paint.js";
import { Parts } from "./parts.js";
import { Tune } from "./tune.js";
import type { Workbench } from "./workbench.js";

export interface Tools {
  /** The page calls this with every picture. */
  update(): void;
  paint: Paint;
  parts: Parts;
}

/** null: this gateway takes no commands. */
export async function startTools(root: HTMLElement, workbench: Workbench): Promise<Tools | null> {
  const control = await Control.find(location.href);
  if (!control) return null;
  root.innerHTML = `<label class="row">Car <select id="tool-car"></select></label><p id="tool-answer" role="status"></p>`;
  const choice = root.querySelector<HTMLSelectElement>("#tool-car")!, answer = root.querySelector<HTMLElement>("#tool-answer")!;
  const tell = (text: string, bad = false) => {
    answer.textContent = text;
    answer.className = bad ? "bad" : "";
    workbench.wake();
  };
  const chosen = () => workbench.cars().get(choice.value) ?? null;
  const tune = new Tune(control, chosen, tell), paint = new Paint(control, workbench, chosen, tell), parts = new Parts(workbench, chosen, tell);
  paint.root.name = parts.root.name = "undamaged"; // the browser closes one when the other opens: both show the car in their colours
  root.append(tune.root, paint.root, parts.root, answer);
  let ids = "", followed = "";
  const update = () => {
    const now = [...workbench.cars().keys()].join(" ");
    if (now !== ids) {
      const before = choice.value;
      choice.replaceChildren(...now.split(" ").filter(Boolean).map((id) => new Option(id, id)));
      if (workbench.cars().has(before)) choice.value = before;
      ids = now;
      root.hidden = !now && !before;
    }
    if (workbench.followed() !== followed) {
      followed = workbench.followed();
      if (workbench.cars().has(followed)) choice.value = followed;
    }
    tune.update();
    paint.update();
    parts.update();
  };
  return { update, paint, parts };
}
