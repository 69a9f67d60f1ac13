// What the reader has chosen. Everything that is drawn follows from it.
import { batch, computed, effect, signal } from "@preact/signals";
import { data, idOf, titleOf } from "./data";
import type { Clip, Layer } from "./data";
import type { Part } from "./panes";
import { isComing, load } from "./pixels";

export const LAYOUTS = { split: "Split", flip: "Flip", side: "Side by side", all: "All images" } as const;
export type Layout = keyof typeof LAYOUTS;
export const MODES = {
  value: "Values", difference: "Difference, left − right", signed: "Signed error against the reference", flip: "FLIP",
} as const;
export type Mode = keyof typeof MODES;

export const clipIndex = signal(0);
export const position = signal(0); // in the list of the clip's frames
export const leftId = signal("");
export const rightId = signal("");
export const layout = signal<Layout>("split");
export const mode = signal<Mode>("value");
export const split = signal(0.5); // share of the width
export const flipped = signal(false); // in the layout "flip": which of the two is seen
export const stops = signal(0); // exposure, in powers of two
export const gain = signal(4); // of differences
export const vectors = signal(false); // arrows
export const part = signal<Part | null>(null); // null: the whole image
export const playing = signal(false);
export const drawn = signal(-1); // the frame that the canvas shows
export const rate = signal(12); // frames a second
export const hovered = signal<{ x: number; y: number } | null>(null); // image pixel
export const hoveredFrame = signal<number | null>(null); // in the curves
export const everyChannel = signal(false); // the numbers of all layers at the pixel
export const withKernels = signal(false); // the kernels at the pixel

export const clip = computed<Clip | null>(() => data.clips[clipIndex.value] ?? null);
export const frame = computed(() => clip.value?.frames[position.value] ?? 0);

export const layersOf = (group: Layer["group"]) => clip.value?.layers.filter((layer) => layer.group === group) ?? [];
const find = (id: string) => clip.value?.layers.find((layer) => idOf(layer) === id) ?? null;
export const left = computed(() => find(leftId.value));
export const right = computed(() => find(rightId.value));

/** The image of the same light from the reference; null if there is none. */
export const referenceOf = (layer: Layer) =>
  layersOf("image").find((other) => other.of === "reference" && other.channel === layer.channel) ?? null;
/** The map of the differences that an eye would see between a layer and its reference. */
export const flipOf = (layer: Layer) =>
  layersOf("flip").find((other) => other.of === layer.of && other.channel === layer.channel) ?? null;
/** The light that is looked at: that of the right image. */
const light = computed(() => {
  const lights = layersOf("image").map((layer) => layer.channel);
  return right.value && lights.includes(right.value.channel) ? right.value.channel : lights[0];
});
/** What the keys 1 to 9 choose: the images of this light, denoisers first. */
export const numbered = computed(() => {
  const images = layersOf("image").filter((layer) => layer.channel === light.value);
  const given = (layer: Layer) => layer.of === "reference" || layer.of === "noisy input";
  return [...images.filter((layer) => !given(layer)), ...images.filter(given)];
});
/** What the layout of all shows: the same, but maps only of those that have one. */
export const all = computed(() => numbered.value.filter((layer) =>
  mode.value === "signed" ? layer.of !== "reference" : mode.value !== "flip" || flipOf(layer)));

export function chooseClip(index: number) {
  batch(() => {
    clipIndex.value = index;
    const found = clip.value;
    if (!found) return;
    const start = found.chosen == null ? 0 : found.frames.indexOf(found.chosen);
    position.value = Math.max(0, start);
    part.value = null;
    hovered.value = null;
    const images = layersOf("image");
    const image = (of: string) => images.find((layer) => layer.of === of);
    const [first] = numbered.value.filter((layer) => layer !== image("noisy input") && layer !== image("noisy"));
    if (!left.value) leftId.value = idOf(image("noisy input") ?? image("noisy") ?? found.layers[0]);
    if (!right.value || right.value === left.value) {
      rightId.value = idOf(bestImage() ?? first ?? image("reference") ?? found.layers.at(-1)!);
    }
  });
}

/** The denoiser with the highest PSNR. */
function bestImage(): Layer | undefined {
  const means = data.tables[0]?.rows ?? {};
  const psnr = (layer: Layer) => means[layer.of]?.psnr?.[0] ?? -Infinity;
  const scored = layersOf("image").filter((layer) => psnr(layer) > -Infinity);
  return scored.sort((a, b) => psnr(b) - psnr(a))[0];
}

export function step(by: number) {
  const count = clip.value?.frames.length ?? 0;
  if (count) position.value = (((position.value + by) % count) + count) % count;
}

/** Go to a frame by its number, or to the nearest that has pixels. */
export function goTo(wanted: number) {
  const frames = clip.value?.frames ?? [];
  let nearest = 0;
  frames.forEach((index, at) => {
    if (Math.abs(index - wanted) < Math.abs(frames[nearest] - wanted)) nearest = at;
  });
  position.value = nearest;
}

/** The layers that are in sight. */
export const inSight = computed<Layer[]>(() => {
  const both = [left.value, right.value].filter((layer) => layer !== null);
  const shown = layout.value === "all" && mode.value !== "difference" ? all.value : both;
  const more: (Layer | null)[] = [];
  if (mode.value === "signed") more.push(...shown.map(referenceOf));
  if (mode.value === "flip") more.push(...shown.map(flipOf));
  if (vectors.value) more.push(motionLayer.value);
  return [...new Set([...shown, ...more.filter((layer) => layer !== null)])];
});

/** The vectors that arrows are drawn of: those in sight, or the clip's own. */
export const motionLayer = computed<Layer | null>(() => {
  const shown = [right.value, left.value].find((layer) => layer?.shown === "motion");
  return shown ?? clip.value?.layers.find((layer) => layer.channel === "motion") ?? null;
});

/** Load the layers in sight of the frames that come next. */
const AHEAD = 4;
effect(() => {
  const found = clip.value;
  if (!found?.frames.length) return;
  const ahead = playing.value ? AHEAD : 1;
  for (let i = 0; i <= ahead; i++) {
    const index = found.frames[(position.value + i) % found.frames.length];
    for (const layer of inSight.value) void load(found, layer, index);
  }
});

/** Play: a frame comes when its time has come and all that is in sight of it is there, so all images stay in step. */
effect(() => {
  if (!playing.value) return;
  let due = performance.now();
  let request = requestAnimationFrame(function tick(now) {
    request = requestAnimationFrame(tick);
    if (now < due || drawn.peek() !== frame.peek()) return; // a slow machine plays slowly, and leaves no frame out
    const found = clip.peek();
    if (!found || found.frames.length < 2) return;
    const next = found.frames[(position.peek() + 1) % found.frames.length];
    if (inSight.peek().some((layer) => isComing(found, layer, next))) return;
    step(1);
    due = Math.max(due + 1000 / rate.peek(), now);
  });
  return () => cancelAnimationFrame(request);
});

export const describe = (layer: Layer | null) => (layer ? titleOf(layer) : "–");
chooseClip(0);
