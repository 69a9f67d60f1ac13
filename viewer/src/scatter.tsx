// Quality against time: what a millisecond buys.
import { signal } from "@preact/signals";
import { Choice } from "./controls";
import { data, styleOf } from "./data";

const metric = signal("psnr");
const WIDTH = 720, HEIGHT = 340, LEFT = 58, RIGHT = 20, TOP = 16, BOTTOM = 40;

interface Point { name: string; x: number; y: number; low: number | null; high: number | null }

function points(): Point[] {
  return Object.entries(data.tables[0]?.rows ?? {}).flatMap(([name, cells]) => {
    const [x, cell] = [cells.ms_per_frame?.[0], cells[metric.value]];
    return x && cell?.[0] != null ? [{ name, x, y: cell[0], low: cell[1], high: cell[2] }] : [];
  });
}

export function ScatterSection() {
  const found = points();
  const offered = data.metrics.filter((one) => one.better);
  const shown = offered.find((one) => one.name === metric.value);
  if (found.length < 2 || !shown) return null;
  const logs = found.map(({ x }) => Math.log10(Math.max(x, 1e-3)));
  const [from, to] = [Math.min(...logs) - 0.15, Math.max(...logs) + 0.35];
  const values = found.flatMap(({ y, low, high }) => [y, low ?? y, high ?? y]);
  const spread = Math.max(...values) - Math.min(...values) || 1;
  const [bottom, top] = [Math.min(...values) - spread * 0.08, Math.max(...values) + spread * 0.08];
  const x = (log: number) => LEFT + ((log - from) / (to - from)) * (WIDTH - LEFT - RIGHT);
  const y = (value: number) => HEIGHT - BOTTOM - ((value - bottom) / (top - bottom)) * (HEIGHT - TOP - BOTTOM);
  return (
    <section id="scatter">
      <h2>Quality against time</h2>
      <div class="controls">
        <Choice label="Quality" value={metric} options={offered.map((one) => [one.name, one.label])} />
      </div>
      <svg class="scatter" viewBox={`0 0 ${WIDTH} ${HEIGHT}`} role="img" aria-label={`${shown.label} against milliseconds for each frame`}>
        {ticks(bottom, top, 5).map((value) => (
          <g><line class="grid" x1={LEFT} x2={WIDTH - RIGHT} y1={y(value)} y2={y(value)} />
            <text x={LEFT - 8} y={y(value) + 4} text-anchor="end">{Number(value.toPrecision(4))}</text></g>
        ))}
        {times(from, to).map((value) => (
          <g><line class="grid" x1={x(Math.log10(value))} x2={x(Math.log10(value))} y1={TOP} y2={HEIGHT - BOTTOM} />
            <text x={x(Math.log10(value))} y={HEIGHT - BOTTOM + 18} text-anchor="middle">{value}</text></g>
        ))}
        <text x={WIDTH - RIGHT} y={HEIGHT - 4} text-anchor="end">ms/frame on this machine</text>
        {labelled(found, logs.map(x), found.map((one) => y(one.y))).map(({ point, px, py, at }) => {
          const colour = `var(${styleOf(point.name).colour})`;
          const near = px > WIDTH - 170;
          return (
            <g>
              {point.low != null && <line x1={px} x2={px} y1={y(point.low)} y2={y(point.high!)} stroke={colour} />}
              <circle cx={px} cy={py} r="5" fill={colour}><title>{`${point.name}: ${point.y.toFixed(shown.digits)}, ${point.x.toFixed(1)} ms`}</title></circle>
              <text class="label" x={px + (near ? -9 : 9)} y={at + 4} text-anchor={near ? "end" : "start"}>{shortened(point.name)}</text>
            </g>
          );
        })}
      </svg>
      <p class="note">{shown.better === "higher" ? "Up" : "Down"} and to the left is better. Bars: the interval of 95 % over clips.</p>
    </section>
  );
}

const shortened = (name: string) => (name.length > 28 ? `${name.slice(0, 12)}…${name.slice(-14)}` : name);

/** Labels move down until they are clear of each other. */
function labelled(found: Point[], xs: number[], ys: number[]) {
  const placed: { px: number; at: number }[] = [];
  return found.map((point, i) => ({ point, px: xs[i], py: ys[i], at: ys[i] }))
    .sort((a, b) => a.py - b.py)
    .map((one) => {
      while (placed.some((other) => Math.abs(other.px - one.px) < 150 && Math.abs(other.at - one.at) < 14)) one.at += 3;
      placed.push(one);
      return one;
    });
}

function ticks(low: number, high: number, count: number): number[] {
  const rough = (high - low) / count;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((factor) => factor * power).find((one) => one >= rough)!;
  const first = Math.ceil(low / step);
  return Array.from({ length: Math.max(0, Math.floor(high / step) - first + 1) }, (_, i) => (first + i) * step);
}

function times(from: number, to: number): number[] {
  const every = to - from > 2.5 ? [1] : [1, 2, 5];
  const found: number[] = [];
  for (let power = Math.floor(from); power <= to; power++) {
    found.push(...every.map((factor) => Number((factor * 10 ** power).toPrecision(1))));
  }
  return found.filter((value) => Math.log10(value) >= from && Math.log10(value) <= to);
}
