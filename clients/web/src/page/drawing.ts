// Has what the page needs for every picture: three's renderer, the light, the ground, the camera and what turns it.
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { RoomEnvironment } from "three/addons/environments/RoomEnvironment.js";

const horizon = new THREE.Color("#dfe4e8");
const sight = 110; // m: fog hides everything beyond, so the camera leaves it out
const sunFrom = new THREE.Vector3(-9, -12, 18);
const upright = new THREE.Quaternion().setFromUnitVectors(new THREE.Vector3(0, 0, 1), new THREE.Vector3(0, 1, 0));

export class Drawing {
  readonly renderer: THREE.WebGLRenderer;
  readonly scene: THREE.Scene;
  readonly camera: THREE.PerspectiveCamera;
  readonly controls: OrbitControls;
  readonly sun: THREE.DirectionalLight;

  constructor(readonly canvas: HTMLCanvasElement) {
    THREE.Object3D.DEFAULT_UP.set(0, 0, 1); // before the first object is made
    this.renderer = makeRenderer(canvas);
    this.scene = makeScene(this.renderer);
    this.camera = new THREE.PerspectiveCamera(32, 1, 0.3, sight);
    this.controls = makeControls(this.camera, canvas);
    this.sun = makeSun();
    this.scene.add(this.sun, this.sun.target, makeGround());
  }

  /** Moves the sun along with what the camera looks at. */
  light(): void {
    const { sun, controls } = this;
    sun.target.position.copy(controls.target);
    sun.position.copy(controls.target).add(sunFrom);
    sun.target.updateMatrixWorld();
    sun.updateMatrixWorld();
  }

  /** Looks from ahead, the right and above, so that the sphere takes no more than this share of the height. */
  look(center: THREE.Vector3, radius: number, share: number): void {
    const { camera, controls } = this, distance = (1.18 * radius) / Math.tan((camera.fov * Math.PI) / 360) / share;
    controls.target.copy(center);
    camera.position.copy(center).addScaledVector(new THREE.Vector3(0.62, -0.86, 0.42).normalize(), Math.min(distance, 80));
    camera.lookAt(center);
    camera.updateMatrixWorld();
  }

  /** Turns the camera by azimuth and polar, rad, and multiplies its distance by nearer. */
  turn(azimuth: number, polar: number, nearer: number): void {
    const { camera, controls } = this, away = camera.position.clone().sub(controls.target).applyQuaternion(upright);
    const spherical = new THREE.Spherical().setFromVector3(away);
    spherical.theta += azimuth;
    spherical.phi = Math.min(Math.max(spherical.phi + polar, 0.05), controls.maxPolarAngle);
    spherical.radius = Math.min(Math.max(spherical.radius * nearer, controls.minDistance), controls.maxDistance);
    camera.position.copy(controls.target).add(away.setFromSpherical(spherical).applyQuaternion(upright.clone().invert()));
  }
}

function makeRenderer(canvas: HTMLCanvasElement): THREE.WebGLRenderer {
  const renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
  renderer.toneMapping = THREE.NeutralToneMapping;
  renderer.toneMappingExposure = 1.05;
  renderer.shadowMap.enabled = true;
  renderer.shadowMap.type = THREE.PCFShadowMap;
  return renderer;
}

function makeScene(renderer: THREE.WebGLRenderer): THREE.Scene {
  const scene = new THREE.Scene();
  scene.background = horizon;
  scene.fog = new THREE.Fog(horizon, 35, sight);
  scene.environment = new THREE.PMREMGenerator(renderer).fromScene(new RoomEnvironment(), 0.03).texture;
  scene.environmentRotation.set(Math.PI / 2, 0, 0); // its up is y
  scene.environmentIntensity = 0.55;
  return scene;
}

function makeControls(camera: THREE.Camera, canvas: HTMLCanvasElement): OrbitControls {
  const controls = new OrbitControls(camera, canvas);
  controls.enableDamping = true;
  controls.dampingFactor = 0.12;
  controls.maxPolarAngle = 0.495 * Math.PI; // the camera stays above the ground
  controls.minDistance = 2;
  controls.maxDistance = 90;
  return controls;
}

function makeSun(): THREE.DirectionalLight {
  const sun = new THREE.DirectionalLight("#fff6e8", 2.6);
  sun.castShadow = true;
  sun.shadow.mapSize.set(2048, 2048);
  Object.assign(sun.shadow.camera, { left: -11, right: 11, top: 11, bottom: -11, near: 1, far: 60 });
  sun.shadow.normalBias = 0.025;
  sun.shadow.radius = 3;
  return sun;
}

function makeGround(): THREE.Mesh {
  const ground = new THREE.Mesh(new THREE.PlaneGeometry(600, 600), new THREE.MeshLambertMaterial({ color: "#a7afb6", map: squares(600) }));
  ground.receiveShadow = true;
  return ground;
}

/** Makes a line every metre. As lines of three.js they would be jagged far away, and some drivers omit lines that end behind the eye. */
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
