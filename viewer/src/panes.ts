// What stands where on the canvas: panes that all show the same part of the image.
import type { Clip, Layer } from "./data";
import type { Look } from "./shade";

export interface Rectangle { x: number; y: number; width: number; height: number } // device pixels
/** The part of the image that every pane shows: its centre in image pixels, and device pixels for each of them. */
export interface Part { x: number; y: number; zoom: number }

export interface Pane {
  box: Rectangle; // where the image is laid out
  clip: Rectangle; // what of it is drawn
  layer: Layer;
  base: Layer | null; // what it is compared with
  look: Look;
  title: string;
  side: "left" | "right"; // of the pane, where its title stands
}

/** The largest zoom at which the image fits; a whole number if the image is smaller than the pane. */
export function fitting(clip: Clip, box: Rectangle): number {
  const zoom = Math.min(box.width / clip.width, box.height / clip.height);
  return zoom > 1 ? Math.floor(zoom) : zoom;
}

/** The place in the image at a pane's upper left corner. */
export function originOf(part: Part, box: Rectangle) {
  // On whole device pixels, so that image pixels have equal sizes.
  return {
    x: Math.round(part.x * part.zoom - box.width / 2) / part.zoom,
    y: Math.round(part.y * part.zoom - box.height / 2) / part.zoom,
  };
}

/** Keep the image in sight: it is in the middle along an axis where it fits. */
export function within(part: Part, clip: Clip, box: Rectangle): Part {
  const held = (at: number, size: number, room: number) => {
    const half = room / 2 / part.zoom;
    return 2 * half >= size ? size / 2 : Math.min(size - half, Math.max(half, at));
  };
  return { zoom: part.zoom, x: held(part.x, clip.width, box.width), y: held(part.y, clip.height, box.height) };
}

/** Boxes of equal size for `count` panes, in the number of columns that makes the images largest. */
export function gridOf(count: number, width: number, height: number, clip: Clip): Rectangle[] {
  const GAP = 4;
  let best = { columns: 1, zoom: 0 };
  for (let columns = 1; columns <= count; columns++) {
    const rows = Math.ceil(count / columns);
    const zoom = Math.min(width / columns / clip.width, height / rows / clip.height);
    if (zoom >= best.zoom * 0.99) best = { columns, zoom }; // alike: side by side, whatever was rounded
  }
  const rows = Math.ceil(count / best.columns);
  const cell = {
    width: Math.floor((width - GAP * (best.columns - 1)) / best.columns),
    height: Math.floor((height - GAP * (rows - 1)) / rows),
  };
  return Array.from({ length: count }, (_, i) => ({
    ...cell,
    x: (i % best.columns) * (cell.width + GAP),
    y: Math.floor(i / best.columns) * (cell.height + GAP),
  }));
}
