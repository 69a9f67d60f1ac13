// What the colours in sight mean.
import { data } from "./data";
import type { Layer } from "./data";
import { gain, left, mode, right, stops } from "./state";

const round = (value: number) => Number(value.toPrecision(3)).toString();

function ramp(table: "viridis" | "magma") {
  return `linear-gradient(to right, ${data.heat[table].map((colour) => `rgb(${colour.join(" ")})`).join(", ")})`;
}

function Scale({ low, high, image, text }: { low: string; high: string; image: string; text: string }) {
  return <span class="scale">{low} <i style={{ backgroundImage: image }} /> {high}{text && ` ${text}`}</span>;
}

export function Legend() {
  const factor = 2 ** stops.value;
  if (mode.value === "signed") {
    const most = round(1 / gain.value);
    return (
      <p class="legend">
        <Scale
          low={`−${most}, darker than the reference`} high={`+${most}, brighter`} text=""
          image="linear-gradient(to right, rgb(26 97 230), rgb(18 18 18), rgb(219 41 28))" />
      </p>
    );
  }
  if (mode.value === "difference") return <p class="legend">|left − right| of what is displayed, {gain.value} times.</p>;
  const shown = [...new Set([left.value, right.value])].filter((layer) => layer !== null);
  const kinds = shown.map((layer) => scaleOf(layer, factor)).filter((scale) => scale !== null);
  const flip = mode.value === "flip" && (
    <Scale low="0" high={round(Math.min(1, 1 / factor))} image={ramp("magma")} text="FLIP: the darker, the closer to the reference" />);
  return kinds.length || flip ? <p class="legend">{flip}{kinds}</p> : null;
}

function scaleOf(layer: Layer, factor: number) {
  const unit = layer.unit.startsWith("1") ? "" : layer.unit.split(",")[0];
  const most = round(layer.scale / factor);
  switch (layer.shown) {
    case "heat": return <Scale low="0" high={most} image={ramp("viridis")} text={`${unit} (${layer.channel})`} />;
    case "flip": return <Scale low="0" high={round(1 / factor)} image={ramp("magma")} text="FLIP" />;
    case "motion":
      return <span class="scale"><i class="wheel" /> hue: direction; full colour: {most} {unit || "px"} ({layer.channel})</span>;
    default: return null;
  }
}
