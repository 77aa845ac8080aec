// Sliders for every parameter of a car and its regions, which act while they move. Names, ranges, units and defaults come from the
// server. The server does not say what others have set, so a slider shows what this page has set, or the default.
import type { Changes, Control, Parameter } from "../control.js";
import { download, pick, sentence, type Shown } from "./workbench.js";

/** ms without a change, after which the page sends the changes. */
const pause = 150;
/** Steps of a slider. If a range begins at 0, its slider goes this many decades below the default. */
const steps = 1000, decades = 3;

/** Converts a value to its place on the slider, 0 to 1, and back. Ranges of several decades are logarithmic, and begin with 0. */
class Scale {
  readonly #least: number;
  readonly #log: boolean;

  constructor(readonly of: Parameter) {
    this.#log = of.standard > 0 ? of.high / of.standard > 30 : false;
    this.#least = of.low > 0 ? of.low : of.standard * 10 ** -decades;
  }
  place(value: number): number {
    const { low, high } = this.of;
    if (!this.#log) return (value - low) / (high - low);
    return value <= this.#least ? 0 : Math.log(value / this.#least) / Math.log(high / this.#least);
  }
  value(place: number): number {
    const { low, high, whole } = this.of;
    if (place <= 0) return low;
    if (place >= 1) return high;
    const value = this.#log ? this.#least * (high / this.#least) ** place : low + place * (high - low);
    return whole ? Math.round(value) : Number(value.toPrecision(3));
  }
}

interface Row {
  of: Parameter;
  scale: Scale;
  slider: HTMLInputElement;
  number: HTMLInputElement;
}

export class Tune {
  readonly root = document.createElement("details");
  #rows: Row[] = [];
  #region: HTMLSelectElement;
  #solver: HTMLSelectElement;
  #shown = ""; // the car and the regions that the choice of regions has now
  #set = new Map<string, Map<number, Changes>>(); // by car and its life, by region
  #waiting: Changes = {};
  #moved: Shown | null = null; // the car that they are for
  #sent: Promise<unknown> = Promise.resolve(); // one after another, so that the last one counts
  #timer = 0;

  constructor(readonly control: Control, readonly chosen: () => Shown | null, readonly tell: (text: string, bad?: boolean) => void) {
    this.root.id = "tune";
    this.root.innerHTML = `<summary>Tune</summary>
      <label class="row">Region <select id="tune-region"></select></label>
      <div id="tune-of-region"></div>
      <h3>Of the whole car</h3>
      <label class="row">Solver <select id="tune-solver"><option>nodal</option><option>classic</option></select></label>
      <div id="tune-of-car"></div>
      <div class="buttons"><button id="tune-repair">Repair</button><button id="tune-save">Save preset</button><button id="tune-load">Load preset</button></div>
      <input id="tune-file" type="file" accept=".json" hidden>`;
    this.#region = this.#find("#tune-region");
    this.#solver = this.#find("#tune-solver");
    for (const of of control.parameters) this.#rows.push(this.#addRow(of));
    this.#region.onchange = () => this.#show();
    this.#solver.onchange = () => this.#change({ solver: this.#solver.value });
    this.#find<HTMLButtonElement>("#tune-repair").onclick = () => void this.#repair();
    this.#find<HTMLButtonElement>("#tune-save").onclick = () => this.#save();
    this.#find<HTMLButtonElement>("#tune-load").onclick = () => pick(this.#find("#tune-file"), (text, name) => void this.#load(text, name));
    this.#show();
  }

  update(): void {
    const shown = this.chosen(), regions = shown?.car.baked?.regions ?? [];
    const now = shown ? `${shown.car.id} ${shown.car.life} ${regions.join(" ")}` : "";
    if (now === this.#shown) return;
    this.#flush();
    this.#shown = now;
    this.#region.replaceChildren(new Option("all", "-1"), ...regions.map((name, i) => new Option(name, `${i}`)));
    this.#show();
  }

  #find<T extends HTMLElement>(what: string): T {
    return this.root.querySelector<T>(what)!;
  }

  #addRow(of: Parameter): Row {
    const scale = new Scale(of), row = document.createElement("div"), name = of.name.replaceAll("_", " ");
    const range = `${text(of.low)} to ${text(of.high)}${of.unit ? ` ${of.unit}` : ""}`;
    row.className = "slider";
    row.innerHTML = `<label for="tune-${of.name}">${name}</label><input class="number" type="number" step="any" aria-label="${name}, number">
      <input id="tune-${of.name}" type="range" min="0" max="${steps}" step="1"><small>${range}, default ${text(of.standard)}</small>`;
    const [number, slider] = row.querySelectorAll("input");
    slider.oninput = () => {
      const value = scale.value(Number(slider.value) / steps);
      number.value = text(value);
      slider.setAttribute("aria-valuetext", `${text(value)} ${of.unit}`);
      this.#change({ [of.name]: value });
    };
    number.onchange = () => {
      if (number.value === "") return this.#show();
      slider.value = `${steps * scale.place(Number(number.value))}`;
      this.#change({ [of.name]: Number(number.value) });
    };
    this.#find(of.ofRegion ? "#tune-of-region" : "#tune-of-car").append(row);
    return { of, scale, slider, number };
  }

  get #region_(): number {
    return Number(this.#region.value || -1);
  }

  #setOf(shown: Shown): Map<number, Changes> {
    const key = `${shown.car.id} ${shown.car.life}`;
    if (!this.#set.has(key)) this.#set.set(key, new Map());
    return this.#set.get(key)!;
  }

  #show(): void {
    const shown = this.chosen(), set = shown ? this.#setOf(shown) : new Map<number, Changes>();
    const value = (name: string, region: number) => set.get(region)?.[name] ?? set.get(-1)?.[name];
    for (const { of, scale, slider, number } of this.#rows) {
      const now = Number(value(of.name, of.ofRegion ? this.#region_ : -1) ?? of.standard);
      slider.value = `${steps * scale.place(now)}`;
      slider.setAttribute("aria-valuetext", `${text(now)} ${of.unit}`);
      number.value = text(now);
    }
    this.#solver.value = `${value("solver", -1) ?? "nodal"}`;
  }

  // Changes without a pause between them go as one command.
  #change(changes: Changes): void {
    const ofCar = Object.keys(changes).every((name) => name === "solver" || this.control.parameters.some((of) => of.name === name && !of.ofRegion));
    const region = ofCar ? -1 : this.#region_;
    if ((this.#waiting.region ?? region) !== region) this.#flush();
    this.#waiting = { ...this.#waiting, ...changes, region };
    this.#moved = this.chosen();
    clearTimeout(this.#timer);
    this.#timer = window.setTimeout(() => this.#flush(), pause);
  }

  #flush(): void {
    clearTimeout(this.#timer);
    const changes = this.#waiting, shown = this.#moved;
    this.#waiting = {};
    if (shown && changes.region !== undefined) this.#sent = this.#sent.then(() => this.#send(shown, changes));
  }

  async #send(shown: Shown, changes: Changes): Promise<boolean> {
    const { region = -1, ...values } = changes, set = this.#setOf(shown);
    const what = Object.entries(values).map(([name, value]) => `${name} ${typeof value === "number" ? text(value) : value}`).join(", ");
    try {
      await this.control.change(shown.car.id, changes);
    } catch (error) {
      this.tell(`refused: ${sentence(error)}`, true);
      this.#show();
      return false;
    }
    for (const [other, before] of set) if (region === -1 && other !== -1) for (const name of Object.keys(values)) delete before[name];
    set.set(region, { ...set.get(region), ...values });
    this.tell(`${shown.car.id}, ${region < 0 ? "all regions" : (shown.car.baked?.regions[region] ?? region)}: ${what}`);
    return true;
  }

  async #repair(): Promise<void> {
    const shown = this.chosen();
    if (!shown) return;
    try {
      await this.control.repair(shown.car.id);
      this.tell(`${shown.car.id} is repaired`);
    } catch (error) {
      this.tell(`refused: ${sentence(error)}`, true);
    }
  }

  // The entry of all regions comes first, because those of single regions lie over it.
  #save(): void {
    const shown = this.chosen();
    if (!shown) return;
    const parameters = [...this.#setOf(shown)].sort(([a], [b]) => a - b)
      .filter(([, changes]) => Object.keys(changes).length).map(([region, changes]) => (region < 0 ? changes : { region, ...changes }));
    if (!parameters.length) return this.tell("nothing was changed yet: move a slider first", true);
    download("preset.json", `${JSON.stringify({ about: `Tuned on ${shown.car.baked?.name ?? shown.car.id}.`, parameters }, null, 2)}\n`, "application/json");
  }

  async #load(file: string, name: string): Promise<void> {
    const shown = this.chosen();
    if (!shown) return;
    try {
      const { parameters } = JSON.parse(file) as { parameters?: Changes[] };
      if (!Array.isArray(parameters)) throw new Error('it has no list "parameters"');
      for (const changes of parameters) if (!(await this.#send(shown, changes))) return;
      this.tell(`${shown.car.id} has ${name}`);
    } catch (error) {
      this.tell(`${name} is not a preset: ${sentence(error)}`, true);
    }
    this.#show();
  }
}

function text(value: number): string {
  return value !== 0 && (Math.abs(value) >= 1e5 || Math.abs(value) < 1e-3) ? value.toExponential().replace("e+", "e") : `${value}`;
}
