// How much is drawn. Without a graphics card a frame may take seconds.

/** From all to what a processor can draw, with what is said of it; pixels: a side, as a share. */
const details = [
  { shadows: true, pixels: 1, says: "" },
  { shadows: false, pixels: 0.7, says: ", drawn without shadows" },
  { shadows: false, pixels: 0.4, says: ", drawn coarsely" },
];
const slowest = 40; // ms a frame, as a mean of
const enough = 1000; // ms

export class Detail {
  /** The user wants all, however slow. */
  inFull = false;
  #level = 0;
  #frames = 0;
  #since = 0; // ms
  #slow = 0; // means in a row

  get shadows(): boolean {
    return details[this.#level].shadows;
  }
  get pixels(): number {
    return details[this.#level].pixels;
  }
  get says(): string {
    return details[this.#level].says + (this.#level ? " to keep up (key F: in full)" : this.inFull ? ", drawn in full" : "");
  }

  become(level: number): void {
    this.#level = level;
    this.#slow = 0;
  }

  /**
   * Counts a frame. True: from now on less is drawn. The mean over a while counts: a browser takes some frames at once, then none for
   * long. Twice in a row, since once may be a file that was read.
   */
  count(now: number): boolean {
    ++this.#frames;
    if (now - this.#since < enough) return false;
    this.#slow = (now - this.#since) / this.#frames > slowest ? this.#slow + 1 : 0;
    this.start(now);
    if (this.#slow < 2 || this.inFull || !details[this.#level + 1]) return false;
    this.become(this.#level + 1);
    return true;
  }

  /** Begins to count anew: nothing was drawn before. */
  start(now: number): void {
    this.#frames = 0;
    this.#since = now;
  }
}
