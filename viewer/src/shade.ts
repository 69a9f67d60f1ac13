// A layer as colours without WebGL: what shade.glsl computes, function by function.
import { data } from "./data";
import type { Shown } from "./data";
import { valueAt } from "./pixels";
import type { Pixels } from "./pixels";

export const SHOWN: Shown[] = ["radiance", "reflectance", "direction", "heat", "labels", "motion", "picture", "flip"];
export const OPERATIONS = ["value", "difference", "signed"] as const;
export type Operation = (typeof OPERATIONS)[number];

/** How a pane is drawn; the fields have the names of the shader's uniforms. */
export interface Look { shown: Shown; op: Operation; exposure: number; full: number; gain: number }

type Colour = [number, number, number];
const BAD: Colour = [1, 0, 1];
const clamp = (x: number, low = 0, high = 1) => Math.min(high, Math.max(low, x));
const each = (v: Colour, f: (x: number, i: number) => number): Colour => [f(v[0], 0), f(v[1], 1), f(v[2], 2)];
const mix = (a: Colour, b: Colour, t: number) => each(a, (x, i) => x + (b[i] - x) * t);

const encode = (x: number) => (x <= 0.0031308 ? 12.92 * x : 1.055 * x ** (1 / 2.4) - 0.055);

function display(x: number, exposure: number): number {
  const exposed = Math.min(Math.max(x, 0) * exposure, 1e30);
  return encode(exposed / (1 + exposed));
}

export function heat(t: number, table: "viridis" | "magma"): Colour {
  const colours = data.heat[table];
  const x = clamp(t) * (colours.length - 1);
  const i = Math.min(Math.floor(x), colours.length - 2);
  return each(mix(colours[i], colours[i + 1], x - i), (c) => c / 255);
}

function fromHsv(hue: number, saturation: number, value: number): Colour {
  return each([5, 3, 1], (n) => {
    const k = (((n + hue * 6) % 6) + 6) % 6;
    return value - value * saturation * clamp(Math.min(k, 4 - k));
  });
}

function picture(v: Colour, grey: boolean, { shown, exposure, full, gain }: Look): Colour {
  switch (shown) {
    case "radiance": return each(v, (x) => display(x, exposure));
    case "reflectance": return each(v, (x) => clamp(x));
    case "direction": return each(v, (x) => clamp(x / full / 2 + 0.5));
    case "heat": return heat((grey ? Math.abs(v[0]) : Math.hypot(...v)) / full, "viridis");
    case "labels": {
      const hashed = Math.imul(Math.max(v[0], 0), 2654435769) >>> 0;
      return fromHsv((hashed >>> 8) / 16777216, 0.65, v[0] === 0 ? 0 : 0.6 + (0.4 * (hashed & 255)) / 255);
    }
    case "motion": return fromHsv(Math.atan2(v[1], v[0]) / (2 * Math.PI), Math.min(Math.hypot(v[0], v[1]) / full, 1), 1);
    case "picture": return v;
    case "kernel": return BAD; // is never in sight
    case "flip": return heat(v[0] * gain, "magma");
  }
}

function level(x: number, { shown, exposure, full }: Look): number {
  if (shown === "radiance") return display(x, exposure);
  return shown === "reflectance" || shown === "picture" || shown === "flip" ? x : x / full;
}

function signedColour(t: number): Colour {
  const x = clamp(t, -1, 1);
  return mix([0.07, 0.07, 0.07], x > 0 ? [0.86, 0.16, 0.11] : [0.1, 0.38, 0.9], Math.abs(x));
}

function fetched(pixels: Pixels, x: number, y: number): Colour {
  const count = pixels.components; // a single component is grey
  return each([0, 1, 2], (c) => (count === 1 ? valueAt(pixels, x, y, 0) : c < count ? valueAt(pixels, x, y, c) : 0));
}

/** The colour of a pixel, in [0, 1]. base: what it is compared with, unless the operation is "value". */
export function shade(image: Pixels, base: Pixels | undefined, x: number, y: number, look: Look): Colour {
  const ours = fetched(image, x, y);
  if (!ours.every(Number.isFinite)) return BAD;
  if (look.op === "value" || !base) return picture(ours, image.components === 1, look);
  const theirs = fetched(base, x, y);
  if (!theirs.every(Number.isFinite)) return BAD;
  const d = each(ours, (v, i) => level(v, look) - level(theirs[i], look));
  return look.op === "difference"
    ? each(d, (v) => clamp(Math.abs(v) * look.gain))
    : signedColour(((d[0] + d[1] + d[2]) / (image.components === 2 ? 2 : 3)) * look.gain);
}
