// The loop brings up to date what the page shows, and draws it, but only while something changes.
import { heat } from "./colours.js";
import type { Rectangle } from "./compare.js";
import { updatePanel } from "./panel.js";
import { play } from "./player.js";
import type { State } from "./state.js";
import { applyDetail, resize, updateLabels, updateView } from "./view.js";

const panelPeriod = 250; // ms: nobody can read text that changes faster

export function startLoop(state: State): void {
  document.addEventListener("visibilitychange", () => state.detail.start(performance.now())); // a hidden page draws nothing
  const next = (now: number) => {
    requestAnimationFrame(next);
    frame(state, now);
  };
  requestAnimationFrame(next);
}

function frame(state: State, now: number): void {
  const { source, beside, drawing, stages, first, second } = state, { scene, camera } = drawing;
  if (state.clock) play(state, state.clock, Math.min(1, (now - state.calledAt) / 1000));
  state.calledAt = now;
  if (state.version !== source.version + beside.version) state.wake();
  state.version = source.version + beside.version;
  if (now - state.panelAt > panelPeriod) {
    state.panelAt = now;
    updatePanel(state, source.now());
  }
  if (now > state.awakeUntil) return state.detail.start(now);
  const seconds = Math.min(1, (now - state.drawnAt) / 1000);
  state.drawnAt = now;
  if (state.detail.count(now)) applyDetail(state);
  for (const stage of stages) {
    stage.updateCars();
    if (stage.cars.size) state.hadCars = true;
    if (stage.obstacles.update(stage.source())) state.wake();
  }
  state.comparison?.update(first.cars, second.cars, state.heatOf === "dent" ? heat : null);
  for (const stage of stages) stage.paintCars(state.heatOf, state.comparison);
  state.tools?.update();
  scene.updateMatrixWorld();
  if (updateView(state, seconds)) state.wake();
  drawing.controls.update();
  drawing.light();
  camera.updateMatrixWorld();
  if (state.views) return state.views.forEach((part, i) => drawPart(state, part, i));
  first.seeThrough(camera.position);
  updateLabels(state, first, { left: 0, top: 0, width: innerWidth, height: innerHeight });
  drawing.renderer.render(scene, camera);
}

// One camera draws both parts: it sees the subject of each from the same side and from as far away, wherever the subject is.
function drawPart(state: State, part: Rectangle, i: number): void {
  const { drawing, stages, first } = state, { renderer, scene, camera, controls } = drawing;
  const stage = stages[i], { position } = camera, at = position.clone(), target = controls.target.clone();
  if (stage.about && first.about) for (const vector of [position, controls.target]) vector.add(stage.about.center).sub(first.about.center);
  camera.updateMatrixWorld();
  drawing.light();
  stage.seeThrough(position);
  updateLabels(state, stage, part);
  for (const { group } of stages) group.visible = group === stage.group;
  const place = [part.left, innerHeight - part.top - part.height, part.width, part.height] as const; // three.js counts from the bottom
  renderer.setViewport(...place);
  renderer.setScissor(...place);
  renderer.setScissorTest(true);
  renderer.render(scene, camera);
  renderer.setScissorTest(false);
  for (const { group } of stages) group.visible = true;
  position.copy(at);
  controls.target.copy(target);
}

/** Gives a small PNG, base64: the first car from where a page begins to look at it. */
export function picture(state: State): string {
  const { drawing, detail, first } = state, { canvas, renderer, scene, camera } = drawing;
  detail.become(0);
  applyDetail(state);
  camera.clearViewOffset();
  camera.aspect = 16 / 9;
  camera.updateProjectionMatrix();
  renderer.setPixelRatio(1);
  renderer.setSize(320, 180, false);
  const [item] = first.cars.values();
  item.update(Infinity, first.model);
  item.paint(state.heatOf, state.comparison);
  scene.updateMatrixWorld();
  drawing.look(item.center(), 0.7 * item.radius, 1);
  drawing.light();
  first.seeThrough(camera.position);
  renderer.render(scene, camera);
  const [, png] = canvas.toDataURL().split(",");
  resize(state);
  return png;
}
