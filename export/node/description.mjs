// The description in a model's file. ONNX Runtime for JavaScript does not hand it out, so it is read from the bytes: an
// ONNX file is a ModelProto of protocol buffers, and field 14 of it are pairs of a key (1) and a value (2).
// https://github.com/onnx/onnx/blob/main/onnx/onnx.proto, https://protobuf.dev/programming-guides/encoding/

const METADATA = 14;
const FORMAT = "nte-onnx/2";

/** Return the description (an object) of a model of nte. bytes: a Uint8Array, the content of its file. */
export function describe(bytes) {
  const description = JSON.parse(new TextDecoder().decode(metadata(bytes)));
  if (description.format !== FORMAT) throw new Error(`the model's format is ${description.format}, not ${FORMAT}`);
  return description;
}

/**
 * Throw an error for a model whose checksum does not fit: it is that of the file with 64 zeros in its place.
 *
 * Browsers compute no checksums on pages that came by HTTP from another machine: nothing is checked there.
 */
export async function requireSeal(bytes) {
  const part = metadata(bytes);
  const found = /(?<="sha256": ")[0-9a-f]{64}(?=")/.exec(new TextDecoder("latin1").decode(part)); // a byte, a letter
  if (!found || !globalThis.crypto?.subtle) return;
  const unsealed = new Uint8Array(bytes); // a copy
  const at = part.byteOffset - bytes.byteOffset + found.index;
  unsealed.fill("0".charCodeAt(0), at, at + found[0].length);
  const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", unsealed));
  const checksum = Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("");
  if (checksum !== found[0]) throw new Error("damaged: its checksum does not fit: copy or export it again");
}

/** The bytes of the description, within those of the file. */
function metadata(bytes) {
  for (const pair of fields(bytes, METADATA)) {
    const [key, value] = [1, 2].map((number) => fields(pair, number).next().value);
    if (new TextDecoder().decode(key) === "nte") return value;
  }
  throw new Error("not a model of nte: no key 'nte' in its metadata");
}

/** The contents of all fields of a message that have this number and a length. */
function* fields(bytes, wanted) {
  let at = 0;
  const varint = () => {
    let value = 0;
    for (let scale = 1; ; scale *= 128) {
      if (at >= bytes.length) throw new Error("not an ONNX file: it ends in the middle of a number");
      value += (bytes[at] & 127) * scale; // not by shifts, which would keep 32 bits
      if (bytes[at++] < 128) return value;
    }
  };
  while (at < bytes.length) {
    const tag = varint();
    const kind = tag % 8;
    if (kind === 0) varint();
    else if (kind === 1) at += 8;
    else if (kind === 5) at += 4;
    else if (kind === 2) {
      const length = varint();
      if (tag >> 3 === wanted) yield bytes.subarray(at, at + length);
      at += length;
    } else throw new Error(`not an ONNX file: a field of kind ${kind}`);
  }
}
