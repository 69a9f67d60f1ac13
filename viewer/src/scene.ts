// The panes that the reader's choices ask for.
import { all, clip, flipOf, flipped, gain, layout, left, mode, referenceOf, right, split, stops } from "./state";
import { titleOf } from "./data";
import type { Clip, Layer } from "./data";
import { gridOf } from "./panes";
import type { Pane, Rectangle } from "./panes";
import type { Look, Operation } from "./shade";

/** Lay the panes out on a canvas of this size in device pixels. */
export function scene(width: number, height: number): Pane[] {
  const found = clip.value;
  if (!found || !left.value || !right.value || !width || !height) return [];
  const whole = { x: 0, y: 0, width, height };
  if (mode.value === "difference") return [difference(found, whole, left.value, right.value)];
  if (layout.value === "all") {
    const boxes = gridOf(all.value.length, width, height, found);
    return all.value.map((layer, i) => pane(found, boxes[i], layer, "left"));
  }
  const [ours, theirs] = [left.value, right.value];
  if (layout.value === "side") {
    const boxes = gridOf(2, width, height, found);
    return [pane(found, boxes[0], ours, "left"), pane(found, boxes[1], theirs, "left")];
  }
  if (layout.value === "flip") return [pane(found, whole, flipped.value ? theirs : ours, "left")];
  const at = Math.round(split.value * width);
  return [
    { ...pane(found, whole, ours, "left"), clip: { ...whole, width: at } },
    { ...pane(found, whole, theirs, "right"), clip: { ...whole, x: at, width: width - at } },
  ];
}

function pane(found: Clip, box: Rectangle, layer: Layer, side: Pane["side"]): Pane {
  const common = { box, clip: box, side };
  const reference = mode.value === "signed" && layer.group === "image" ? referenceOf(layer) : null;
  if (reference && reference !== layer) {
    return {
      ...common, layer, base: reference, look: look(found, layer, "signed"), title: `${titleOf(layer)} − reference`,
    };
  }
  const map = mode.value === "flip" && layer.group === "image" ? flipOf(layer) : null;
  const shown = map ?? layer;
  return { ...common, layer: shown, base: null, look: look(found, shown, "value"), title: titleOf(shown) };
}

function difference(found: Clip, box: Rectangle, ours: Layer, theirs: Layer): Pane {
  const alike = ours.shown === theirs.shown && ours.components.length === theirs.components.length;
  const title = alike ? `${titleOf(ours)} − ${titleOf(theirs)}` : "These two cannot be compared: choose two of a kind";
  const base = alike ? theirs : null;
  return { box, clip: box, layer: ours, base, look: look(found, ours, alike ? "difference" : "value"), title, side: "left" };
}

function look(found: Clip, layer: Layer, op: Operation): Look {
  const factor = 2 ** stops.value;
  return {
    shown: layer.shown,
    op,
    exposure: found.exposure * layer.brightened * factor,
    full: layer.scale / factor, // the slider scales other numbers as well
    gain: layer.shown === "flip" ? factor : gain.value,
  };
}
