// Reads what pack.py wrote: an array of Float64Array, one a channel; NaN where a value is missing.
async function unpack(packed) {
  if (typeof DecompressionStream === "undefined") throw new Error("this browser cannot inflate (DecompressionStream)");
  const bytes = Uint8Array.from(atob(packed.data), c => c.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const split = new Uint8Array(await new Response(stream).arrayBuffer());
  const n = packed.samples, upper = split.length / 2;
  return packed.low.map((low, channel) => {
    const out = new Float64Array(n);
    for (let i = 0, whole = 0, at = channel * n; i < n; i++, at++) {
      whole = ((whole + (split[at] | (split[upper + at] << 8))) << 16) >> 16;
      out[i] = whole === -32768 ? NaN : low + packed.step[channel] * (whole + 32767);
    }
    return out;
  });
}
