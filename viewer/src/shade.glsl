#version 300 es
// A layer as colours. The file shade.ts computes the same without WebGL, function by function.
precision highp float;
precision highp int;
precision highp sampler2D;

uniform sampler2D image, base;
uniform ivec2 size;
uniform vec2 corner; // of the pane on the canvas, upper left, in device pixels
uniform vec2 origin; // the place in the image that is shown there
uniform float pixel; // image pixels for each device pixel
uniform float height; // of the canvas
uniform int shown, components, op;
uniform float exposure, full, gain;
uniform vec3 viridis[17], magma[17];
out vec4 colour;

const vec3 BAD = vec3(1.0, 0.0, 1.0);

vec3 encode(vec3 linear) {
  return mix(1.055 * pow(max(linear, 0.0031308), vec3(1.0 / 2.4)) - 0.055, 12.92 * linear, lessThanEqual(linear, vec3(0.0031308)));
}

vec3 display(vec3 radiance) {
  vec3 exposed = min(max(radiance, 0.0) * exposure, 1e30);
  return encode(exposed / (1.0 + exposed));
}

vec3 viridisAt(float t) {
  float x = clamp(t, 0.0, 1.0) * 16.0;
  int i = min(int(x), 15);
  return mix(viridis[i], viridis[i + 1], x - float(i));
}

vec3 magmaAt(float t) {
  float x = clamp(t, 0.0, 1.0) * 16.0;
  int i = min(int(x), 15);
  return mix(magma[i], magma[i + 1], x - float(i));
}

vec3 fromHsv(float hue, float saturation, float value) {
  vec3 k = mod(vec3(5.0, 3.0, 1.0) + hue * 6.0, 6.0);
  return value - value * saturation * clamp(min(k, 4.0 - k), 0.0, 1.0);
}

bool isBad(vec3 v) {
  uvec3 bits = floatBitsToUint(v) & 0x7f800000u;
  return any(equal(bits, uvec3(0x7f800000u)));
}

// Components that a layer lacks are 0, as texelFetch gives them.
vec3 picture(vec3 v) {
  switch (shown) {
    case 0: return display(v);
    case 1: return clamp(v, 0.0, 1.0);
    case 2: return clamp(v / full / 2.0 + 0.5, 0.0, 1.0);
    case 3: return viridisAt((components == 1 ? abs(v.r) : length(v)) / full);
    case 4: {
      uint hashed = uint(max(v.r, 0.0)) * 2654435769u;
      float value = v.r == 0.0 ? 0.0 : 0.6 + 0.4 * float(hashed & 255u) / 255.0;
      return fromHsv(float(hashed >> 8u) / 16777216.0, 0.65, value);
    }
    case 5: return fromHsv(atan(v.g == 0.0 ? 0.0 : v.g, v.r) / 6.283185307179586, min(length(v.rg) / full, 1.0), 1.0);
    case 6: return v;
    default: return magmaAt(v.r * gain);
  }
}

// What differences are taken of: light as it is displayed, other values in units of their full colour.
vec3 level(vec3 v) {
  if (shown == 0) return display(v);
  return v / (shown == 1 || shown == 6 || shown == 7 ? 1.0 : full);
}

vec3 signedColour(float t) {
  float x = clamp(t, -1.0, 1.0);
  vec3 far = x > 0.0 ? vec3(0.86, 0.16, 0.11) : vec3(0.10, 0.38, 0.90);
  return mix(vec3(0.07), far, abs(x));
}

vec3 fetched(sampler2D from, ivec2 at) {
  vec3 v = texelFetch(from, at, 0).rgb;
  return components == 1 ? v.rrr : v; // a single component is grey
}

vec3 shade(ivec2 at) {
  vec3 ours = fetched(image, at);
  if (isBad(ours)) return BAD;
  if (op == 0) return picture(ours);
  vec3 theirs = fetched(base, at);
  if (isBad(theirs)) return BAD;
  vec3 d = level(ours) - level(theirs);
  float mean = (d.r + d.g + d.b) / (components == 2 ? 2.0 : 3.0);
  return op == 1 ? clamp(abs(d) * gain, 0.0, 1.0) : signedColour(mean * gain);
}

void main() {
  vec2 device = vec2(gl_FragCoord.x, height - gl_FragCoord.y) - corner;
  vec2 from = origin + floor(device) * pixel;
  int n = int(clamp(ceil(pixel), 1.0, 4.0)); // a small picture of a large image averages its pixels
  vec3 sum = vec3(0.0);
  float count = 0.0;
  for (int j = 0; j < n; j++) for (int i = 0; i < n; i++) {
    ivec2 at = ivec2(floor(from + (vec2(i, j) + 0.5) * pixel / float(n)));
    if (at.x < 0 || at.y < 0 || at.x >= size.x || at.y >= size.y) continue;
    sum += shade(at);
    count += 1.0;
  }
  colour = count > 0.0 ? vec4(sum / count, 1.0) : vec4(0.0);
}
