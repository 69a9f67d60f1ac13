// Drawing with WebGL 2: values go to the graphics card as they are, half floats as half floats.
import { data } from "./data";
import { originOf } from "./panes";
import type { Pane, Part } from "./panes";
import type { Pixels } from "./pixels";
import { OPERATIONS, SHOWN } from "./shade";
import fragment from "./shade.glsl";

export interface Painter {
  /** Draw panes; image and base are what `pixels` gives, and a pane whose pixels are not there stays empty. */
  draw(panes: Pane[], part: Part, pixels: (pane: Pane) => [Pixels | undefined, Pixels | undefined]): void;
}

const VERTEX = `#version 300 es
void main() { gl_Position = vec4(vec2(gl_VertexID & 1, gl_VertexID >> 1) * 4.0 - 1.0, 0.0, 1.0); }`;
const BUDGET = 400e6; // bytes of textures

export function webglPainter(canvas: HTMLCanvasElement): Painter | null {
  const gl = canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
  if (!gl) return null;
  const program = linked(gl);
  gl.useProgram(program);
  const at = (name: string) => gl.getUniformLocation(program, name);
  const place = Object.fromEntries(
    ["image", "base", "size", "corner", "origin", "pixel", "height", "shown", "components", "op", "exposure", "full",
      "gain"].map((name) => [name, at(name)]));
  gl.uniform1i(place.image, 0);
  gl.uniform1i(place.base, 1);
  for (const name of ["viridis", "magma"] as const) {
    gl.uniform3fv(at(name), data.heat[name].flat().map((level) => level / 255));
  }
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  gl.enable(gl.SCISSOR_TEST);
  const textures = new Textures(gl);

  return {
    draw(panes, part, pixels) {
      const { width, height } = canvas;
      gl.viewport(0, 0, width, height);
      gl.scissor(0, 0, width, height);
      gl.clearColor(0, 0, 0, 0);
      gl.clear(gl.COLOR_BUFFER_BIT);
      gl.uniform1f(place.height, height);
      gl.uniform1f(place.pixel, 1 / part.zoom);
      for (const pane of panes) {
        const [image, base] = pixels(pane);
        if (!image || (pane.base && !base)) continue;
        const { box, clip, look } = pane;
        const origin = originOf(part, box);
        textures.bind(0, image);
        textures.bind(1, base ?? image);
        gl.scissor(clip.x, height - clip.y - clip.height, clip.width, clip.height);
        gl.uniform2i(place.size, image.width, image.height);
        gl.uniform2f(place.corner, box.x, box.y);
        gl.uniform2f(place.origin, origin.x, origin.y);
        gl.uniform1i(place.shown, SHOWN.indexOf(look.shown));
        gl.uniform1i(place.op, OPERATIONS.indexOf(look.op));
        gl.uniform1i(place.components, image.components);
        gl.uniform1f(place.exposure, look.exposure);
        gl.uniform1f(place.full, look.full);
        gl.uniform1f(place.gain, look.gain);
        gl.drawArrays(gl.TRIANGLES, 0, 3);
      }
    },
  };
}

class Textures {
  private kept = new Map<Pixels, WebGLTexture>(); // least recently used first
  private bytes = 0;

  constructor(private gl: WebGL2RenderingContext) {}

  bind(unit: number, pixels: Pixels) {
    const { gl } = this;
    gl.activeTexture(gl.TEXTURE0 + unit);
    const found = this.kept.get(pixels);
    if (found) {
      gl.bindTexture(gl.TEXTURE_2D, found);
      this.kept.delete(pixels);
      this.kept.set(pixels, found);
      return;
    }
    const texture = gl.createTexture()!;
    gl.bindTexture(gl.TEXTURE_2D, texture);
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    const [stored, format, type] = this.format(pixels);
    gl.texImage2D(gl.TEXTURE_2D, 0, stored, pixels.width, pixels.height, 0, format, type, pixels.raw);
    this.kept.set(pixels, texture);
    this.bytes += pixels.raw.byteLength;
    for (const [old, held] of this.kept) {
      if (this.bytes <= BUDGET || this.kept.size <= 4) break;
      gl.deleteTexture(held);
      this.kept.delete(old);
      this.bytes -= old.raw.byteLength;
    }
  }

  private format({ components, type }: Pixels): [number, number, number] {
    const { gl } = this;
    const i = components - 1;
    const format = [gl.RED, gl.RG, gl.RGB][i];
    switch (type) {
      case "byte": return [[gl.R8, gl.RG8, gl.RGB8][i], format, gl.UNSIGNED_BYTE];
      case "half": return [[gl.R16F, gl.RG16F, gl.RGB16F][i], format, gl.HALF_FLOAT];
      case "float": return [[gl.R32F, gl.RG32F, gl.RGB32F][i], format, gl.FLOAT];
    }
  }
}

function linked(gl: WebGL2RenderingContext): WebGLProgram {
  const program = gl.createProgram()!;
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, fragment]] as const) {
    const shader = gl.createShader(kind)!;
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
    const logs = gl.getAttachedShaders(program)!.map((shader) => gl.getShaderInfoLog(shader));
    throw new Error([gl.getProgramInfoLog(program), ...logs].join("\n"));
  }
  return program;
}
