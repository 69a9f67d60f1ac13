// Motion vectors as arrows, from a pixel to where its surface was in the previous frame (or will be, by the channel).
import type { Clip } from "./data";
import { originOf } from "./panes";
import type { Pane, Part } from "./panes";
import { valueAt } from "./pixels";
import type { Pixels } from "./pixels";

const EVERY = 26; // CSS pixels between arrows
const STILL = 0.25; // device pixels: shorter ones become dots

export function drawArrows(canvas: HTMLCanvasElement, panes: Pane[], part: Part, clip: Clip, motion: Pixels | undefined) {
  // In memory: on a graphics card that is a program, Chromium sometimes shows a canvas as it was before it was cleared.
  const context = canvas.getContext("2d", { willReadFrequently: true })!;
  context.clearRect(0, 0, canvas.width, canvas.height);
  if (!motion) return;
  const ratio = canvas.width / canvas.clientWidth || 1;
  const stride = Math.max(1, Math.round((EVERY * ratio) / part.zoom));
  for (const { box, clip: seen } of panes) {
    const origin = originOf(part, box);
    const path = new Path2D();
    for (let y = Math.floor(stride / 2); y < clip.height; y += stride) {
      for (let x = Math.floor(stride / 2); x < clip.width; x += stride) {
        const [u, v] = [valueAt(motion, x, y, 0), valueAt(motion, x, y, 1)];
        if (!Number.isFinite(u) || !Number.isFinite(v)) continue;
        arrow(
          path, box.x + (x + 0.5 - origin.x) * part.zoom, box.y + (y + 0.5 - origin.y) * part.zoom,
          u * part.zoom, v * part.zoom, ratio);
      }
    }
    context.save();
    context.beginPath();
    context.rect(seen.x, seen.y, seen.width, seen.height);
    context.clip();
    context.lineCap = "round";
    for (const [colour, width] of [["rgb(0 0 0 / .7)", 3], ["#fff", 1.2]] as const) {
      context.strokeStyle = colour;
      context.lineWidth = width * ratio;
      context.stroke(path);
    }
    context.restore();
  }
}

function arrow(path: Path2D, x: number, y: number, u: number, v: number, ratio: number) {
  const length = Math.hypot(u, v);
  path.moveTo(x, y);
  if (length < STILL) {
    path.lineTo(x + 0.01, y);
    return;
  }
  path.lineTo(x + u, y + v);
  const head = Math.min(5 * ratio, length / 2);
  for (const side of [-1, 1]) {
    const angle = Math.atan2(v, u) + Math.PI + side * 0.5;
    path.moveTo(x + u, y + v);
    path.lineTo(x + u + head * Math.cos(angle), y + v + head * Math.sin(angle));
  }
}
