// The page of `crumple view`: shows the scene of the gateway, or a recording that was dropped on it.
import { Live } from "../live.js";
import { Drawing } from "./drawing.js";
import { element } from "./element.js";
import { startKeys } from "./keys.js";
import { picture, startLoop } from "./loop.js";
import { startPanel } from "./panel.js";
import { startPlayer } from "./player.js";
import { State } from "./state.js";
import { startTools } from "./tools.js";
import { applyDetail, resize } from "./view.js";
import type { Workbench } from "./workbench.js";

const state = new State(new Live(location.href), new Drawing(element("canvas")));
const { live, drawing, first } = state, { canvas, camera, controls, renderer } = drawing;
startPanel(state);
startKeys(state);
startPlayer(state);

const workbench: Workbench = {
  canvas, camera, controls, wake: () => state.wake(), followed: () => state.followed,
  cars: () => (state.source === live && !state.comparison ? first.cars : new Map()),
};
void startTools(element("tools"), workbench).then((started) => {
  state.tools = started;
  state.wake();
});
controls.addEventListener("change", () => state.wake());
addEventListener("resize", () => resize(state));
new ResizeObserver(() => resize(state)).observe(element("panel"));
applyDetail(state);
startLoop(state);

// For tests and for whoever is curious at the console.
Object.assign(window, {
  crumple: { live, shown: first.cars, picture: () => picture(state), renderer, film: () => state.film, tools: () => state.tools, comparison: () => state.comparison },
});
