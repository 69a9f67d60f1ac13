// Plays a clip noisy and denoised side by side. Everything it loads lies beside it: prepare.py puts it there.

import { Denoiser } from "./denoiser.mjs";
import * as ort from "./ort.webgpu.bundle.min.mjs";
import { difference, readIndex, readTensors } from "./vectors.mjs";

ort.env.logLevel = "error"; // it warns that WebGPU leaves the arithmetic of sizes to the CPU

const FRAME_TIME = 100; // milliseconds that a frame is shown at least

const element = (id) => document.getElementById(id);

async function read(file) {
  const answer = await fetch(`clip/${file}`);
  if (!answer.ok) throw new Error(`clip/${file}: ${answer.status} ${answer.statusText}`);
  return answer.arrayBuffer();
}

/** Load the model for the first provider that takes it; resolve to it and to the provider's name. */
async function load() {
  const bytes = new Uint8Array(await (await fetch("model.onnx")).arrayBuffer());
  if (await navigator.gpu?.requestAdapter()) {
    try {
      const options = { executionProviders: ["webgpu"], logSeverityLevel: 3 };
      return [await Denoiser.load(ort, bytes, options, "gpu-buffer"), "WebGPU"];
    } catch (error) {
      console.info(`WebGPU does not take the model: ${error.message}`);
    }
  }
  return [await Denoiser.load(ort, bytes, { executionProviders: ["wasm"] }), "WebAssembly"];
}

/** Draw linear light (1, 3, H, W): exposed, compressed by x / (1 + x), in sRGB. */
function draw(canvas, { data, dims }, exposure) {
  const [, , height, width] = dims;
  [canvas.width, canvas.height] = [width, height];
  const pixels = new ImageData(width, height);
  const area = width * height;
  for (let i = 0; i < area; i++) {
    for (let component = 0; component < 3; component++) {
      const light = Math.max(0, data[component * area + i] * exposure) || 0; // NaN is black
      const shown = light === Infinity ? 1 : light / (1 + light);
      const encoded = shown <= 0.0031308 ? 12.92 * shown : 1.055 * shown ** (1 / 2.4) - 0.055;
      pixels.data[4 * i + component] = 255 * encoded;
    }
    pixels.data[4 * i + 3] = 255;
  }
  canvas.getContext("2d").putImageData(pixels, 0, 0);
}

async function main() {
  const [denoiser, provider] = await load();
  const { frames } = await readIndex(read);
  const noisy = denoiser.description.target;
  const times = [];
  let [shown, worst, playing] = [0, 0, true];

  async function show(index) {
    if (index === 0) denoiser.reset();
    const inputs = await readTensors(ort, frames[index].inputs, read);
    const start = performance.now();
    const { image } = await denoiser.denoise(inputs);
    const time = performance.now() - start;
    if (shown > 0) times.push(time); // the first run prepares the graph
    const expected = await readTensors(ort, { image: frames[index].outputs.image }, read);
    worst = Math.max(worst, difference(image.data, expected.image.data));
    const exposure = inputs.exposure?.data[0] ?? 1;
    draw(element("noisy"), inputs[noisy], exposure);
    draw(element("denoised"), image, exposure);
    shown++;
    report(index, time);
  }

  function report(index, time) {
    const median = times.toSorted((a, b) => a - b)[times.length >> 1];
    const usual = median === undefined ? "" : `, ${median.toFixed(1)} in the median`;
    const [, , height, width] = frames[index].inputs[noisy].shape;
    element("says").value = [
      `frame ${index + 1} of ${frames.length}, ${width}×${height}`,
      `${provider}: ${time.toFixed(1)} ms per frame${usual}`,
      `largest difference from ONNX Runtime in Python: ${worst.toExponential(1)}`,
    ].join("\n");
    Object.assign(document.body.dataset, { shown, index, provider, worst, time });
  }

  const ask = element("ask");
  ask.hidden = provider !== "WebGPU";
  ask.onclick = async () => {
    ask.disabled = true;
    const worker = new Worker("placement.mjs", { type: "module" });
    worker.onmessage = ({ data }) => {
      element("refused").value = Array.isArray(data) ? data.join(", ") || "none" : data;
      worker.terminate();
    };
    worker.postMessage(new Uint8Array(await (await fetch("model.onnx")).arrayBuffer()));
  };
  const button = element("play");
  button.disabled = false;
  button.onclick = () => {
    playing = !playing;
    button.textContent = playing ? "Pause" : "Play";
  };
  for (let index = 0; ; index = playing ? (index + 1) % frames.length : index) {
    const pause = new Promise((done) => setTimeout(done, FRAME_TIME));
    if (playing) await show(index);
    await pause;
  }
}

main().catch((error) => {
  element("says").value = error.message;
  throw error;
});
