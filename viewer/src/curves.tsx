// Every metric over the frames of a clip, a curve for each denoiser; the frame in sight and the hovered one are marked.
import { computed, signal } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import uPlot from "uplot";
import { Choice } from "./controls";
import { data, denoisers, styleOf } from "./data";
import type { Metric } from "./data";
import { clip, frame, goTo, hoveredFrame } from "./state";

const MEAN = "";
const region = signal("all");
const light = signal(data.rows[0]?.target ?? "color");
const whose = signal("shown"); // the clip that is shown, or the mean of all
const regions = [...new Set(data.rows.map((row) => row.region))];
const lights = [...new Set(data.rows.map((row) => row.target))];
const several = new Set(data.rows.map((row) => row.clip)).size > 1;
const HEIGHT = 170;
const FLOOR = "temporal_l1_floor"; // drawn with temporal_l1

type Values = (number | null)[];
interface Curves { frames: number[]; series: { name: string; values: Values }[] }

const chosen = computed(() => (whose.value === "shown" ? clip.value?.name ?? MEAN : MEAN));

function curvesOf(metric: string): Curves {
  const rows = data.rows.filter((row) =>
    row.region === region.value && row.target === light.value && (chosen.value === MEAN || row.clip === chosen.value));
  const ends = rows.map((row) => row.scored_from + (row.per_frame[metric]?.length ?? 0));
  const start = Math.min(...rows.map((row) => row.scored_from), Infinity);
  if (!rows.length || !Number.isFinite(start)) return { frames: [], series: [] };
  const frames = Array.from({ length: Math.max(...ends) - start }, (_, i) => start + i);
  const mean = (name: string, key: string) => {
    const own = rows.filter((row) => row.denoiser === name);
    return frames.map((index) => {
      const values = own.map((row) => row.per_frame[key]?.[index - row.scored_from]).filter((value) => value != null);
      return values.length ? values.reduce((a, b) => a + b, 0) / values.length : null;
    });
  };
  const names = denoisers.filter((name) => rows.some((row) => row.denoiser === name));
  const series = names.map((name) => ({ name, values: mean(name, metric) }));
  if (metric === "temporal_l1" && names.length) {
    const floor = mean(names[0], FLOOR);
    if (floor.some((value) => value !== null)) series.push({ name: "floor", values: floor });
  }
  return { frames, series };
}

const css = (name: string) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const dark = matchMedia("(prefers-color-scheme: dark)");

function options({ series }: Curves, width: number): uPlot.Options {
  const axis = { stroke: css("--soft"), grid: { stroke: css("--line"), width: 1 }, ticks: { show: false }, font: "11px sans-serif" };
  return {
    width,
    height: HEIGHT,
    legend: { show: false },
    cursor: { sync: { key: "frames" }, y: false, drag: { x: false, y: false }, points: { size: 6 } },
    scales: { x: { time: false } },
    axes: [
      { ...axis, size: 26, incrs: [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000] },
      { ...axis, size: 52, values: (_, splits) => splits.map((value) => Number(value.toPrecision(4)).toString()) },
    ],
    series: [
      {},
      ...series.map(({ name }) => name === "floor"
        ? { stroke: css("--soft"), dash: [2, 4], width: 1 }
        : { stroke: css(styleOf(name).colour), dash: styleOf(name).dash, width: 1.6, points: { size: 4 } }),
    ],
    hooks: {
      draw: [(plot) => {
        const marks = [[frame.peek(), css("--ink"), 1]] as [number, string, number][];
        if (hoveredFrame.peek() !== null) marks.push([hoveredFrame.peek()!, css("--accent"), 1]);
        const { ctx, bbox } = plot;
        ctx.save();
        for (const [index, colour, wide] of marks) {
          const x = Math.round(plot.valToPos(index, "x", true)) + 0.5;
          if (x < bbox.left || x > bbox.left + bbox.width) continue;
          ctx.strokeStyle = colour;
          ctx.lineWidth = wide;
          ctx.beginPath();
          ctx.moveTo(x, bbox.top);
          ctx.lineTo(x, bbox.top + bbox.height);
          ctx.stroke();
        }
        ctx.restore();
      }],
      setCursor: [(plot) => {
        const at = plot.cursor.idx;
        hoveredFrame.value = at == null || plot.cursor.left! < 0 ? null : plot.data[0][at];
      }],
    },
  };
}

function Plot({ metric }: { metric: Metric }) {
  const place = useRef<HTMLDivElement>(null);
  const plot = useRef<uPlot | null>(null);
  const curves = curvesOf(metric.name);
  useEffect(() => {
    const make = () => {
      plot.current?.destroy();
      const columns = [curves.frames, ...curves.series.map(({ values }) => values)] as uPlot.AlignedData;
      plot.current = new uPlot(options(curves, place.current!.clientWidth), columns, place.current!);
      plot.current.over.addEventListener("click", () => {
        if (hoveredFrame.peek() !== null) goTo(hoveredFrame.peek()!);
      });
    };
    make();
    const watcher = new ResizeObserver(() => plot.current?.setSize({ width: place.current!.clientWidth, height: HEIGHT }));
    watcher.observe(place.current!);
    dark.addEventListener("change", make);
    return () => { watcher.disconnect(); dark.removeEventListener("change", make); plot.current?.destroy(); };
  }, [chosen.value, region.value, light.value]);
  const marked = [frame.value, hoveredFrame.value];
  useEffect(() => plot.current?.redraw(false), marked);
  const at = curves.frames.indexOf(hoveredFrame.value ?? frame.value);
  return (
    <figure class="plot" data-metric={metric.name}>
      <figcaption>
        {metric.label}{metric.better && <small> {metric.better === "higher" ? "↑" : "↓"}</small>}
        <span class="read">
          {at >= 0 && curves.series.map(({ name, values }) => name !== "floor" && values[at] != null && (
            <span style={{ color: `var(${styleOf(name).colour})` }} title={name}>{values[at]!.toFixed(metric.digits)}</span>
          ))}
        </span>
      </figcaption>
      <div ref={place} />
    </figure>
  );
}

export function CurvesSection() {
  const plotted = data.metrics.filter((metric) =>
    metric.curve && data.rows.some((row) => row.per_frame[metric.name]?.some((value) => value != null)));
  if (!plotted.length) return null;
  return (
    <section id="curves">
      <h2>Frame by frame</h2>
      <div class="controls">
        {several && <Choice label="Clip" value={whose} options={[["shown", "the one shown"], ["all", "mean of all clips"]]} />}
        {regions.length > 1 && <Choice label="Region" value={region} options={regions.map((name) => [name, name])} />}
        {lights.length > 1 && <Choice label="Light" value={light} options={lights.map((name) => [name, name])} />}
      </div>
      <ul class="names">
        {denoisers.filter((name) => data.rows.some((row) => row.denoiser === name)).map((name) => (
          <li>
            <svg width="30" height="8"><line x1="0" x2="30" y1="4" y2="4" stroke={`var(${styleOf(name).colour})`} stroke-width="2" stroke-dasharray={styleOf(name).dash.join(" ")} /></svg>
            {name}
          </li>
        ))}
        {data.rows.some((row) => row[FLOOR] != null) && (
          <li><svg width="30" height="8"><line x1="0" x2="30" y1="4" y2="4" stroke="var(--soft)" stroke-dasharray="2 4" /></svg>
            what the reference's own noise sets</li>
        )}
      </ul>
      <p class="note">The dark line is the frame that is shown. Click to go to another.</p>
      <div class="plots">{plotted.map((metric) => <Plot key={metric.name} metric={metric} />)}</div>
    </section>
  );
}
