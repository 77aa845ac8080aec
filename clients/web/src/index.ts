export * from "./decode.js";
export * from "./baked.js";
export * from "./mapping.js";
export * from "./parts.js";
export * from "./scene.js";
export * from "./live.js";
export * from "./control.js";
export * from "./film.js";
