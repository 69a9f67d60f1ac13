// The keyboard.
import { batch } from "@preact/signals";
import { idOf } from "./data";
import { zoomBy } from "./stage";
import {
  clip, flipped, layout, leftId, mode, numbered, part, playing, position, rightId, split, step, stops, vectors,
} from "./state";

export const KEYS: [string, string][] = [
  ["← →", "one frame back or on; with Shift ten"],
  ["Home End", "first and last frame"],
  ["Space", "play or stop"],
  ["1–9", "the image on the right; with Shift on the left"],
  ["S F B A", "split, flip, side by side, all images; F again flips"],
  ["V D E M", "values, difference, signed error, FLIP map"],
  ["W", "arrows of the motion vectors"],
  ["+ − 0", "zoom in, zoom out, whole image; the wheel zooms at the pointer, dragging moves"],
  ["[ ]", "darker, brighter by half a stop; \\ as it was"],
  [", .", "divider to the left, to the right"],
];

const actions: Record<string, (shift: boolean) => void> = {
  ArrowLeft: (shift) => step(shift ? -10 : -1),
  ArrowRight: (shift) => step(shift ? 10 : 1),
  Home: () => (position.value = 0),
  End: () => (position.value = Math.max(0, (clip.value?.frames.length ?? 1) - 1)),
  " ": () => (playing.value = !playing.value),
  s: () => (layout.value = "split"),
  f: () => {
    if (layout.value === "flip") flipped.value = !flipped.value;
    layout.value = "flip";
  },
  b: () => (layout.value = "side"),
  a: () => (layout.value = "all"),
  v: () => (mode.value = "value"),
  d: () => (mode.value = "difference"),
  e: () => (mode.value = "signed"),
  m: () => (mode.value = "flip"),
  w: () => (vectors.value = !vectors.value),
  "+": () => zoomBy(2),
  "=": () => zoomBy(2),
  "-": () => zoomBy(0.5),
  "0": () => (part.value = null),
  "[": () => (stops.value = Math.max(-8, stops.value - 0.5)),
  "]": () => (stops.value = Math.min(8, stops.value + 0.5)),
  "\\": () => (stops.value = 0),
  ",": () => (split.value = Math.max(0, split.value - 0.05)),
  ".": () => (split.value = Math.min(1, split.value + 0.05)),
};

export function listen() {
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const target = event.target as HTMLElement;
    if (target.closest("select, input, textarea, [role=tablist]")) return;
    if (event.key === " " && target.closest("button, summary, a")) return; // which it presses
    const digit = /^Digit([1-9])$/.exec(event.code)?.[1] ?? (/^[1-9]$/.test(event.key) ? event.key : null);
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!digit && !action) return;
    event.preventDefault();
    batch(() => {
      if (!digit) return action(event.shiftKey);
      const layer = numbered.value[Number(digit) - 1];
      if (layer) (event.shiftKey ? leftId : rightId).value = idOf(layer);
    });
  });
  // A slider or a menu that was used with the pointer gives the keys back.
  addEventListener("pointerup", (event) => {
    const target = event.target as HTMLElement;
    if (target.matches("input[type=range]")) target.blur();
  });
  addEventListener("change", (event) => {
    const target = event.target as HTMLElement;
    if (target.matches("select, input[type=checkbox]")) target.blur();
  });
}
