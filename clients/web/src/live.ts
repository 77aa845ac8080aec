// A connection to `crumple view`: one WebSocket, by which the gateway brings the scene up to date again and again. A message is a batch
// of entries:
//
//   u16 size of the key, u32 size of the payload, u32 its age in ms, the key, the payload      (little endian)
//
// The page answers a batch with an empty message, and then the gateway sends the next one. It skips entries that are outdated by then,
// so a page that was frozen gets the present and not its past.
import { readCar } from "./baked.js";
import { Scene, type Entry } from "./scene.js";

/** ms until a lost connection is tried again; each failure doubles it, up to the last. */
const firstRetry = 250, lastRetry = 4000;
/** ms until the page asks again for an asset that the gateway did not have. */
const assetRetry = 100;

export type Link = "connecting" | "live" | "lost";

export class Live extends Scene {
  link: Link = "connecting";
  received = { batches: 0, bytes: 0 };
  /** By asset that cannot be shown: a sentence that says why. */
  trouble = new Map<string, string>();

  #url: URL;
  #socket: WebSocket | null = null;
  #retry = firstRetry;
  #asked = new Set<string>(); // assets on their way
  #closed = false;

  /** url: of the page that `crumple view` serves, such as http://127.0.0.1:8080/ */
  constructor(url: string | URL) {
    super();
    this.#url = new URL(url);
    this.#connect();
  }

  close(): void {
    this.#closed = true;
    this.#socket?.close();
  }

  #connect(): void {
    const url = new URL("live", this.#url);
    url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
    const socket = (this.#socket = new WebSocket(url));
    socket.binaryType = "arraybuffer";
    socket.onmessage = ({ data }) => {
      this.link = "live";
      this.#retry = firstRetry;
      this.#read(new Uint8Array(data as ArrayBuffer));
      if (socket.readyState === WebSocket.OPEN) socket.send(new Uint8Array(0));
    };
    socket.onclose = () => {
      this.link = "lost";
      if (this.#closed) return;
      setTimeout(() => this.#connect(), this.#retry);
      this.#retry = Math.min(2 * this.#retry, lastRetry);
    };
  }

  #read(batch: Uint8Array): void {
    const now = performance.now();
    ++this.received.batches;
    this.received.bytes += batch.length;
    const view = new DataView(batch.buffer, batch.byteOffset, batch.length), text = new TextDecoder();
    const entries: Entry[] = [];
    for (let at = 0; at < batch.length; ) {
      const keySize = view.getUint16(at, true), size = view.getUint32(at + 2, true), age = view.getUint32(at + 6, true);
      const from = at + 10 + keySize;
      // a copy, so that its fields are aligned
      entries.push({ key: text.decode(batch.subarray(at + 10, from)), at: now - age, payload: batch.slice(from, from + size) });
      at = from + size;
    }
    this.take(entries);
  }

  protected override want(asset: string): void {
    if (this.#asked.has(asset)) return;
    this.#asked.add(asset);
    void this.#fetch(asset);
  }

  async #fetch(asset: string): Promise<void> {
    const wanted = () => new Set([...this.cars.values()].map(({ surface }) => surface.asset));
    while (!this.#closed && wanted().has(asset)) {
      try {
        const answer = await fetch(new URL(`asset/${asset}`, this.#url));
        if (answer.status === 404) throw new Error("the gateway does not have it yet");
        if (!answer.ok) throw new Error(`the gateway answers ${answer.status}`);
        const baked = readCar(new Uint8Array(await answer.arrayBuffer()), asset), still = wanted();
        for (const held of this.assets.keys()) if (!still.has(held)) this.assets.delete(held);
        this.give(asset, baked);
        break;
      } catch (error) {
        this.trouble.set(asset, `asset ${asset}: ${error instanceof Error ? error.message : error}`);
        await new Promise((wait) => setTimeout(wait, assetRetry));
      }
    }
    this.trouble.delete(asset);
    this.#asked.delete(asset);
  }
}
