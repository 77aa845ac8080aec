// What the page does with any object of three.js.
import * as THREE from "three";
import type { Pose } from "../decode.js";

export function place(object: THREE.Object3D, pose: Pose): void {
  object.position.set(...pose.position);
  object.quaternion.set(...pose.orientation);
}

/** Gives the graphics card's memory back; materials are shared. */
export function release(group: THREE.Group): THREE.Group {
  group.traverse((object) => (object as THREE.Mesh).geometry?.dispose());
  return group;
}
