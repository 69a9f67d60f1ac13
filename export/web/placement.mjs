// Asks ONNX Runtime which operators of a model WebGPU leaves to the CPU. It tells only the console, whose functions it
// takes when it is loaded: so this is a worker with an ONNX Runtime of its own.
//
// Takes the content of an .onnx file; answers with the kinds of operators, in alphabetical order, that WebGPU takes
// nowhere in the model, or with the text of an error. Kinds that it takes elsewhere are left out: those that compute
// sizes are on the CPU on purpose.

const lines = [];
for (const kind of ["debug", "error", "info", "log", "warn"]) console[kind] = (...words) => lines.push(words.join(" "));

async function refused(bytes) {
  const ort = await import("./ort.webgpu.bundle.min.mjs");
  const options = { executionProviders: ["webgpu"], logSeverityLevel: 0, logVerbosityLevel: 0 };
  await ort.InferenceSession.create(bytes, options);
  const placed = {}; // provider → kinds
  let provider = "";
  for (const line of lines) {
    provider = /placed on \[(\w+)\]/.exec(line)?.[1] ?? provider;
    const kind = /VerifyEachNodeIsAssignedToAnEp\]\s+(\w+) \(/.exec(line)?.[1];
    if (kind) (placed[provider] ??= new Set()).add(kind);
  }
  const { WebGpuExecutionProvider: taken, CPUExecutionProvider: others = [] } = placed;
  if (!taken) throw new Error("ONNX Runtime's log does not tell where operators are");
  return [...others].filter((kind) => !taken.has(kind)).sort();
}

onmessage = ({ data }) => refused(data).then(postMessage, (error) => postMessage(error.message));
