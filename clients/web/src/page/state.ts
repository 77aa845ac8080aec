// Has all that the page remembers, in one value. The modules of the page hand it over to each other and have no variables themselves.
import type { Film } from "../film.js";
import type { Live } from "../live.js";
import { Scene } from "../scene.js";
import type { Quantity } from "./colours.js";
import type { Clock, Comparison, Rectangle } from "./compare.js";
import { Detail } from "./detail.js";
import type { Drawing } from "./drawing.js";
import { element } from "./element.js";
import { Stage } from "./stage.js";
import type { Tools } from "./tools.js";

/** A recording and the name of its file. */
export interface Opened {
  name: string;
  film: Film;
}

const staysAwake = 700; // ms: as long as damping and arrows go on by themselves

export class State {
  // What the page shows.
  source: Scene; // the live scene or a recording
  readonly empty = new Scene();
  beside = this.empty; // the scene of the second view
  readonly first = new Stage(() => this.source, (id) => this.follow(id));
  readonly second = new Stage(() => this.beside, null);
  readonly stages = [this.first, this.second];
  comparison: Comparison | null = null; // of these two
  heatOf: Quantity | null = null;
  hadCars = false;

  // Recordings.
  opened: Opened[] = [];
  clock: Clock | null = null; // of the recordings that the page shows
  playing = false;

  // The view.
  followed = ""; // a car's id; "": the cars that move
  framed = false; // the camera has been put before the car
  views: Rectangle[] | null = null; // while the page shows two
  readonly detail = new Detail();

  // The loop.
  awakeUntil = 0; // ms, as all times here
  calledAt = 0;
  drawnAt = 0;
  panelAt = 0;
  version = -1; // of both scenes together, in the last frame

  tools: Tools | null = null;

  constructor(readonly live: Live, readonly drawing: Drawing) {
    this.source = live;
    for (const { group } of this.stages) drawing.scene.add(group);
  }

  get film(): Film | null {
    return this.opened[0]?.film ?? null;
  }

  /** Makes the loop draw for a while. */
  wake(): void {
    this.awakeUntil = performance.now() + staysAwake;
  }

  follow(id: string): void {
    this.followed = id;
    this.framed = false;
    this.wake();
  }

  /** Says what a button does. */
  press(id: string, action: () => void): void {
    element(id).onclick = () => {
      action();
      this.wake();
    };
  }
}
