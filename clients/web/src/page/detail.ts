// Decides how much the page draws. Without a graphics card a frame may take seconds.

/** From everything down to what a processor can draw, and what the page says about it. pixels: share of the pixels of a side. */
const details = [
  { shadows: true, pixels: 1, says: "" },
  { shadows: false, pixels: 0.7, says: ", drawn without shadows" },
  { shadows: false, pixels: 0.4, says: ", drawn coarsely" },
];
const slowest = 40; // ms, mean of the frames of
const enough = 1000; // ms

export class Detail {
  /** The user wants everything, however slow it is. */
  inFull = false;
  #level = 0;
  #frames = 0;
  #since = 0; // ms
  #slow = 0; // how many means in a row were too slow

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
   * Counts a frame. True: the page shall draw less from now on. It decides by the mean over a while, because a browser takes some
   * frames at once, and then none for long; and only if two means in a row are too slow, because one may come of reading a file.
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

  /** Begins to count anew, because the page drew nothing until now. */
  start(now: number): void {
    this.#frames = 0;
    this.#since = now;
  }
}
