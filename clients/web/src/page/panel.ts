// Says how the line is, what is known of each car and of the server, and what colours mean.
import { heat, heatMost, type Quantity } from "./colours.js";
import { element } from "./element.js";
import type { State } from "./state.js";

const round = (value: number, places = 0) => value.toFixed(places);

export function startPanel(state: State): void {
  const stops = heat.map((colour) => `#${colour.getHexString()}`).join(",");
  element("legend").querySelector("i")!.style.background = `linear-gradient(to right, ${stops})`;
  state.press("heat", () => colour(state, state.heatOf === null ? "dent" : state.heatOf === "dent" ? "strain" : null));
}

/** now: ms, by the clock of the scene that is shown. */
export function updatePanel(state: State, now: number): void {
  const { live, source, film, comparison, stages, first } = state;
  const age = (at: number) => (at ? `${round(Math.max(0, now - at) / 1000, 1)} s ago` : "never");
  const link = element("link");
  const says = source !== live ? (comparison ? "two recordings" : "recording") : live.link === "live" ? (live.server ? "live" : "no server of this scene") : live.link === "lost" ? "line lost, trying again" : "connecting";
  link.textContent = says + state.detail.says;
  link.className = source !== live || says === "live" ? "" : "lost";
  element("hint").textContent = film || says !== "live" || live.cars.size ? "" : state.hadCars ? "No car now" : "No car yet. Drive one: crumple drive clients/scenes/pole.json --car CAR";
  for (const item of first.cars.values()) {
    const { car } = item, [motion, told] = item.row.querySelectorAll("small");
    item.row.querySelector(".dent")!.textContent = item.mesh ? `${round(1000 * item.mesh.deepest)} mm` : "…";
    const bits = car.bitsPerVertex ? `, ${round(car.bitsPerVertex, 1)} bits a vertex and frame` : "";
    motion.textContent = `${round(3.6 * Math.hypot(...car.velocity))} km/h${car.peak ? `, hit: ${round(item.deceleration)} g, ${round(car.absorbed / 1000)} kJ` : ""}`;
    told.textContent = `told ${age(car.heardAt)}${bits}${car.refused ? `, ${car.refused} refused` : ""}`;
    item.row.setAttribute("aria-pressed", String(state.followed === car.id));
  }
  updateServer(state, age);
  element("comparison").hidden = !comparison;
  if (comparison) element("comparison").replaceChildren(...comparison.lines().map((line) => Object.assign(document.createElement("p"), { textContent: line })));
  updateLegend(state);
  const credits = new Set(stages.flatMap(({ cars }) => [...cars.values()]).map((item) => item.car.baked?.attribution).filter(Boolean));
  element("credits").textContent = [...credits, ...live.trouble.values()].join("; ");
}

function updateServer({ source }: State, age: (at: number) => string): void {
  const { health } = source, server = element("server");
  server.replaceChildren();
  if (!health) return;
  const add = <K extends keyof HTMLElementTagNameMap>(parent: HTMLElement, tag: K, text = "") => {
    const child = parent.appendChild(document.createElement(tag));
    child.textContent = text;
    return child;
  };
  const period = 1000 / health.rate;
  add(add(server, "h2", "Server"), "span", `${round(health.rate)} ticks a second`);
  add(server, "small", `tick ${health.tick}, ${health.late} late, told ${age(source.healthAt)}`);
  const table = add(server, "table");
  const row = (name: string, mean: string, worst: string) => {
    const cells = add(table, "tr"), first = add(cells, "td");
    add(cells, "td", mean);
    add(cells, "td", worst);
    const bar = add(first, "i");
    add(first, "span", name);
    return bar;
  };
  row("ms a tick", "mean", "worst");
  for (const room of [...health.rooms].sort((a, b) => b.mean - a.mean).slice(0, 8))
    row(room.name, round(room.mean, 2), round(room.worst, 2)).style.width = `${Math.min(100, (100 * room.mean) / period)}%`;
  const refused = health.refusals.reduce((sum, { value }) => sum + value, 0);
  if (refused) add(server, "small", `${refused} messages refused`);
}

/** null: cars have their own colours. */
export function colour(state: State, by: Quantity | null): void {
  state.heatOf = by;
  updateLegend(state);
}

function updateLegend({ heatOf, comparison }: State): void {
  const quantity = heatOf === "dent" && comparison ? "difference" : heatOf;
  element("heat").textContent = quantity ? `Colours: ${quantity}` : "Colours";
  element("heat").className = quantity ? "on" : "";
  element("legend").hidden = !quantity;
  element("quantity").textContent = quantity === "strain" ? "Strain of the surface" : quantity === "dent" ? "Dent" : "Difference";
  element("most").textContent = quantity === "strain" ? `${100 * heatMost.strain} %` : `${1000 * (comparison?.most ?? heatMost.dent)} mm`;
}
