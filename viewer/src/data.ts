// What Python writes into the page (nte.viewer.page, nte.viewer.recorder, nte.evaluation.report).

export type Shown =
  | "radiance" | "reflectance" | "direction" | "heat" | "labels" | "motion" | "picture" | "flip" | "kernel";
export type Group = "image" | "flip" | "extra" | "channel" | "kernel";

export interface Layer {
  key: string; // its folder
  group: Group;
  of: string; // a denoiser, "reference", "noisy input", or a channel
  channel: string; // the target, channel, extra or kernel that it shows
  shown: Shown;
  unit: string;
  components: string[]; // of a kernel: "" for each weight of the square, row by row, then names of further numbers
  every: number; // of a kernel: so many pixels of the image share one, along each axis
  scale: number; // the value that gets the full colour
  brightened: number;
  frames: number[] | null; // null: all of the clip's
}

export interface Clip {
  name: string;
  folder: string;
  width: number;
  height: number;
  frames: number[]; // those that have pixels, in order
  count: number; // frames of the clip itself
  chosen: number | null; // the frame to begin with
  exposure: number;
  notes: string[];
  layers: Layer[];
}

export interface Metric { name: string; label: string; better: "higher" | "lower" | ""; digits: number; curve: boolean }
export type Cell = [mean: number | null, low: number | null, high: number | null];
export interface Table {
  region: string;
  light: string;
  rows: Record<string, Record<string, Cell>>;
  best: Record<string, string[]>;
}
export interface Row {
  denoiser: string;
  clip: string;
  target: string;
  region: string;
  scored_from: number;
  per_frame: Record<string, (number | null)[]>;
  [metric: string]: unknown;
}
export interface Section { title: string; text: string; terms: [string, string][] }

export interface Data {
  version: string;
  folder: string;
  heat: Record<"viridis" | "magma", [number, number, number][]>;
  title: string;
  summary: string;
  notes: string[]; // warnings
  note: string; // how the frames were chosen
  clips: Clip[];
  rows: Row[];
  metrics: Metric[];
  tables: Table[];
  about: Section[];
}

export const data: Data = JSON.parse(document.getElementById("data")!.textContent!);

/** The same in every clip that has it, so that a choice survives a change of the clip. */
export const idOf = (layer: Layer) => `${layer.group}\n${layer.of}\n${layer.channel}`;

export function titleOf(layer: Layer): string {
  switch (layer.group) {
    case "image": return layer.channel === "color" ? layer.of : `${layer.of}, ${layer.channel}`;
    case "flip": return layer.channel === "color" ? `FLIP of ${layer.of}` : `FLIP of ${layer.of}, ${layer.channel}`;
    case "kernel":
    case "extra": return `${layer.channel} of ${layer.of}`;
    case "channel": return layer.channel;
  }
}

export const reasonable = (value: number | null | undefined, digits: number) =>
  value == null ? "–" : value.toFixed(digits);

export const denoisers = [...new Set([
  ...data.rows.map((row) => row.denoiser),
  ...data.clips.flatMap((clip) => clip.layers.filter((layer) => layer.group === "image").map((layer) => layer.of)),
])].filter((name) => name !== "reference" && name !== "noisy input");

/** Denoisers keep their colour and dash in every plot: eight colours, then dashed, then dotted. */
export const styleOf = (name: string) => {
  const i = denoisers.indexOf(name);
  return { colour: `--c${i % 8}`, dash: [[], [7, 3], [2, 3]][Math.floor(i / 8) % 3] };
};
