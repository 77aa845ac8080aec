// Colours that show a number of each vertex, and what they may show.
import * as THREE from "three";

/** Lightness falls all the way, so that they are read in any colour vision. */
export const heat = ["#f1efe9", "#fac228", "#f57d15", "#d44842", "#9f2a63", "#65156e", "#280b53"].map((colour) => new THREE.Color(colour));

/** What colours may show of a car, and which value has the last of them. In a comparison the difference stands in place of the dent. */
export type Quantity = "dent" | "strain";
export const heatMost: Record<Quantity, number> = { dent: 0.5, strain: 0.5 }; // m, 1
