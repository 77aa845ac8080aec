// Decides what part of the scene the page shows, and where in the window. The camera goes along with cars; the views, one or two, lie
// beside the panel.
import * as THREE from "three";
import { halves, type Rectangle } from "./compare.js";
import { element } from "./element.js";
import type { ShownCar } from "./shown.js";
import type { Stage } from "./stage.js";
import type { State } from "./state.js";

/** Finds what the view is about: its middle, and the radius of what it should show; null: nothing new. */
function subject({ followed, framed }: State, stage: Stage): Stage["about"] {
  const all = [...stage.cars.values()].filter((item) => item.mesh), now = stage.source().now();
  const moving = ({ car }: ShownCar) => Math.hypot(...car.velocity) > 0.3 || now - car.hitAt < 3000;
  let cars = all.filter((item) => (followed ? item.car.id === followed : moving(item)));
  if (!cars.length && !framed) cars = all;
  if (!cars.length) return null;
  const box = new THREE.Box3();
  for (const item of cars) box.union(new THREE.Box3().setFromCenterAndSize(item.center(), new THREE.Vector3().setScalar(1.2 * item.radius)));
  const sphere = box.getBoundingSphere(new THREE.Sphere());
  return { center: sphere.center, radius: sphere.radius };
}

/** Moves the camera along with the subject; the user alone turns it and brings it nearer. True: the view has moved. */
export function updateView(state: State, seconds: number): boolean {
  const { drawing, stages, first, views } = state, { camera, controls } = drawing;
  for (const stage of stages) stage.about = subject(state, stage) ?? stage.about; // a car may stand before the view has come there
  const { about } = first;
  if (!about) return false;
  const step = about.center.clone().sub(controls.target);
  if (!state.framed) {
    const { width, height } = views?.[0] ?? free(state);
    drawing.look(about.center, about.radius, Math.min(width, height) / (views ? height : innerHeight));
    state.framed = true;
    return true;
  }
  if (step.length() < 0.002) return false;
  if (step.length() < 8) step.multiplyScalar(1 - Math.exp(-6 * seconds)); // a subject that is farther away has been put there
  controls.target.add(step);
  camera.position.add(step);
  return true;
}

/** Gives the part of the window that the panel leaves free. */
function free({ comparison }: State): Rectangle {
  const panel = element("panel").getBoundingClientRect();
  if (innerWidth > 720) return { left: 0, top: 0, width: panel.left, height: innerHeight };
  const top = comparison ? element("player").getBoundingClientRect().bottom : 0;
  return { left: 0, top, width: innerWidth, height: Math.max(panel.top - top, 1) };
}

export function resize(state: State): void {
  const { renderer, camera } = state.drawing, { comparison } = state, { width, height } = free(state);
  renderer.setSize(innerWidth, innerHeight, false);
  state.views = comparison && showNames(comparison.names, halves(free(state)));
  camera.aspect = state.views ? state.views[0].width / state.views[0].height : innerWidth / innerHeight;
  // The middle of the picture lies in the middle of the free part.
  if (state.views) camera.clearViewOffset();
  else camera.setViewOffset(innerWidth, innerHeight, (innerWidth - width) / 2, (innerHeight - height) / 2, innerWidth, innerHeight);
  camera.updateProjectionMatrix();
  state.wake();
}

function showNames(names: [string, string], parts: Rectangle[]): Rectangle[] {
  element("names").replaceChildren(...parts.map(({ left, top }, i) => {
    const name = document.createElement("span");
    name.textContent = names[i];
    name.style.transform = `translate(${left}px, ${top}px)`;
    return name;
  }));
  return parts;
}

/** Draws with as much detail as `state.detail` says. */
export function applyDetail(state: State): void {
  const { detail, drawing } = state;
  drawing.sun.castShadow = detail.shadows;
  drawing.renderer.setPixelRatio(detail.pixels * Math.min(devicePixelRatio, 2));
  resize(state);
}

export function updateLabels({ drawing, views }: State, { cars }: Stage, { left, top, width, height }: Rectangle): void {
  for (const item of cars.values()) {
    const at = item.top().project(drawing.camera), seen = item.group.visible && at.z < 1 && (!views || Math.max(Math.abs(at.x), Math.abs(at.y)) < 1);
    item.label.hidden = !seen;
    const x = left + ((at.x + 1) / 2) * width, y = top + ((1 - at.y) / 2) * height;
    item.label.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px) translate(-50%, -100%)`;
  }
}
