// Checks a model in Node against its test vectors: node check.mjs MODEL.onnx FOLDER

import { readFile } from "node:fs/promises";
import { join } from "node:path";
import * as ort from "onnxruntime-node";
import { Denoiser } from "./denoiser.mjs";
import { difference, readIndex, readTensors } from "./vectors.mjs";

process.on("uncaughtException", (error) => {
  console.error(error.message);
  process.exit(2);
});

const [model, folder] = process.argv.slice(2);
if (!folder) throw new Error("usage: node check.mjs MODEL.onnx FOLDER");

async function read(file) {
  const bytes = await readFile(join(folder, file));
  return bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
}

const bytes = await readFile(model);
const denoiser = await Denoiser.load(ort, bytes).catch((error) => {
  throw new Error(`${model}: ${error.message}`);
});
const { frames, tolerance } = await readIndex(read);
const ways = {
  "with the state of the files": (inputs) => denoiser.run(inputs),
  "with the state it keeps": (inputs) => denoiser.denoise(inputs, denoiser.outputs),
};
for (const [way, denoise] of Object.entries(ways)) {
  let [worst, where] = [0, "all are equal"];
  for (const [index, frame] of frames.entries()) {
    const made = await denoise(await readTensors(ort, frame.inputs, read));
    const expected = await readTensors(ort, frame.outputs, read);
    for (const [name, { data }] of Object.entries(expected)) {
      const found = difference(made[name].data, data);
      if (found > worst) [worst, where] = [found, `${name} of frame ${index}`];
    }
  }
  console.log(`${way}: ${frames.length} frames, largest difference ${worst.toExponential(1)} (${where})`);
  if (!(worst <= tolerance)) {
    console.log(`more than ${tolerance}`);
    process.exitCode = 1;
  }
}
