declare module "lz4js" {
  /** An LZ4 frame. */
  export function decompress(frame: Uint8Array, size?: number): Uint8Array;
}
