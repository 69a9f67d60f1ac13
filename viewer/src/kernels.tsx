// The kernels that a network applied at the pixel under the pointer: squares of weights, each where it was read.
import type { Layer } from "./data";
import { text } from "./numbers";
import { arrived, isComing, isLost, isThere, load, peek, valueAt } from "./pixels";
import type { Pixels } from "./pixels";
import { heat } from "./shade";
import { clip, frame, goTo, hovered, inSight, layersOf } from "./state";

export function Kernels() {
  const found = clip.value!;
  arrived.value;
  const layers = layersOf("kernel").filter((layer) => inSight.value.some(({ of }) => of === layer.of));
  if (!layers.length) return <p class="note">No image in sight is of a network that predicts kernels.</p>;
  const there = layers.filter((layer) => isThere(layer, frame.value) && !isLost(found, layer, frame.value));
  if (!there.length) return <Elsewhere layer={layers[0]} />;
  for (const layer of there) void load(found, layer, frame.value);
  return (
    <>
      <div class="kernels">{there.map((layer) => <Kernel key={layer.key} layer={layer} />)}</div>
      <p class="note">
        Weights of the pixels around this one, before light and history are blended; the pixel itself is framed.
      </p>
    </>
  );
}

function Elsewhere({ layer }: { layer: Layer }) {
  const kept = layer.frames ?? clip.value!.frames;
  const [first, last] = [kept[0], kept[kept.length - 1]];
  return (
    <p class="note">
      Kernels are large, and kept of {first === last ? `frame ${first}` : `frames ${first} to ${last}`} only.{" "}
      <button onClick={() => goTo(first)}>Go there</button>
    </p>
  );
}

function Kernel({ layer }: { layer: Layer }) {
  const pixels = peek(clip.value!, layer, frame.value);
  const square = layer.components.filter((name) => !name).length;
  const side = Math.sqrt(square);
  const at = hovered.value;
  arrived.value;
  const value = (i: number) => (pixels && at ? weight(pixels, layer, at, i) : null);
  const weights = Array.from({ length: square }, (_, i) => value(i));
  const most = Math.max(...weights.map((one) => one ?? 0)) || 1;
  return (
    <figure class="kernel" data-kernel={`${layer.channel} of ${layer.of}`} aria-busy={isComing(clip.value!, layer, frame.value)}>
      <figcaption title={layer.of}>{layer.channel}<small> {layer.of}</small></figcaption>
      <table>
        <tbody>
          {Array.from({ length: side }, (_, y) => (
            <tr>{weights.slice(y * side, (y + 1) * side).map((one, x) => (
              <Weight value={one} most={most} middle={2 * y === side - 1 && 2 * x === side - 1} />
            ))}</tr>
          ))}
        </tbody>
      </table>
      <p>{layer.components.slice(square).map((name, i) => {
        const one = value(square + i);
        return <span data-name={name}><small>{name}</small> {one === null ? "–" : text(Number(one.toPrecision(3)))}</span>;
      })}</p>
    </figure>
  );
}

function weight(pixels: Pixels, { every }: Layer, at: { x: number; y: number }, i: number): number {
  return valueAt(pixels, Math.floor(at.x / every), Math.floor(at.y / every), i);
}

function Weight({ value, most, middle }: { value: number | null; most: number; middle: boolean }) {
  const colour = heat((value ?? 0) / most, "viridis");
  const bright = 0.3 * colour[0] + 0.6 * colour[1] + 0.1 * colour[2] > 0.5;
  const style = { background: `rgb(${colour.map((level) => Math.round(level * 255)).join(" ")})`, color: bright ? "#000" : "#fff" };
  return (
    <td class={middle ? "middle" : ""} style={style} title={value === null ? "" : text(value)}>
      {value === null ? "" : value.toFixed(3).replace(/^0/, "")}
    </td>
  );
}
