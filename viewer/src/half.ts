// Half floats (IEEE 754 binary16) as numbers. Browsers of two years ago have no Float16Array.

const TABLE = new Float32Array(1 << 16);
for (let bits = 0; bits < TABLE.length; bits++) {
  const sign = bits & 0x8000 ? -1 : 1;
  const exponent = (bits >> 10) & 31;
  const fraction = bits & 1023;
  TABLE[bits] = sign * (
    exponent === 31 ? (fraction ? NaN : Infinity)
    : exponent ? 2 ** (exponent - 15) * (1 + fraction / 1024)
    : 2 ** -14 * (fraction / 1024));
}

export const halfToFloat = (bits: number) => TABLE[bits];
