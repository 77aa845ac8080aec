// Opens recordings, shows them in place of the scene or beside it, and plays them from any moment. Opens models too.
import { Film } from "../film.js";
import { BothClocks, Comparison, type Clock } from "./compare.js";
import { element } from "./element.js";
import { isModel, openModel } from "./model.js";
import { colour } from "./panel.js";
import type { Opened, State } from "./state.js";
import { resize } from "./view.js";

/** Shows recordings, the first in place of the scene; or one recording, and the scene as it is now beside it. */
function show(state: State, opened: Opened[], withScene = false): void {
  const [one, two] = withScene ? [null, ...opened] : opened;
  state.opened = opened;
  state.source = one?.film ?? state.live;
  state.beside = two?.film ?? state.empty;
  state.comparison = two ? new Comparison([one?.name ?? "the live scene", two.name], one && new BothClocks(one.film, two.film)) : null;
  state.clock = state.comparison?.clock ?? state.film;
  state.playing = state.clock !== null;
  for (const stage of state.stages) stage.about = null;
  if (two) colour(state, "dent");
  element("player").hidden = !state.clock;
  element("name").textContent = opened.map(({ name }) => name).join(", ");
  element("names").hidden = !two;
  element("beside").setAttribute("aria-pressed", String(withScene));
  element("beside").hidden = opened.length !== 1;
  element("beside").onclick = () => {
    const went = state.playing;
    show(state, opened, !withScene);
    state.playing = went;
  };
  state.follow("");
  resize(state);
}

async function open(state: State, files: Iterable<{ name: string; arrayBuffer(): Promise<ArrayBuffer> }>): Promise<void> {
  const opened: Opened[] = [];
  for (const recording of [...files].slice(0, 2))
    try {
      if (isModel(recording.name)) await openModel(state, await recording.arrayBuffer());
      else opened.push({ name: recording.name, film: Film.read(new Uint8Array(await recording.arrayBuffer())) });
    } catch (error) {
      element("hint").textContent = "";
      alert(`${recording.name} cannot be shown: ${error instanceof Error ? error.message : error}`);
    }
  if (opened.length === 1 && state.opened.length) choose(state, state.opened[0], opened[0]);
  else if (opened.length) show(state, opened);
}

function choose(state: State, before: Opened, next: Opened): void {
  const choice = element<HTMLDialogElement>("choice");
  element("both").textContent = `Compare with ${before.name}`;
  choice.querySelector("p")!.textContent = next.name;
  choice.returnValue = "";
  choice.onclose = () => choice.returnValue && show(state, choice.returnValue === "both" ? [before, next] : [next]);
  choice.showModal();
}

/** Plays so many seconds more, and stops at the end. */
export function play(state: State, clock: Clock, seconds: number): void {
  const scrub = element<HTMLInputElement>("scrub"), label = element("play");
  if (state.playing) clock.seek(clock.time + seconds * Number(element<HTMLSelectElement>("speed").value));
  if (clock.time >= clock.duration) state.playing = false;
  scrub.max = String(clock.duration);
  if (state.playing) scrub.value = String(clock.time);
  element("time").textContent = `${clock.time.toFixed(2)} of ${clock.duration.toFixed(2)} s`;
  const says = state.playing ? "Pause" : "Play";
  if (label.textContent !== says) label.textContent = says;
}

export function startPlayer(state: State): void {
  const scrub = element<HTMLInputElement>("scrub"), file = element<HTMLInputElement>("file");
  state.press("open", () => file.click());
  file.onchange = () => {
    void open(state, [...file.files!]);
    file.value = ""; // so that the user can choose the same file again
  };
  state.press("close", () => show(state, []));
  state.press("play", () => {
    const { clock } = state;
    if (clock && clock.time >= clock.duration) clock.seek(0);
    state.playing = !state.playing;
  });
  scrub.oninput = () => {
    state.playing = false;
    state.clock?.seek(Number(scrub.value));
  };
  addEventListener("dragover", (event) => event.preventDefault());
  addEventListener("drop", (event) => {
    event.preventDefault();
    void open(state, event.dataTransfer?.files ?? []);
  });
  // Opens the recordings of `crumple view A.mcap B.mcap`.
  void open(state, new URLSearchParams(location.search).getAll("recording").map((name, i) => ({
    name, arrayBuffer: async () => (await fetch(new URL(`recording/${i}`, location.href))).arrayBuffer(),
  })));
}
