// Builds the viewer into one script and one style sheet, which nte puts into every page: node build.mjs [FOLDER]
import { createHash } from "node:crypto";
import { mkdirSync, readFileSync, readdirSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { build } from "esbuild";

const here = import.meta.dirname;
const out = process.argv[2] ?? join(here, "../nte/viewer/bundle");

// A test without Node compares this digest with that of the sources, so that a stale bundle is found everywhere.
function digest() {
  const sources = readdirSync(join(here, "src")).sort().map((name) => join("src", name));
  const hash = createHash("sha256");
  for (const name of ["build.mjs", "package-lock.json", ...sources]) hash.update(readFileSync(join(here, name)));
  return hash.digest("hex");
}

// The licences of what is bundled must come with it.
function licences() {
  const names = Object.keys(JSON.parse(readFileSync(join(here, "package.json"))).dependencies);
  const texts = [...names, "@preact/signals-core"].map((name) => {
    const folder = join(here, "node_modules", name);
    const { version } = JSON.parse(readFileSync(join(folder, "package.json")));
    return `${name} ${version}\n\n${readFileSync(join(folder, "LICENSE"), "utf8").trim()}\n`;
  });
  return `/*!\nThis script contains:\n\n${texts.join("\n")}*/\n`;
}

const { outputFiles } = await build({
  entryPoints: [join(here, "src/main.tsx")],
  bundle: true,
  minify: true,
  write: false,
  format: "iife",
  target: ["chrome110", "firefox115", "safari16.4"],
  jsx: "automatic",
  jsxImportSource: "preact",
  charset: "utf8",
  legalComments: "none",
  loader: { ".glsl": "text" },
  outdir: out,
});
mkdirSync(out, { recursive: true });
for (const file of outputFiles) {
  const css = file.path.endsWith(".css");
  const text = css ? file.text : `/* sources ${digest()} */\n${file.text}${licences()}`;
  writeFileSync(join(out, css ? "viewer.css" : "viewer.js"), text);
  console.log(`${css ? "viewer.css" : "viewer.js"}: ${(text.length / 1000).toFixed(1)} kB`);
}
