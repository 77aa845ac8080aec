/** What the user changes, with undo and redo. */
export class History<T> {
  #past: T[] = [];
  #future: T[] = [];

  constructor(public now: T, readonly changed: () => void) {}

  become(next: T): void {
    this.#past.push(this.now);
    this.#future = [];
    this.now = next;
    this.changed();
  }

  undo(): void {
    this.#step(this.#past, this.#future);
  }

  redo(): void {
    this.#step(this.#future, this.#past);
  }

  /** How many steps can be undone, and redone. */
  get past(): number {
    return this.#past.length;
  }
  get future(): number {
    return this.#future.length;
  }

  #step(from: T[], to: T[]): void {
    if (!from.length) return;
    to.push(this.now);
    this.now = from.pop()!;
    this.changed();
  }
}
