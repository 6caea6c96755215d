// The timeline, see tfg_drake/storage/timeline.py: read as it comes, kept as it is told.

const MAGIC = 24;
const TYPES = { mm: Int32Array, i4: Int32Array, f4: Float32Array, u2: Uint16Array, u1: Uint8Array };

async function inflated(block) {
  return new Response(new Blob([block]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
}

/** Last index whose time is at most t, -1 where there is none. */
function before(times, t) {
  let low = 0,
    high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

class Timeline {
  constructor() {
    this.layers = new Map();
    this.end = 0;
    this.waiting = new Uint8Array(0);
    this.read = 0; // bytes of the file
    this.listeners = [];
  }

  layer(name) {
    if (!this.layers.has(name)) this.layers.set(name, { name, times: [], records: [] });
    return this.layers.get(name);
  }

  /** The newest record of a layer at a time, or null. */
  at(name, t) {
    const layer = this.layers.get(name);
    const row = layer ? before(layer.times, t) : -1;
    return row < 0 ? null : layer.records[row];
  }

  async feed(bytes) {
    let skip = 0;
    if (this.read < MAGIC) skip = Math.min(MAGIC - this.read, bytes.length);
    this.read += bytes.length;
    const joined = new Uint8Array(this.waiting.length + bytes.length - skip);
    joined.set(this.waiting);
    joined.set(bytes.subarray(skip), this.waiting.length);
    let start = 0;
    while (start + 4 <= joined.length) {
      const length = new DataView(joined.buffer, joined.byteOffset + start, 4).getUint32(0, true);
      if (start + 4 + length > joined.length) break;
      this.block(await inflated(joined.subarray(start + 4, start + 4 + length)));
      start += 4 + length;
    }
    this.waiting = joined.slice(start);
  }

  block(buffer) {
    const view = new DataView(buffer),
      text = new TextDecoder();
    let start = 0;
    while (start < buffer.byteLength) {
      const length = view.getUint32(start, true);
      const told = JSON.parse(text.decode(new Uint8Array(buffer, start + 4, length)));
      start += 4 + length;
      const record = { told, time: told.t, buffer, start };
      for (const [, type, shape] of told.arrays) {
        const bytes = shape.reduce((a, b) => a * b, 1) * TYPES[type].BYTES_PER_ELEMENT;
        start += bytes + ((4 - (bytes % 4)) % 4);
      }
      const layer = this.layer(told.layer);
      layer.times.push(told.t);
      layer.records.push(record);
      this.end = Math.max(this.end, told.t);
      for (const listener of this.listeners) listener(told.layer, record);
    }
  }
}

/** The arrays of a record by name; positions in metres. */
function arrays(record) {
  if (record.arrays) return record.arrays;
  let start = record.start;
  const found = {};
  for (const [name, type, shape] of record.told.arrays) {
    const count = shape.reduce((a, b) => a * b, 1);
    const array = new TYPES[type](record.buffer, start, count);
    found[name] = type === "mm" ? Float32Array.from(array, (value) => 1e-3 * value) : array;
    start += array.byteLength + ((4 - (array.byteLength % 4)) % 4);
  }
  // Only what is small is kept: the whole of a long mission would not fit.
  if (start - record.start < 4096) record.arrays = found;
  return found;
}

const timeline = new Timeline();
