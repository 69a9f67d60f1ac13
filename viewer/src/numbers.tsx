// The numbers of the pixel under the pointer: linear values as the file has them, before exposure.
import { data, titleOf } from "./data";
import type { Layer } from "./data";
import { Kernels } from "./kernels";
import { arrived, isThere, load, peek, valueAt } from "./pixels";
import { clip, everyChannel, frame, hovered, inSight, layersOf, withKernels } from "./state";

export function Numbers() {
  const found = clip.value!;
  const spot = hovered.value;
  const all = everyChannel.value;
  arrived.value;
  const layers = all ? found.layers.filter((layer) => layer.group !== "kernel") : inSight.value;
  if (all) for (const layer of layers) void load(found, layer, frame.value);
  return (
    <section class="numbers" aria-label="Values of the pixel">
      <p>
        <b id="pixel">{spot ? `x ${spot.x}, y ${spot.y}` : "Point at a pixel"}</b>
        <label>
          <input type="checkbox" checked={all} onChange={(event) => (everyChannel.value = event.currentTarget.checked)} />
          {" "}every channel
        </label>
        {layersOf("kernel").length > 0 && (
          <label>
            <input
              id="with-kernels" type="checkbox" checked={withKernels.value}
              onChange={(event) => (withKernels.value = event.currentTarget.checked)} />
            {" "}kernels
          </label>
        )}
      </p>
      <table>
        <tbody>
          {layers.map((layer) => (
            <tr data-layer={titleOf(layer)}>
              <th scope="row">{titleOf(layer)}</th>
              {values(layer, spot).map((value, i) => <td><small>{layer.components[i]}</small> {value}</td>)}
              <td class="unit">{unitOf(layer)}</td>
            </tr>
          ))}
        </tbody>
      </table>
      {withKernels.value && <Kernels />}
    </section>
  );
}

function values(layer: Layer, spot: { x: number; y: number } | null): string[] {
  const pixels = peek(clip.value!, layer, frame.value);
  if (!spot || !isThere(layer, frame.value)) return layer.components.map(() => "–");
  if (!pixels) return layer.components.map(() => "…");
  return layer.components.map((_, c) => text(valueAt(pixels, spot.x, spot.y, c)));
}

/** Seven digits: as many as a float has, and more than a half float. */
export function text(value: number): string {
  if (!Number.isFinite(value)) return String(value).replace("Infinity", "∞");
  return String(Number(value.toPrecision(7))).replace("-", "−");
}

const unitOf = (layer: Layer) =>
  layer.shown === "picture" ? "8 bits, as displayed" : layer.unit.replace(/^(1(, )?|radiance)/, "");

export function Notes() {
  const notes = [...data.notes, ...(clip.value?.notes ?? [])];
  return notes.length ? <ul class="notes">{notes.map((note) => <li>{note}</li>)}</ul> : null;
}
