// Drawing without WebGL: every pixel of the image is computed, then the picture is enlarged.
import type { Painter } from "./gl";
import { originOf } from "./panes";
import type { Pane } from "./panes";
import type { Pixels } from "./pixels";
import { shade } from "./shade";

const KEPT = 12; // pictures

export function canvasPainter(canvas: HTMLCanvasElement): Painter {
  const context = canvas.getContext("2d")!;
  const kept = new Map<string, HTMLCanvasElement>();
  const numbers = new WeakMap<Pixels, number>();
  let count = 0;
  const numberOf = (pixels: Pixels | undefined) => {
    if (!pixels) return "";
    if (!numbers.has(pixels)) numbers.set(pixels, count++);
    return String(numbers.get(pixels));
  };

  function picture(pane: Pane, image: Pixels, base: Pixels | undefined): HTMLCanvasElement {
    const key = JSON.stringify([numberOf(image), numberOf(base), pane.look]);
    const found = kept.get(key);
    if (found) return found;
    const made = Object.assign(document.createElement("canvas"), { width: image.width, height: image.height });
    const painted = new ImageData(image.width, image.height);
    for (let y = 0, at = 0; y < image.height; y++) {
      for (let x = 0; x < image.width; x++) {
        for (const level of shade(image, base, x, y, pane.look)) painted.data[at++] = Math.round(level * 255);
        painted.data[at++] = 255;
      }
    }
    made.getContext("2d")!.putImageData(painted, 0, 0);
    kept.set(key, made);
    if (kept.size > KEPT) kept.delete(kept.keys().next().value!);
    return made;
  }

  return {
    draw(panes, part, pixels) {
      context.clearRect(0, 0, canvas.width, canvas.height);
      context.imageSmoothingEnabled = part.zoom < 1;
      for (const pane of panes) {
        const [image, base] = pixels(pane);
        if (!image || (pane.base && !base)) continue;
        const { box, clip } = pane;
        const origin = originOf(part, box);
        context.save();
        context.beginPath();
        context.rect(clip.x, clip.y, clip.width, clip.height);
        context.clip();
        context.drawImage(
          picture(pane, image, base), box.x - origin.x * part.zoom, box.y - origin.y * part.zoom,
          image.width * part.zoom, image.height * part.zoom);
        context.restore();
      }
    },
  };
}
