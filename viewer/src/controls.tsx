// What is chosen with the pointer; keys.ts has the same for the keyboard.
import type { Signal } from "@preact/signals";
import { data, idOf, titleOf } from "./data";
import type { Layer } from "./data";
import {
  LAYOUTS, MODES, chooseClip, clip, clipIndex, frame, gain, layersOf, layout, leftId, mode, playing, position, rate,
  rightId, step, stops, vectors,
} from "./state";

const GROUPS: [Layer["group"], string][] = [
  ["image", "Images"], ["extra", "Other outputs"], ["channel", "Channels"], ["flip", "FLIP maps"],
];

export function Choice({ label, value, options }: { label: string; value: Signal<string>; options: [string, string][] }) {
  return (
    <label>{label}{" "}
      <select value={value.value} onChange={(event) => (value.value = event.currentTarget.value)}>
        {options.map(([key, text]) => <option value={key}>{text}</option>)}
      </select>
    </label>
  );
}

function LayerChoice({ label, value }: { label: string; value: Signal<string> }) {
  return (
    <label>{label}{" "}
      <select id={label.toLowerCase()} value={value.value} onChange={(event) => (value.value = event.currentTarget.value)}>
        {GROUPS.map(([group, title]) => layersOf(group).length > 0 && (
          <optgroup label={title}>
            {layersOf(group).map((layer) => <option value={idOf(layer)}>{titleOf(layer)}</option>)}
          </optgroup>
        ))}
      </select>
    </label>
  );
}

export function Choices() {
  const differs = mode.value === "difference" || mode.value === "signed";
  return (
    <div class="controls">
      {data.clips.length > 1 && (
        <label>Clip{" "}
          <select id="clip" value={clipIndex.value} onChange={(event) => chooseClip(Number(event.currentTarget.value))}>
            {data.clips.map((one, i) => <option value={i}>{one.name}</option>)}
          </select>
        </label>
      )}
      <LayerChoice label="Left" value={leftId} />
      <LayerChoice label="Right" value={rightId} />
      <Choice label="Layout" value={layout as Signal<string>} options={Object.entries(LAYOUTS)} />
      <Choice label="Show" value={mode as Signal<string>} options={Object.entries(MODES)} />
      {differs && (
        <label>Times{" "}
          <select id="gain" value={gain.value} onChange={(event) => (gain.value = Number(event.currentTarget.value))}>
            {[1, 2, 4, 8, 16, 32].map((factor) => <option>{factor}</option>)}
          </select>
        </label>
      )}
      <label>
        <input type="checkbox" checked={vectors.value} onChange={(event) => (vectors.value = event.currentTarget.checked)} />
        {" "}Arrows
      </label>
    </div>
  );
}

export function Transport() {
  const found = clip.value!;
  const last = Math.max(0, found.frames.length - 1);
  return (
    <div class="transport">
      <button onClick={() => step(-1)} aria-label="Previous frame" title="Previous frame (←)">‹</button>
      <button id="play" onClick={() => (playing.value = !playing.value)} title="Space">{playing.value ? "Stop" : "Play"}</button>
      <button onClick={() => step(1)} aria-label="Next frame" title="Next frame (→)">›</button>
      <label class="range">
        <span class="count" id="frame-number">Frame {frame.value}<small> of {found.count}</small></span>
        <input
          id="frame" type="range" min={0} max={last} value={position.value} disabled={!last}
          onInput={(event) => (position.value = Number(event.currentTarget.value))} />
      </label>
      <label title="Frames a second">
        <input
          class="number" type="number" min={1} max={60} value={rate.value}
          onChange={(event) => (rate.value = Math.min(60, Math.max(1, Number(event.currentTarget.value) || 12)))} /> fps
      </label>
      <label class="range exposure">
        <span class="count">Exposure {stops.value > 0 ? "+" : ""}{stops.value.toFixed(1)}</span>
        <input
          id="exposure" type="range" min={-8} max={8} step={0.25} value={stops.value} onDblClick={() => (stops.value = 0)}
          onInput={(event) => (stops.value = Number(event.currentTarget.value))} title="Stops; double-click: as it was" />
      </label>
    </div>
  );
}
