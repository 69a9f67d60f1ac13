// Means over clips with their intervals; a click on a column sorts by it.
import { computed, signal } from "@preact/signals";
import { Choice } from "./controls";
import { data, reasonable } from "./data";
import type { Cell, Metric, Table } from "./data";

const chosen = signal("0"); // the table
const ofClip = signal(""); // "" for the mean over clips
const order = signal<{ by: string; down: boolean } | null>(null); // null: as typed
const clips = [...new Set(data.rows.map((row) => row.clip))];

const nameOf = ({ region, light }: Table) => (light ? `${region}, ${light === "own" ? "own light" : light}` : region);

/** The same table for one clip: numbers of its rows, without intervals. */
const table = computed<Table | null>(() => {
  const means = data.tables[Number(chosen.value)];
  if (!means || !ofClip.value) return means ?? null;
  const own = data.rows.filter((row) => row.clip === ofClip.value && row.region === means.region);
  const rows = Object.fromEntries(Object.entries(means.rows).flatMap(([name, cells]) => {
    const row = own.find((one) => one.denoiser === name && (["", "own"].includes(means.light) || one.target === means.light));
    return row ? [[name, Object.fromEntries(Object.keys(cells).map((m) => [m, [row[m] ?? null, null, null] as Cell]))]] : [];
  }));
  return { ...means, rows, best: {} };
});

function sort(metric: Metric | null) {
  const by = metric?.name ?? "";
  const first = metric?.better === "higher"; // the best comes first
  order.value = order.value?.by === by ? { by, down: !order.value.down } : { by, down: first };
}

function sorted({ rows }: Table): [string, Record<string, Cell>][] {
  const entries = Object.entries(rows);
  if (!order.value) return entries;
  const { by, down } = order.value;
  const sign = down ? -1 : 1;
  return entries.sort(([a, one], [b, other]) => {
    if (!by) return sign * a.localeCompare(b);
    const [x, y] = [one[by]?.[0], other[by]?.[0]];
    return x == null || y == null ? Number(x == null) - Number(y == null) : sign * (x - y); // what is not there, last
  });
}

export function TablesSection() {
  const found = table.value;
  if (!found) return null;
  const metrics = data.metrics.filter((metric) => Object.values(found.rows).some((cells) => cells[metric.name]));
  const direction = (by: string) => order.value?.by === by ? (order.value.down ? "descending" : "ascending") : "none";
  return (
    <section id="means">
      <h2>Means</h2>
      <div class="controls">
        {data.tables.length > 1 && <Choice label="Pixels" value={chosen} options={data.tables.map((one, i) => [String(i), nameOf(one)])} />}
        {clips.length > 1 && <Choice label="Clip" value={ofClip} options={[["", `mean of ${clips.length}`], ...clips.map((name) => [name, name] as [string, string])]} />}
      </div>
      <div class="scroll" tabIndex={0} role="region" aria-label="Means">
        <table>
          <thead><tr>
            <th scope="col" aria-sort={direction("")}><button onClick={() => sort(null)}>Denoiser</button></th>
            {metrics.map((metric) => (
              <th scope="col" aria-sort={direction(metric.name)}>
                <button onClick={() => sort(metric)} title={metric.better ? `${metric.better} is better` : undefined}>
                  {metric.label}{metric.better && ` ${metric.better === "higher" ? "↑" : "↓"}`}
                </button>
              </th>
            ))}
          </tr></thead>
          <tbody>
            {sorted(found).map(([name, cells]) => (
              <tr key={name}>
                <th scope="row">{name}</th>
                {metrics.map((metric) => (
                  <Value cell={cells[metric.name]} metric={metric} best={found.best[metric.name]?.includes(name) ?? false} />
                ))}
              </tr>
            ))}
          </tbody>
        </table>
      </div>
      <p class="note">The best of each column is bold. Brackets: the interval of 95 % over clips. Click a heading to sort.</p>
    </section>
  );
}

function Value({ cell, metric, best }: { cell?: Cell; metric: Metric; best: boolean }) {
  const [mean, low, high] = cell ?? [null, null, null];
  const text = reasonable(mean, metric.digits);
  return (
    <td>
      {best ? <strong title="best">{text}</strong> : text}
      {low != null && <small class="interval">{low.toFixed(metric.digits)} … {high!.toFixed(metric.digits)}</small>}
    </td>
  );
}
