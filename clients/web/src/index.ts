export * from "./decode.js";
export * from "./baked.js";
export * from "./live.js";
