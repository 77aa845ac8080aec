// The page of `crumple view`: shows the scene of the gateway, or a recording that was dropped on it. Draws only while something changes.
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { RoomEnvironment } from "three/addons/environments/RoomEnvironment.js";
import { BothClocks, Comparison, halves, type Clock, type Rectangle } from "./compare.js";
import { Shape, type Pose } from "./decode.js";
import { Film } from "./film.js";
import { Live } from "./live.js";
import { Scene, type LiveCar } from "./scene.js";
import { CarMesh, obstacleGeometry } from "./three.js";
import { startTools, type Tools } from "./tools.js";

// Okabe and Ito's colours: told apart by the colour-blind too. Names say it as well.
const paints = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"];
// Lightness falls all the way, so that they are read in any colour vision.
const heat = ["#f1efe9", "#fac228", "#f57d15", "#d44842", "#9f2a63", "#65156e", "#280b53"].map((colour) => new THREE.Color(colour));
/** What colours may show of a car, and which value has the last of them. In a comparison the difference stands in place of the dent. */
type Quantity = "dent" | "strain";
const heatMost: Record<Quantity, number> = { dent: 0.5, strain: 0.5 }; // m, 1
const gravity = 9.81;
const arrowStays = 1500; // ms
const panelPeriod = 250; // ms: text that changes faster is not read

const element = <T extends HTMLElement>(id: string) => document.getElementById(id) as T;
const canvas = element<HTMLCanvasElement>("canvas");
const live = new Live(location.href);
let film: Film | null = null;
let source: Scene = live; // what is shown: one of the two
let comparison: Comparison | null = null; // of it and of what is beside it
const empty = new Scene();
let beside: Scene = empty;

// ---- the scene ----

THREE.Object3D.DEFAULT_UP.set(0, 0, 1);
const renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
renderer.toneMapping = THREE.NeutralToneMapping;
renderer.toneMappingExposure = 1.05;
renderer.shadowMap.enabled = true;
renderer.shadowMap.type = THREE.PCFShadowMap;
const scene = new THREE.Scene();
const horizon = new THREE.Color("#dfe4e8");
scene.background = horizon;
const sight = 110; // m: fog hides what is farther, so it is not drawn
scene.fog = new THREE.Fog(horizon, 35, sight);
const maker = new THREE.PMREMGenerator(renderer);
scene.environment = maker.fromScene(new RoomEnvironment(), 0.03).texture;
scene.environmentRotation.set(Math.PI / 2, 0, 0); // its up is y
scene.environmentIntensity = 0.55;

const camera = new THREE.PerspectiveCamera(32, 1, 0.3, sight);
const controls = new OrbitControls(camera, canvas);
controls.enableDamping = true;
controls.dampingFactor = 0.12;
controls.maxPolarAngle = 0.495 * Math.PI; // stays above the ground
controls.minDistance = 2;
controls.maxDistance = 90;

const sun = new THREE.DirectionalLight("#fff6e8", 2.6);
sun.castShadow = true;
sun.shadow.mapSize.set(2048, 2048);
Object.assign(sun.shadow.camera, { left: -11, right: 11, top: 11, bottom: -11, near: 1, far: 60 });
sun.shadow.normalBias = 0.025;
sun.shadow.radius = 3;
const sunFrom = new THREE.Vector3(-9, -12, 18);
scene.add(sun, sun.target);

const ground = new THREE.Mesh(new THREE.PlaneGeometry(600, 600), new THREE.MeshLambertMaterial({ color: "#a7afb6", map: squares(600) }));
ground.receiveShadow = true;
scene.add(ground);

/** A line every metre. As lines they would be jagged far away, and some drivers leave out those that end behind the eye. */
function squares(metres: number): THREE.Texture {
  const tile = document.createElement("canvas"), pen = tile.getContext("2d")!;
  tile.width = tile.height = 128;
  pen.fillStyle = "#ffffff";
  pen.fillRect(0, 0, 128, 128);
  pen.strokeStyle = "#d3d7db";
  pen.lineWidth = 3;
  pen.strokeRect(0, 0, 128, 128);
  const texture = new THREE.CanvasTexture(tile);
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.repeat.set(metres, metres);
  texture.anisotropy = 4;
  return texture;
}

function place(object: THREE.Object3D, pose: Pose): void {
  object.position.set(...pose.position);
  object.quaternion.set(...pose.orientation);
}

// ---- cars ----

/** What a view shows of its scene. */
class Stage {
  readonly group = new THREE.Group();
  readonly cars = new Map<string, ShownCar>();
  readonly obstacles = new Map<string, { list: unknown; group: THREE.Group }>(); // by host
  about: { center: THREE.Vector3; radius: number } | null = null;

  constructor(readonly source: () => Scene) {
    scene.add(this.group);
  }
}

class ShownCar {
  readonly group = new THREE.Group();
  readonly arrow = makeArrow();
  readonly label = document.createElement("div");
  readonly row = document.createElement("button");
  mesh: CarMesh | null = null;
  #version = -1;
  #painted = ""; // what, and of which version
  #extent = new THREE.Box3();

  constructor(readonly car: LiveCar, readonly colour: string, readonly stage: Stage) {
    for (const item of [this.label, this.row]) item.style.setProperty("--paint", colour);
    this.label.className = "label";
    this.label.textContent = car.id;
    this.row.innerHTML = `<span class="dent"></span><span class="name"></span><small></small><small></small>`;
    this.row.querySelector(".name")!.textContent = car.id;
    this.row.onclick = () => follow(car.id);
    element("labels").append(this.label);
    if (stage === first) element("cars").append(this.row);
    stage.group.add(this.group, this.arrow);
    this.group.visible = false;
  }

  remove(): void {
    this.stage.group.remove(this.group, this.arrow);
    this.#undress();
    release(this.arrow);
    this.label.remove();
    this.row.remove();
  }

  #undress(): void {
    this.mesh?.removeFromParent();
    this.mesh?.geometry.dispose();
    this.mesh?.material.dispose();
  }

  update(now: number): void {
    const { car } = this;
    if (car.baked && this.mesh?.baked !== car.baked) {
      this.#undress();
      this.#version = -1;
      this.#painted = "";
      const material = new THREE.MeshStandardMaterial({ color: this.colour, roughness: 0.3, metalness: 0.25, side: THREE.DoubleSide });
      this.mesh = new CarMesh(car.baked, material);
      this.#extent.setFromBufferAttribute(new THREE.BufferAttribute(car.baked.vertex, 3));
      this.group.add(this.mesh);
    }
    if (!this.mesh) return;
    if (this.#version !== car.version && this.mesh.update(car.surface)) this.#version = car.version;
    this.#paint(this.mesh);
    // Whoever is told no pose stands at the origin, as it was spawned there more often than anywhere else.
    if (car.pose) place(this.group, car.pose);
    this.group.visible = true;
    this.#point(now);
  }

  #paint(mesh: CarMesh): void {
    const material = mesh.material as THREE.MeshStandardMaterial, heated = heatOf === "strain" || (heatOf === "dent" && (!comparison || comparison.has(this)));
    if (material.vertexColors !== heated) {
      material.vertexColors = heated;
      material.color.set(heated ? "#ffffff" : this.colour);
      material.roughness = heated ? 0.7 : 0.3;
      material.needsUpdate = true;
    }
    const wanted = !heated ? "" : comparison && heatOf === "dent" ? "difference" : `${heatOf} ${this.#version}`;
    if (this.#painted === wanted) return;
    this.#painted = wanted;
    if (heatOf === "dent" && !comparison) mesh.paint(heat, heatMost.dent);
    if (heatOf === "strain") mesh.paint(heat, heatMost.strain, mesh.strain());
  }

  // The greatest impulse of the last hit, as the deceleration that it was: 4 cm for each g.
  #point(now: number): void {
    const { peak, peakAt } = this.car, fade = peak ? 1 - (now - peakAt) / arrowStays : 0;
    this.arrow.visible = fade > 0;
    if (!peak || fade <= 0) return;
    const impulse = new THREE.Vector3(...peak.impulse), g = this.deceleration;
    if (!(g > 0.5)) return void (this.arrow.visible = false);
    const length = Math.min(0.5 + 0.04 * g, 4), along = impulse.normalize();
    this.arrow.quaternion.setFromUnitVectors(new THREE.Vector3(0, 0, 1), along);
    this.arrow.position.copy(this.center()).addScaledVector(along, -length);
    stretch(this.arrow, length, Math.min(1, 2 * fade));
  }

  /** Of that tick of the last hit, in g. */
  get deceleration(): number {
    const { peak, baked } = this.car, rate = this.stage.source().health?.rate || 60;
    return peak && baked ? (Math.hypot(...peak.impulse) * rate) / baked.mass / gravity : 0;
  }

  center(): THREE.Vector3 {
    return this.#extent.getCenter(new THREE.Vector3()).applyMatrix4(this.group.matrixWorld);
  }
  get radius(): number {
    return this.mesh ? this.#extent.getSize(new THREE.Vector3()).length() / 2 : 2.5;
  }
  top(): THREE.Vector3 {
    return this.center().add(new THREE.Vector3(0, 0, this.#extent.max.z - this.#extent.min.z));
  }
}

function makeArrow(): THREE.Group {
  const material = new THREE.MeshBasicMaterial({ color: "#111418", transparent: true, depthTest: false });
  const shaft = new THREE.Mesh(new THREE.CylinderGeometry(0.045, 0.045, 1, 16).rotateX(Math.PI / 2).translate(0, 0, 0.5), material);
  const head = new THREE.Mesh(new THREE.ConeGeometry(0.14, 0.36, 24).rotateX(Math.PI / 2).translate(0, 0, -0.18), material);
  const group = new THREE.Group().add(shaft, head);
  group.renderOrder = shaft.renderOrder = head.renderOrder = 10;
  group.visible = false;
  return group;
}

function stretch(arrow: THREE.Group, length: number, opacity: number): void {
  const [shaft, head] = arrow.children as THREE.Mesh<THREE.BufferGeometry, THREE.MeshBasicMaterial>[];
  shaft.scale.z = length - 0.36;
  head.position.z = length;
  shaft.material.opacity = opacity; // both have this one
}

const first = new Stage(() => source), second = new Stage(() => beside), stages = [first, second];
const shown = first.cars;
let hadCars = false;

// The first that no car has, or that the fewest have.
function freePaint(stage: Stage): string {
  const uses = (paint: string) => [...stage.cars.values()].filter(({ colour }) => colour === paint).length;
  return paints.reduce((best, paint) => (uses(paint) < uses(best) ? paint : best));
}

function updateCars(stage: Stage): void {
  const source = stage.source(), shown = stage.cars;
  for (const [id, item] of shown)
    if (source.cars.get(id) !== item.car) {
      item.remove();
      shown.delete(id);
    }
  for (const [id, car] of source.cars) {
    if (!shown.has(id)) shown.set(id, new ShownCar(car, freePaint(stage), stage));
    hadCars = true;
    shown.get(id)!.update(source.now());
  }
}

// ---- obstacles ----

const concrete = new THREE.MeshStandardMaterial({ color: "#b3aea4", roughness: 0.9 });
const steel = new THREE.MeshStandardMaterial({ color: "#4d5358", roughness: 0.45, metalness: 0.6 });
const ghost = new THREE.MeshBasicMaterial({ color: "#8c8778", transparent: true, opacity: 0.13, depthWrite: false });
const edge = new THREE.LineBasicMaterial({ color: "#5b5f63" });

/** Gives the graphics card's memory back; materials are shared. */
function release(group: THREE.Group): THREE.Group {
  group.traverse((object) => (object as THREE.Mesh).geometry?.dispose());
  return group;
}

function updateObstacles({ source: current, obstacles, group }: Stage): boolean {
  const source = current(), now = source.now();
  let moving = false;
  for (const [host, item] of obstacles)
    if (!source.obstacles.has(host)) {
      group.remove(release(item.group));
      obstacles.delete(host);
    }
  for (const [host, { list, at }] of source.obstacles) {
    let item = obstacles.get(host);
    if (item?.list !== list) {
      if (item) group.remove(release(item.group));
      item = { list, group: new THREE.Group() };
      obstacles.set(host, item);
      group.add(item.group);
      for (const obstacle of list) item.group.add(makeObstacle(obstacle));
    }
    list.forEach((obstacle, i) => {
      const { pose, velocity, angularVelocity } = obstacle, object = item.group.children[i], seconds = (now - at) / 1000;
      place(object, pose);
      const turn = new THREE.Vector3(...angularVelocity);
      if (velocity.every((v) => v === 0) && turn.lengthSq() === 0) return;
      moving = true;
      object.position.addScaledVector(new THREE.Vector3(...velocity), seconds);
      const angle = turn.length() * seconds;
      object.quaternion.premultiply(new THREE.Quaternion().setFromAxisAngle(turn.normalize(), angle));
    });
  }
  return moving;
}

function makeObstacle(obstacle: Parameters<typeof obstacleGeometry>[0]): THREE.Object3D {
  const geometry = obstacleGeometry(obstacle);
  if (!geometry) {
    if (obstacle.shape !== Shape.half_space) return new THREE.Group();
    const plane = new THREE.GridHelper(40, 40, "#5b5f63", "#8b9096"); // its solid side is z <= 0
    plane.geometry.rotateX(Math.PI / 2);
    return plane;
  }
  const mesh = new THREE.Mesh(geometry, obstacle.shape === Shape.box || obstacle.shape === Shape.hull ? concrete : steel);
  mesh.castShadow = mesh.receiveShadow = true;
  if (mesh.material === concrete) mesh.add(new THREE.LineSegments(new THREE.EdgesGeometry(geometry, 20), edge));
  mesh.userData.solid = mesh.material;
  return mesh;
}

// What stands between the eye and a car is seen through.
const ray = new THREE.Raycaster();
function seeThrough({ obstacles, cars }: Stage): void {
  const meshes = [...obstacles.values()].flatMap(({ group }) => group.children).filter((object) => object instanceof THREE.Mesh);
  for (const mesh of meshes) mesh.material = mesh.userData.solid;
  for (const { mesh, center } of [...cars.values()].map((item) => ({ mesh: item.mesh, center: item.center() }))) {
    if (!mesh) continue;
    ray.set(camera.position, center.clone().sub(camera.position).normalize());
    ray.far = center.distanceTo(camera.position);
    for (const { object } of ray.intersectObjects(meshes, false)) (object as THREE.Mesh).material = ghost;
  }
  for (const mesh of meshes) mesh.castShadow = mesh.material !== ghost;
}

// ---- the view ----

let followed = ""; // a car's id; "": what moves
let heatOf: Quantity | null = null;
let framed = false; // the first car was put in the middle

function follow(id: string): void {
  followed = id;
  framed = false;
  wake();
}

/** What the view is about: its middle, and the radius of what should be seen; null: nothing new. */
function subject(stage: Stage): Stage["about"] {
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

// From ahead, the right and above, so that the sphere takes no more than this share of the height.
function look(center: THREE.Vector3, radius: number, share: number): void {
  const distance = (1.18 * radius) / Math.tan((camera.fov * Math.PI) / 360) / share;
  controls.target.copy(center);
  camera.position.copy(center).addScaledVector(new THREE.Vector3(0.62, -0.86, 0.42).normalize(), Math.min(distance, 80));
  camera.lookAt(center);
  camera.updateMatrixWorld();
}

function light(): void {
  sun.target.position.copy(controls.target);
  sun.position.copy(controls.target).add(sunFrom);
  sun.target.updateMatrixWorld();
  sun.updateMatrixWorld();
}

// Goes along with it: turning and nearing stay the user's.
function updateView(seconds: number): boolean {
  for (const stage of stages) stage.about = subject(stage) ?? stage.about; // also when it stands before the view has come there
  const { about } = first;
  if (!about) return false;
  const step = about.center.clone().sub(controls.target);
  if (!framed) {
    const { width, height } = views?.[0] ?? free();
    look(about.center, about.radius, Math.min(width, height) / (views ? height : innerHeight));
    framed = true;
    return true;
  }
  if (step.length() < 0.002) return false;
  if (step.length() < 8) step.multiplyScalar(1 - Math.exp(-6 * seconds)); // farther: it was put there
  controls.target.add(step);
  camera.position.add(step);
  return true;
}

/** The part of the window that the panel leaves. */
function free(): Rectangle {
  const panel = element("panel").getBoundingClientRect();
  if (innerWidth > 720) return { left: 0, top: 0, width: panel.left, height: innerHeight };
  const top = comparison ? element("player").getBoundingClientRect().bottom : 0;
  return { left: 0, top, width: innerWidth, height: Math.max(panel.top - top, 1) };
}

let views: Rectangle[] | null = null; // while there are two
function resize(): void {
  const { width, height } = free();
  renderer.setSize(innerWidth, innerHeight, false);
  views = comparison && showNames(halves(free()));
  camera.aspect = views ? views[0].width / views[0].height : innerWidth / innerHeight;
  // The middle of the picture is the middle of what is free.
  if (views) camera.clearViewOffset();
  else camera.setViewOffset(innerWidth, innerHeight, (innerWidth - width) / 2, (innerHeight - height) / 2, innerWidth, innerHeight);
  camera.updateProjectionMatrix();
  wake();
}

function updateLabels({ cars }: Stage, { left, top, width, height }: Rectangle): void {
  for (const item of cars.values()) {
    const at = item.top().project(camera), seen = item.group.visible && at.z < 1 && (!views || Math.max(Math.abs(at.x), Math.abs(at.y)) < 1);
    item.label.hidden = !seen;
    const x = left + ((at.x + 1) / 2) * width, y = top + ((1 - at.y) / 2) * height;
    item.label.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px) translate(-50%, -100%)`;
  }
}

// ---- how much is drawn ----

/** From all to what a processor can draw, with what is said of it; pixels: a side, as a share. */
const details = [
  { shadows: true, pixels: 1, says: "" },
  { shadows: false, pixels: 0.7, says: ", drawn without shadows" },
  { shadows: false, pixels: 0.4, says: ", drawn coarsely" },
];
const slowest = 40; // ms a frame, as a mean of
const enough = 1000; // ms
let detail = 0, inFull = false, frames = 0, since = 0, slow = 0;

function drawWith(index: number): void {
  detail = index;
  slow = 0;
  sun.castShadow = details[detail].shadows;
  renderer.setPixelRatio(details[detail].pixels * Math.min(devicePixelRatio, 2));
  resize();
}

// ---- the panel ----

const round = (value: number, places = 0) => value.toFixed(places);

function updatePanel(now: number): void {
  const age = (at: number) => (at ? `${round(Math.max(0, now - at) / 1000, 1)} s ago` : "never");
  const link = element("link");
  const state = source !== live ? (comparison ? "two recordings" : "recording") : live.link === "live" ? (live.server ? "live" : "no server of this scene") : live.link === "lost" ? "line lost, trying again" : "connecting";
  link.textContent = state + details[detail].says + (detail ? " to keep up (key F: in full)" : inFull ? ", drawn in full" : "");
  link.className = source !== live || state === "live" ? "" : "lost";
  element("hint").textContent = film || state !== "live" || live.cars.size ? "" : hadCars ? "No car now" : "No car yet. Drive one: crumple drive clients/scenes/pole.json --car CAR";
  for (const item of shown.values()) {
    const { car } = item, [first, second] = item.row.querySelectorAll("small");
    item.row.querySelector(".dent")!.textContent = item.mesh ? `${round(1000 * item.mesh.deepest)} mm` : "…";
    const bits = car.bitsPerVertex ? `, ${round(car.bitsPerVertex, 1)} bits a vertex and frame` : "";
    first.textContent = `${round(3.6 * Math.hypot(...car.velocity))} km/h${car.peak ? `, hit: ${round(item.deceleration)} g, ${round(car.absorbed / 1000)} kJ` : ""}`;
    second.textContent = `told ${age(car.heardAt)}${bits}${car.refused ? `, ${car.refused} refused` : ""}`;
    item.row.setAttribute("aria-pressed", String(followed === car.id));
  }
  updateServer(age);
  element("comparison").hidden = !comparison;
  if (comparison) element("comparison").replaceChildren(...comparison.lines().map((line) => Object.assign(document.createElement("p"), { textContent: line })));
  updateLegend();
  const credits = new Set(stages.flatMap(({ cars }) => [...cars.values()]).map((item) => item.car.baked?.attribution).filter(Boolean));
  element("credits").textContent = [...credits, ...live.trouble.values()].join("; ");
}

function updateServer(age: (at: number) => string): void {
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

// ---- keys and buttons ----

function press(id: string, action: () => void): void {
  element(id).onclick = () => {
    action();
    wake();
  };
}
press("heat", () => colour(heatOf === null ? "dent" : heatOf === "dent" ? "strain" : null));
function colour(by: Quantity | null): void {
  heatOf = by;
  updateLegend();
}
function updateLegend(): void {
  const quantity = heatOf === "dent" && comparison ? "difference" : heatOf;
  element("heat").textContent = quantity ? `Colours: ${quantity}` : "Colours";
  element("heat").className = quantity ? "on" : "";
  element("legend").hidden = !quantity;
  element("quantity").textContent = quantity === "strain" ? "Strain of the surface" : quantity === "dent" ? "Dent" : "Difference";
  element("most").textContent = quantity === "strain" ? `${100 * heatMost.strain} %` : `${1000 * (comparison?.most ?? heatMost.dent)} mm`;
}
press("all", () => follow(""));
press("fold", () => {
  const details = element("details");
  details.hidden = !details.hidden;
  element("fold").setAttribute("aria-expanded", String(!details.hidden));
  resize();
});
(element("legend").querySelector("i") as HTMLElement).style.background =
  `linear-gradient(to right, ${heat.map((colour) => `#${colour.getHexString()}`).join(",")})`;

const spherical = new THREE.Spherical(), upright = new THREE.Quaternion().setFromUnitVectors(new THREE.Vector3(0, 0, 1), new THREE.Vector3(0, 1, 0));
function turn(azimuth: number, polar: number, nearer: number): void {
  const away = camera.position.clone().sub(controls.target).applyQuaternion(upright);
  spherical.setFromVector3(away);
  spherical.theta += azimuth;
  spherical.phi = Math.min(Math.max(spherical.phi + polar, 0.05), controls.maxPolarAngle);
  spherical.radius = Math.min(Math.max(spherical.radius * nearer, controls.minDistance), controls.maxDistance);
  camera.position.copy(controls.target).add(away.setFromSpherical(spherical).applyQuaternion(upright.clone().invert()));
}
const keys: Record<string, () => void> = {
  ArrowLeft: () => turn(-0.1, 0, 1), ArrowRight: () => turn(0.1, 0, 1), ArrowUp: () => turn(0, -0.07, 1), ArrowDown: () => turn(0, 0.07, 1),
  "+": () => turn(0, 0, 0.88), "=": () => turn(0, 0, 0.88), "-": () => turn(0, 0, 1.13),
  " ": () => clock && element("play").click(), o: () => element("open").click(), b: () => current.length === 1 && element("beside").click(),
  c: () => element("heat").click(), p: () => element("fold").click(), "0": () => follow(""),
  f: () => {
    inFull = !inFull;
    drawWith(0);
  },
};
addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.altKey || event.metaKey || choice.open) return;
  if (event.target instanceof HTMLInputElement || event.target instanceof HTMLSelectElement || (event.key === " " && event.target instanceof HTMLButtonElement)) return;
  const car = /^[1-9]$/.test(event.key) ? [...shown.keys()][Number(event.key) - 1] : undefined;
  const action = car ? () => follow(car) : keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
  if (!action) return;
  event.preventDefault();
  action();
  wake();
});

// ---- recordings ----

const scrub = element<HTMLInputElement>("scrub"), speed = element<HTMLSelectElement>("speed"), file = element<HTMLInputElement>("file");
const choice = element<HTMLDialogElement>("choice");
let playing = false;
let clock: Clock | null = null; // of the recordings that are shown

interface Opened {
  name: string;
  film: Film;
}
let current: Opened[] = [];

/** Recordings, the first in place of the scene; or one, and beside it the scene as it is now. */
function show(opened: Opened[], withScene = false): void {
  const [one, two] = withScene ? [null, ...opened] : opened;
  film = opened[0]?.film ?? null;
  source = one?.film ?? live;
  beside = two?.film ?? empty;
  comparison = two ? new Comparison([one?.name ?? "the live scene", two.name], one && new BothClocks(one.film, two.film)) : null;
  clock = comparison?.clock ?? film;
  playing = clock !== null;
  for (const stage of stages) stage.about = null;
  if (two) colour("dent");
  element("player").hidden = !clock;
  element("name").textContent = opened.map(({ name }) => name).join(", ");
  element("names").hidden = !two;
  element("beside").setAttribute("aria-pressed", String(withScene));
  element("beside").hidden = opened.length !== 1;
  element("beside").onclick = () => {
    const went = playing;
    show(opened, !withScene);
    playing = went;
  };
  current = opened;
  follow("");
  resize();
}

function showNames(parts: Rectangle[]): Rectangle[] {
  element("names").replaceChildren(...parts.map(({ left, top }, i) => {
    const name = document.createElement("span");
    name.textContent = comparison!.names[i];
    name.style.transform = `translate(${left}px, ${top}px)`;
    return name;
  }));
  return parts;
}

async function open(files: Iterable<{ name: string; arrayBuffer(): Promise<ArrayBuffer> }>): Promise<void> {
  const opened: Opened[] = [];
  for (const recording of [...files].slice(0, 2))
    try {
      opened.push({ name: recording.name, film: Film.read(new Uint8Array(await recording.arrayBuffer())) });
    } catch (error) {
      element("hint").textContent = "";
      alert(`${recording.name} cannot be shown: ${error instanceof Error ? error.message : error}`);
    }
  if (opened.length === 1 && current.length) choose(current[0], opened[0]);
  else if (opened.length) show(opened);
}

function choose(before: Opened, next: Opened): void {
  element("both").textContent = `Compare with ${before.name}`;
  choice.querySelector("p")!.textContent = next.name;
  choice.returnValue = "";
  choice.onclose = () => choice.returnValue && show(choice.returnValue === "both" ? [before, next] : [next]);
  choice.showModal();
}

// At the end it stands.
function play(clock: Clock, seconds: number): void {
  if (playing) clock.seek(clock.time + seconds * Number(speed.value));
  if (clock.time >= clock.duration) playing = false;
  scrub.max = String(clock.duration);
  if (playing) scrub.value = String(clock.time);
  element("time").textContent = `${round(clock.time, 2)} of ${round(clock.duration, 2)} s`;
  const label = playing ? "Pause" : "Play";
  if (element("play").textContent !== label) element("play").textContent = label;
}

press("open", () => file.click());
file.onchange = () => {
  void open([...file.files!]);
  file.value = ""; // so that the same one can be chosen again
};
press("close", () => show([]));
press("play", () => {
  if (clock && clock.time >= clock.duration) clock.seek(0);
  playing = !playing;
});
scrub.oninput = () => {
  playing = false;
  clock?.seek(Number(scrub.value));
};
addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", (event) => {
  event.preventDefault();
  void open(event.dataTransfer?.files ?? []);
});
// Those that `crumple view A.mcap B.mcap` hands out.
void open(new URLSearchParams(location.search).getAll("recording").map((name, i) => ({
  name, arrayBuffer: async () => (await fetch(new URL(`recording/${i}`, location.href))).arrayBuffer(),
})));

// ---- the loop ----

let awakeUntil = 0, drawnAt = 0, calledAt = 0, version = -1, panelAt = 0;
function wake(): void {
  awakeUntil = performance.now() + 700; // as long as damping and arrows go on by themselves
}

// Without a graphics card a frame may take seconds. The mean over a while counts: a browser takes some frames at once, then none for long.
// Twice in a row, since once may be a file that was read.
function keepUp(now: number): void {
  ++frames;
  if (now - since < enough) return;
  slow = (now - since) / frames > slowest ? slow + 1 : 0;
  if (slow > 1 && !inFull && details[detail + 1]) drawWith(detail + 1);
  startCounting(now);
}
function startCounting(now: number): void {
  frames = 0;
  since = now;
}
document.addEventListener("visibilitychange", () => startCounting(performance.now())); // hidden it draws nothing

function frame(now: number): void {
  requestAnimationFrame(frame);
  if (clock) play(clock, Math.min(1, (now - calledAt) / 1000));
  calledAt = now;
  if (version !== source.version + beside.version) wake();
  version = source.version + beside.version;
  if (now - panelAt > panelPeriod) {
    panelAt = now;
    updatePanel(source.now());
  }
  if (now > awakeUntil) return startCounting(now);
  const period = now - drawnAt, seconds = Math.min(1, period / 1000);
  drawnAt = now;
  keepUp(now);
  for (const stage of stages) {
    updateCars(stage);
    if (updateObstacles(stage)) wake();
  }
  comparison?.update(first.cars, second.cars, heatOf === "dent" ? heat : null);
  tools?.update();
  scene.updateMatrixWorld();
  if (updateView(seconds)) wake();
  controls.update();
  light();
  camera.updateMatrixWorld();
  if (views) return views.forEach(drawPart);
  seeThrough(first);
  updateLabels(first, { left: 0, top: 0, width: innerWidth, height: innerHeight });
  renderer.render(scene, camera);
}

// One camera for both: what each is about is seen from the same side and as far away, wherever it is.
function drawPart(part: Rectangle, i: number): void {
  const stage = stages[i], { position } = camera, at = position.clone(), target = controls.target.clone();
  if (stage.about && first.about) for (const vector of [position, controls.target]) vector.add(stage.about.center).sub(first.about.center);
  camera.updateMatrixWorld();
  light();
  seeThrough(stage);
  updateLabels(stage, part);
  for (const { group } of stages) group.visible = group === stage.group;
  const place = [part.left, innerHeight - part.top - part.height, part.width, part.height] as const; // three counts from the bottom
  renderer.setViewport(...place);
  renderer.setScissor(...place);
  renderer.setScissorTest(true);
  renderer.render(scene, camera);
  renderer.setScissorTest(false);
  for (const { group } of stages) group.visible = true;
  position.copy(at);
  controls.target.copy(target);
}

let tools: Tools | null = null;
const workbench = { canvas, camera, controls, wake, followed: () => followed, cars: () => (source === live && !comparison ? shown : new Map<string, ShownCar>()) };
void startTools(element("tools"), workbench).then((started) => {
  tools = started;
  wake();
});
controls.addEventListener("change", wake);
addEventListener("resize", resize);
new ResizeObserver(resize).observe(element("panel"));
drawWith(0);
requestAnimationFrame(frame);

/** A small PNG, base64: the first car from where a page begins to look at it. */
function picture(): string {
  drawWith(0);
  camera.clearViewOffset();
  camera.aspect = 16 / 9;
  camera.updateProjectionMatrix();
  renderer.setPixelRatio(1);
  renderer.setSize(320, 180, false);
  const [item] = shown.values();
  item.update(Infinity);
  scene.updateMatrixWorld();
  look(item.center(), 0.7 * item.radius, 1);
  light();
  seeThrough(first);
  renderer.render(scene, camera);
  const [, png] = canvas.toDataURL().split(",");
  resize();
  return png;
}

// For tests and for whoever is curious at the console.
Object.assign(window, { crumple: { live, shown, picture, renderer, film: () => film, tools: () => tools, comparison: () => comparison } });
