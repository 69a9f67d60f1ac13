// The description in a model's file. ONNX Runtime for JavaScript does not hand it out, so it is read from the bytes: an
// ONNX file is a ModelProto of protocol buffers, and field 14 of it are pairs of a key (1) and a value (2).
// https://github.com/onnx/onnx/blob/main/onnx/onnx.proto, https://protobuf.dev/programming-guides/encoding/

const METADATA = 14;
const FORMAT = "nte-onnx/2";

/** Return the description (an object) of a model of nte. bytes: a Uint8Array, the content of its file. */
export function describe(bytes) {
  const text = new TextDecoder();
  for (const pair of fields(bytes, METADATA)) {
    const [key, value] = [1, 2].map((number) => text.decode(fields(pair, number).next().value));
    if (key !== "nte") continue;
    const description = JSON.parse(value);
    if (description.format !== FORMAT) throw new Error(`the model's format is ${description.format}, not ${FORMAT}`);
    return description;
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
