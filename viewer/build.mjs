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

// The licences of what is bundled must come with it: in the script, which goes into every page, and in a file of their own.
// The packages are those of which esbuild has put any bytes into the bundle.
function licences({ outputs }) {
  const inputs = Object.values(outputs).flatMap(({ inputs }) => Object.entries(inputs));
  const paths = inputs.filter(([, { bytesInOutput }]) => bytesInOutput > 0).map(([path]) => path);
  const names = paths.map((path) => path.match(/.*node_modules\/((?:@[^/]+\/)?[^/]+)\//)?.[1]).filter(Boolean);
  return [...new Set(names)].sort().map((name) => {
    const folder = join(here, "node_modules", name);
    const { version, license } = JSON.parse(readFileSync(join(folder, "package.json")));
    return `${name} ${version}\nLicence: ${license}\n\n${readFileSync(join(folder, "LICENSE"), "utf8").trim()}\n`;
  }).join("\n");
}

const { outputFiles, metafile } = await build({
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
  metafile: true,
  loader: { ".glsl": "text" },
  outdir: out,
});
const contained = licences(metafile);
const script = outputFiles.find(({ path }) => path.endsWith(".js")).text;
const made = {
  "viewer.js": `/* sources ${digest()} */\n${script}/*!\nThis script contains:\n\n${contained}*/\n`,
  "viewer.css": outputFiles.find(({ path }) => path.endsWith(".css")).text,
  "THIRD_PARTY_LICENSES.txt": `viewer.js and viewer.css, which are put into every page, contain:\n\n${contained}`,
};
mkdirSync(out, { recursive: true });
for (const [name, text] of Object.entries(made)) {
  writeFileSync(join(out, name), text);
  console.log(`${name}: ${(text.length / 1000).toFixed(1)} kB`);
}
