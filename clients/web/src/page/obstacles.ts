// The obstacles of a scene as the page shows them.
import * as THREE from "three";
import { Shape, type Obstacle } from "../decode.js";
import type { Scene } from "../scene.js";
import { obstacleGeometry } from "../three.js";
import { place, release } from "./objects.js";

const concrete = new THREE.MeshStandardMaterial({ color: "#b3aea4", roughness: 0.9 });
const steel = new THREE.MeshStandardMaterial({ color: "#4d5358", roughness: 0.45, metalness: 0.6 });
const ghost = new THREE.MeshBasicMaterial({ color: "#8c8778", transparent: true, opacity: 0.13, depthWrite: false });
const edge = new THREE.LineBasicMaterial({ color: "#5b5f63" });

export class ShownObstacles {
  #hosts = new Map<string, { list: unknown; group: THREE.Group }>();

  constructor(readonly parent: THREE.Group) {}

  /** True: one of them moves. */
  update(source: Scene): boolean {
    const now = source.now(), hosts = this.#hosts;
    let moving = false;
    for (const [host, item] of hosts)
      if (!source.obstacles.has(host)) {
        this.parent.remove(release(item.group));
        hosts.delete(host);
      }
    for (const [host, { list, at }] of source.obstacles) {
      let item = hosts.get(host);
      if (item?.list !== list) {
        if (item) this.parent.remove(release(item.group));
        item = { list, group: new THREE.Group() };
        hosts.set(host, item);
        this.parent.add(item.group);
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

  /** Makes obstacles between the eye and one of these points transparent. */
  seeThrough(eye: THREE.Vector3, points: THREE.Vector3[]): void {
    const meshes = [...this.#hosts.values()].flatMap(({ group }) => group.children).filter((object) => object instanceof THREE.Mesh);
    for (const mesh of meshes) mesh.material = mesh.userData.solid;
    for (const point of points) {
      const ray = new THREE.Raycaster(eye, point.clone().sub(eye).normalize(), 0, point.distanceTo(eye));
      for (const { object } of ray.intersectObjects(meshes, false)) (object as THREE.Mesh).material = ghost;
    }
    for (const mesh of meshes) mesh.castShadow = mesh.material !== ghost;
  }
}

function makeObstacle(obstacle: Obstacle): THREE.Object3D {
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
