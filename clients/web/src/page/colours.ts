// The colours that show a number of each vertex, and the quantities that they may show; and those of regions and parts.
import * as THREE from "three";

/** The lightness falls all the way, so that everybody can read them, colour-blind or not. */
export const heat = ["#f1efe9", "#fac228", "#f57d15", "#d44842", "#9f2a63", "#65156e", "#280b53"].map((colour) => new THREE.Color(colour));

/** A quantity that colours may show, and the value that has the last colour. In a comparison the difference takes the place of the dent. */
export type Quantity = "dent" | "strain";
export const heatMost: Record<Quantity, number> = { dent: 0.5, strain: 0.5 }; // m, 1

/** Okabe and Ito's colours, which the colour-blind can tell apart too, for regions and parts. */
export const palette = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#000000"].map((colour) => new THREE.Color(colour));
