// Test vectors of a model (nte export --vectors): their reading, and the comparison with what a port makes.

/** Read vectors.json. read: a function from a file's name to a promise of its bytes as an ArrayBuffer. */
export async function readIndex(read) {
  return JSON.parse(new TextDecoder().decode(await read("vectors.json")));
}

/** Read some tensors. listed: name → {file, shape}, the inputs or outputs of a frame in vectors.json. */
export async function readTensors(ort, listed, read) {
  const entries = Object.entries(listed).map(async ([name, { file, shape }]) => {
    const values = new Float32Array(await read(file)); // little-endian, as all machines that run this
    return [name, new ort.Tensor("float32", values, shape)];
  });
  return Object.fromEntries(await Promise.all(entries));
}

/** Return the largest |a − b| / (|b| + 0.01); infinite where an a is no number. */
export function difference(found, expected) {
  if (found.length !== expected.length) return Infinity;
  let worst = 0;
  for (let i = 0; i < expected.length; i++) {
    const relative = Math.abs(found[i] - expected[i]) / (Math.abs(expected[i]) + 0.01);
    if (!(relative <= worst)) worst = Number.isNaN(relative) ? Infinity : relative;
  }
  return worst;
}
