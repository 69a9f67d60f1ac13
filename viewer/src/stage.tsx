// The canvas: draws what is chosen, and turns the pointer into a divider, a hand and a magnifying glass.
import { computed, effect, signal } from "@preact/signals";
import { useEffect, useMemo, useRef } from "preact/hooks";
import { drawArrows } from "./arrows";
import { canvasPainter } from "./canvas2d";
import { webglPainter } from "./gl";
import { fitting, originOf, within } from "./panes";
import type { Pane, Part } from "./panes";
import { arrived, isComing, isLost, isThere, peek } from "./pixels";
import { scene } from "./scene";
import { clip, drawn, flipped, frame, hovered, inSight, layout, mode, motionLayer, part, split, vectors } from "./state";

const MOST = 64; // CSS pixels for an image pixel
const GRIP = 14; // CSS pixels to each side of the divider

export const painter = signal<"WebGL" | "canvas">("WebGL");
const size = signal({ width: 0, height: 0, ratio: 1 }); // of the canvas, in device pixels
const panes = computed(() => scene(size.value.width, size.value.height));

const isSplit = () => layout.value === "split" && mode.value !== "difference";

/** The part that is in sight, in every pane. */
function seen(): Part | null {
  const found = clip.value;
  const box = panes.value[0]?.box;
  if (!found || !box) return null;
  return within(part.value ?? { x: 0, y: 0, zoom: fitting(found, box) }, found, box);
}

export function zoomBy(factor: number, at?: { x: number; y: number }) {
  const [found, now, box] = [clip.value, seen(), panes.value[0]?.box];
  if (!found || !now || !box) return;
  const least = fitting(found, box);
  const zoom = Math.min(MOST * size.value.ratio, Math.max(least, now.zoom * factor));
  const fixed = at ?? { x: now.x, y: now.y }; // this place of the image stays where it is
  const keep = now.zoom / zoom;
  const moved = { zoom, x: fixed.x + (now.x - fixed.x) * keep, y: fixed.y + (now.y - fixed.y) * keep };
  part.value = zoom <= least ? null : within(moved, found, box);
}

export function Stage() {
  const canvas = useRef<HTMLCanvasElement>(null);
  const overlay = useRef<HTMLCanvasElement>(null);
  const frameElement = useRef<HTMLDivElement>(null);

  useEffect(() => {
    const element = canvas.current!;
    const wanted = location.hash === "#2d" ? null : webglPainter(element);
    const paint = wanted ?? canvasPainter(element);
    painter.value = wanted ? "WebGL" : "canvas";
    const watcher = new ResizeObserver(() => {
      const ratio = window.devicePixelRatio || 1;
      const { clientWidth, clientHeight } = frameElement.current!;
      size.value = { width: Math.round(clientWidth * ratio), height: Math.round(clientHeight * ratio), ratio };
    });
    watcher.observe(frameElement.current!);
    let request = 0;
    const stop = effect(() => {
      arrived.value;
      const { width, height, ratio } = size.value;
      const [found, now, index, shown] = [clip.value, seen(), frame.value, panes.value];
      const arrows = vectors.value && found && motionLayer.value ? motionLayer.value : null;
      cancelAnimationFrame(request);
      if (!found || !now) return;
      const waits = inSight.value.some((layer) => isComing(found, layer, index));
      frameElement.current!.ariaBusy = "true"; // until all that is chosen is drawn
      request = requestAnimationFrame(() => {
        for (const one of [element, overlay.current!]) {
          if (one.width === width && one.height === height) continue;
          Object.assign(one, { width, height });
          // The page may have given a fraction of a pixel more, which would blur all others.
          Object.assign(one.style, { width: `${width / ratio}px`, height: `${height / ratio}px` });
        }
        paint.draw(shown, now, (pane) => [
          peek(found, pane.layer, index), pane.base ? peek(found, pane.base, index) : undefined]);
        drawArrows(overlay.current!, shown, now, found, arrows ? peek(found, arrows, index) : undefined);
        element.dataset.frame = String(index);
        drawn.value = index;
        frameElement.current!.ariaBusy = String(waits);
      });
    });
    return () => { stop(); watcher.disconnect(); cancelAnimationFrame(request); };
  }, []);

  const handlers = useMemo(() => pointer(frameElement), []); // once: they remember what is dragged
  const found = clip.value;
  const shape = found ? { "--shape": found.width / found.height } : {};
  return (
    <div
      ref={frameElement} class="stage" style={shape} role="img"
      aria-label="The chosen images; the keys are listed below" {...handlers}>
      <canvas ref={canvas} id="canvas" />
      <canvas ref={overlay} class="overlay" />
      {panes.value.map((pane) => <Title pane={pane} />)}
      {isSplit() && <span class="divider" style={{ left: `${100 * split.value}%` }} />}
    </div>
  );
}

function Title({ pane }: { pane: Pane }) {
  const { ratio, width } = size.value;
  const place = pane.side === "left"
    ? { left: `${pane.box.x / ratio + 8}px` }
    : { right: `${(width - pane.box.x - pane.box.width) / ratio + 8}px` };
  arrived.value;
  const found = clip.value!;
  const absent = [pane.layer, pane.base].some(
    (layer) => layer && (!isThere(layer, frame.value) || isLost(found, layer, frame.value)));
  return (
    <span class="name" style={{ ...place, top: `${pane.box.y / ratio + 8}px`, maxWidth: `${pane.box.width / ratio / (isSplit() ? 2 : 1) - 16}px` }}>
      {pane.title}{absent ? ": not there for this frame" : ""}
    </span>
  );
}

function pointer(element: { current: HTMLDivElement | null }) {
  let grip: "divider" | "hand" | null = null;
  let last = { x: 0, y: 0 };
  const local = (event: MouseEvent) => {
    const box = element.current!.getBoundingClientRect();
    return { x: event.clientX - box.left, y: event.clientY - box.top, width: box.width };
  };
  /** The place in the image under the pointer, in image pixels. */
  const place = (event: MouseEvent) => {
    const now = seen();
    if (!now) return null;
    const { ratio } = size.value;
    const at = local(event);
    const [x, y] = [at.x * ratio, at.y * ratio];
    const inside = ({ box }: Pane) => x >= box.x && y >= box.y && x < box.x + box.width && y < box.y + box.height;
    const pane = panes.value.find(inside);
    if (!pane) return null;
    const origin = originOf(now, pane.box);
    return { x: origin.x + (x - pane.box.x) / now.zoom, y: origin.y + (y - pane.box.y) / now.zoom };
  };
  return {
    onPointerDown(event: PointerEvent) {
      const at = local(event);
      const near = isSplit() && Math.abs(at.x - split.value * at.width) <= GRIP;
      grip = near || (isSplit() && !part.value) ? "divider" : part.value ? "hand" : null;
      last = at;
      if (grip) element.current!.setPointerCapture(event.pointerId);
      if (grip === "divider") split.value = Math.min(1, Math.max(0, at.x / at.width));
      if (!grip && layout.value === "flip") flipped.value = !flipped.value;
    },
    onPointerMove(event: PointerEvent) {
      const at = local(event);
      if (grip === "divider") split.value = Math.min(1, Math.max(0, at.x / at.width));
      const now = seen();
      if (grip === "hand" && now) {
        const { ratio } = size.value;
        const moved = { ...now, x: now.x - ((at.x - last.x) * ratio) / now.zoom, y: now.y - ((at.y - last.y) * ratio) / now.zoom };
        part.value = within(moved, clip.value!, panes.value[0].box);
      }
      last = at;
      const found = clip.value;
      const spot = place(event);
      const [x, y] = spot ? [Math.floor(spot.x), Math.floor(spot.y)] : [-1, -1];
      const inside = found && x >= 0 && y >= 0 && x < found.width && y < found.height;
      hovered.value = inside ? { x, y } : null;
    },
    onPointerUp() { grip = null; },
    onPointerCancel() { grip = null; },
    onDblClick() { part.value = null; },
    onWheel(event: WheelEvent) {
      event.preventDefault();
      const at = place(event);
      if (at) zoomBy(2 ** (-event.deltaY / 240), at);
    },
  };
}
