// Keys, and the buttons that move the view or fold the panel.
import { element } from "./element.js";
import type { State } from "./state.js";
import { applyDetail, resize } from "./view.js";

export function startKeys(state: State): void {
  const { drawing, detail } = state, turn = drawing.turn.bind(drawing), click = (id: string) => element(id).click();
  state.press("all", () => state.follow(""));
  state.press("fold", () => {
    const details = element("details");
    details.hidden = !details.hidden;
    element("fold").setAttribute("aria-expanded", String(!details.hidden));
    resize(state);
  });
  const keys: Record<string, () => void> = {
    ArrowLeft: () => turn(-0.1, 0, 1), ArrowRight: () => turn(0.1, 0, 1), ArrowUp: () => turn(0, -0.07, 1), ArrowDown: () => turn(0, 0.07, 1),
    "+": () => turn(0, 0, 0.88), "=": () => turn(0, 0, 0.88), "-": () => turn(0, 0, 1.13),
    " ": () => state.clock && click("play"), o: () => click("open"), b: () => state.opened.length === 1 && click("beside"),
    c: () => click("heat"), p: () => click("fold"), "0": () => state.follow(""),
    f: () => {
      detail.inFull = !detail.inFull;
      detail.become(0);
      applyDetail(state);
    },
  };
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey || element<HTMLDialogElement>("choice").open) return;
    if (event.target instanceof HTMLInputElement || event.target instanceof HTMLSelectElement || (event.key === " " && event.target instanceof HTMLButtonElement)) return;
    const car = /^[1-9]$/.test(event.key) ? [...state.first.cars.keys()][Number(event.key) - 1] : undefined;
    const action = car ? () => state.follow(car) : keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action();
    state.wake();
  });
}
