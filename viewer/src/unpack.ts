// Pixels are unpacked beside the thread that draws and answers. A worker gets its script as text, since a page from disk
// may not load another file as one.

/** Unpack base64 of zlib of values taken apart: first the lowest byte of every value, then the next, … */
async function unpacked(text: string, size: number): Promise<ArrayBuffer> {
  const letters = atob(text);
  const packed = new Uint8Array(letters.length);
  for (let i = 0; i < packed.length; i++) packed[i] = letters.charCodeAt(i); // Uint8Array.from takes 15 times as long
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const apart = new Uint8Array(await new Response(stream).arrayBuffer());
  if (size === 1) return apart.buffer;
  const count = apart.length / size;
  const whole = new Uint8Array(apart.length);
  for (let part = 0; part < size; part++) {
    for (let i = 0, at = part * count; i < count; i++, at++) whole[i * size + part] = apart[at];
  }
  return whole.buffer;
}

type Waiting = { resolve: (buffer: ArrayBuffer) => void; reject: (reason: unknown) => void; text: string; size: number };
const waiting = new Map<number, Waiting>();
let number = 0;

const WORK = `
const unpacked = ${unpacked};
onmessage = ({ data: [number, text, size] }) => unpacked(text, size).then(
  (buffer) => postMessage([number, buffer], [buffer]), () => postMessage([number, null]));`;

let worker = started();

function started(): Worker | null {
  try {
    const found = new Worker(URL.createObjectURL(new Blob([WORK], { type: "text/javascript" })));
    found.onmessage = ({ data: [which, buffer] }: MessageEvent<[number, ArrayBuffer | null]>) => {
      const { resolve, reject } = waiting.get(which)!;
      waiting.delete(which);
      if (buffer) resolve(buffer);
      else reject(new Error("damaged"));
    };
    found.onerror = () => { // a browser that starts none for a page from disk
      worker = null;
      for (const { resolve, reject, text, size } of waiting.values()) unpacked(text, size).then(resolve, reject);
      waiting.clear();
    };
    return found;
  } catch {
    return null;
  }
}

/** Unpack values of `size` bytes; rejects what is damaged. */
export function unpack(text: string, size: number): Promise<ArrayBuffer> {
  if (!worker) return unpacked(text, size);
  return new Promise((resolve, reject) => {
    waiting.set(++number, { resolve, reject, text, size });
    worker!.postMessage([number, text, size]);
  });
}
