// The pixels of a layer in one frame: loaded as scripts, which a page from disk may do, and forgotten when they are many.
import { signal } from "@preact/signals";
import { data } from "./data";
import type { Clip, Layer } from "./data";
import { halfToFloat } from "./half";
import { unpack } from "./unpack";

export interface Pixels {
  width: number;
  height: number;
  components: number;
  type: "byte" | "half" | "float"; // a byte stands for value / 255
  raw: Uint8Array | Uint16Array | Float32Array; // (height, width, components)
}

interface About { type: Pixels["type"]; shape: [number, number, number] }
declare global {
  interface Window { nteLayer(name: string, about: About, text: string): void }
}

const BUDGET = 600e6; // bytes of decoded pixels: sixty frames of two half-float images at 720p
const PATIENCE = 30e3; // ms
const kept = new Map<string, Pixels>(); // least recently used first
const pending = new Map<string, { promise: Promise<Pixels | null>; hand: (pixels: Pixels | null) => void }>();
const lost = new Set<string>(); // no such file
let bytes = 0;

/** Counts what has arrived, so that whoever draws draws again. */
export const arrived = signal(0);

export const isThere = (layer: Layer, frame: number) => layer.frames === null || layer.frames.includes(frame);
const nameOf = (clip: Clip, layer: Layer, frame: number) =>
  `${clip.folder}/${layer.key}/${String(frame).padStart(4, "0")}`;
export const isLost = (clip: Clip, layer: Layer, frame: number) => lost.has(nameOf(clip, layer, frame));
/** Whether the pixels are not in memory, but can be expected. */
export const isComing = (clip: Clip, layer: Layer, frame: number) =>
  isThere(layer, frame) && !isLost(clip, layer, frame) && !peek(clip, layer, frame);

/** The pixels if they are in memory. */
export function peek(clip: Clip, layer: Layer, frame: number): Pixels | undefined {
  const name = nameOf(clip, layer, frame);
  const found = kept.get(name);
  if (found) {
    kept.delete(name);
    kept.set(name, found);
  }
  return found;
}

/** Load the pixels; null if the file is missing. */
export function load(clip: Clip, layer: Layer, frame: number): Promise<Pixels | null> {
  const name = nameOf(clip, layer, frame);
  const found = peek(clip, layer, frame);
  if (found || lost.has(name) || !isThere(layer, frame)) return Promise.resolve(found ?? null);
  const waiting = pending.get(name);
  if (waiting) return waiting.promise;
  let hand!: (pixels: Pixels | null) => void;
  const promise = new Promise<Pixels | null>((resolve) => (hand = resolve));
  pending.set(name, { promise, hand });
  const script = document.createElement("script");
  script.src = `${data.folder}/${name}.js`;
  const fail = () => { lost.add(name); settle(name, null); };
  const timer = setTimeout(fail, PATIENCE);
  script.onload = () => { clearTimeout(timer); script.remove(); };
  script.onerror = () => { clearTimeout(timer); script.remove(); fail(); };
  document.head.append(script);
  return promise;
}

window.nteLayer = (name, about, text) => {
  decode(about, text).then((pixels) => {
    kept.set(name, pixels);
    bytes += pixels.raw.byteLength;
    for (const [old, { raw }] of kept) {
      if (bytes <= BUDGET || old === name) break;
      kept.delete(old);
      bytes -= raw.byteLength;
    }
    settle(name, pixels);
  }, () => { lost.add(name); settle(name, null); });
};

function settle(name: string, pixels: Pixels | null) {
  const waiting = pending.get(name);
  pending.delete(name);
  waiting?.hand(pixels);
  arrived.value++;
}

async function decode({ type, shape }: About, text: string): Promise<Pixels> {
  const [height, width, components] = shape;
  const [size, values] = ({ byte: [1, Uint8Array], half: [2, Uint16Array], float: [4, Float32Array] } as const)[type];
  return { width, height, components, type, raw: new values(await unpack(text, size)) };
}

/** The value of one component of a pixel. */
export function valueAt({ raw, type, width, components }: Pixels, x: number, y: number, component: number): number {
  const stored = raw[(y * width + x) * components + component];
  return type === "half" ? halfToFloat(stored) : type === "byte" ? stored / 255 : stored;
}
