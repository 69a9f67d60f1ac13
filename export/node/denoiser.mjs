// A model of nte in ONNX Runtime, for Node and browsers: `ort` is the module onnxruntime-node or onnxruntime-web.

import { describe, requireSeal } from "./description.mjs";

const FORWARD = "previous_forward_motion";

/** A denoiser of one sequence of frames, whose state it keeps. */
export class Denoiser {
  #session;
  #state = {}; // recurrent input → tensor; empty before the first frame of a sequence
  #size = ""; // batch, height and width of the sequence

  /**
   * Load a model, if it is whole. bytes: content of the .onnx file. options: as of ort.InferenceSession.create.
   *
   * kept: where the state stays between frames: with WebGPU "gpu-buffer". An output that is wanted and carried as well
   * is there too then, until the next frame.
   */
  static async load(ort, bytes, options = {}, kept = "cpu") {
    const description = describe(bytes);
    await requireSeal(bytes);
    const places = Object.fromEntries(Object.values(description.state).map((source) => [source, kept]));
    const placed = kept === "cpu" ? {} : { preferredOutputLocation: places };
    return new Denoiser(ort, await ort.InferenceSession.create(bytes, { ...options, ...placed }), description);
  }

  constructor(ort, session, description) {
    this.ort = ort;
    this.#session = session;
    this.description = description;
    this.inputs = session.inputNames;
    this.outputs = session.outputNames;
    this.recurrent = Object.entries(description.state).filter(([name]) => this.inputs.includes(name));
  }

  /** Let the next frame start a sequence. */
  reset() {
    this.#keep({});
  }

  /**
   * Denoise the next frame: resolve to the wanted outputs as tensors, by name.
   *
   * frame: a tensor for each channel of description.needs, `exposure` and `depth_scale`, by name; others are ignored.
   * After an error the state is that of the frame before.
   */
  async denoise(frame, wanted = ["image"]) {
    const lacking = this.description.needs.filter((name) => !frame[name]);
    const given = Object.keys(frame).join(", ");
    if (lacking.length) throw new Error(`the frame lacks ${lacking.join(", ")}; it has ${given}`);
    const [batch, , height, width] = frame[this.description.needs[0]].dims;
    const first = Object.keys(this.#state).length === 0;
    const size = [batch, height, width].join();
    if (!first && size !== this.#size)
      throw new Error(`batch, height and width are ${size} after ${this.#size}: call reset before another size`);
    const state = first ? this.#zeros(batch, height, width) : this.#state;
    const reset = this.#filled(first ? 1 : 0, [batch]);
    const motion = frame.motion && { [FORWARD]: this.#filled(NaN, frame.motion.dims) }; // the graph makes it then
    const feed = { ...motion, ...frame, ...state, reset };
    const sources = this.recurrent.map(([, source]) => source).filter((source) => this.outputs.includes(source));
    const made = await this.run(feed, [...new Set([...wanted, ...sources])]);
    this.#keep(Object.fromEntries(this.recurrent.map(([name, source]) => [name, made[source] ?? feed[source]])));
    this.#size = size;
    return Object.fromEntries(wanted.map((name) => [name, made[name]]));
  }

  /** Run the graph alone: feed has a tensor for each input, the state among them. */
  run(feed, wanted = this.outputs) {
    return this.#session.run(Object.fromEntries(this.inputs.map((name) => [name, feed[name]])), wanted);
  }

  /** Replace the state; what it held in a GPU's memory is not collected by itself. */
  #keep(state) {
    for (const tensor of Object.values(this.#state)) if (tensor.location === "gpu-buffer") tensor.dispose();
    this.#state = state;
  }

  #zeros(batch, height, width) {
    const sizes = { batch, height, width };
    for (const scale of Object.values(this.description.scales ?? {})) {
      sizes[`height_${scale}`] = Math.ceil(height / scale);
      sizes[`width_${scale}`] = Math.ceil(width / scale);
    }
    const shapes = Object.fromEntries(this.#session.inputMetadata.map(({ name, shape }) => [name, shape]));
    return Object.fromEntries(
      this.recurrent.map(([name]) => [name, this.#filled(0, shapes[name].map((size) => sizes[size] ?? size))]),
    );
  }

  #filled(value, dims) {
    const count = dims.reduce((product, size) => product * size, 1);
    return new this.ort.Tensor("float32", new Float32Array(count).fill(value), dims);
  }
}
