// A model of the user's, a glTF file that was dropped on the page: the cars that were baked from it are drawn with it.
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";
import { OwnModel } from "../three.js";
import type { State } from "./state.js";

export const isModel = (name: string) => /\.(glb|gltf)$/i.test(name);

/** Throws an Error with a sentence if the file is no model, or of none of the cars that the page shows. */
export async function openModel(state: State, bytes: ArrayBuffer): Promise<void> {
  const { scene } = await new GLTFLoader().parseAsync(bytes, "").catch((error: Error) => {
    const outside = error.message.includes("Failed to load buffer");
    throw new Error(outside ? "its vertices are in another file; export it as one GLB file" : error.message.slice(0, 200));
  });
  const cars = new Set(state.stages.flatMap((stage) => [...stage.cars.values()].flatMap(({ car }) => car.baked ?? [])));
  if (!cars.size) throw new Error("there is no car yet whose surface it could show; drop it again when there is one");
  let why: unknown;
  const fits = [...cars].some((baked) => {
    try {
      new OwnModel(baked, scene.clone(true)).dispose();
      return true;
    } catch (error) {
      why = error;
    }
  });
  if (!fits) throw why;
  for (const stage of state.stages) stage.model = scene;
  state.wake();
}
