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
      const record = { told, time: told.t, buffer, start, before: null };
      for (const [, type, shape] of told.arrays) {
        const bytes = shape.reduce((a, b) => a * b, 1) * TYPES[type].BYTES_PER_ELEMENT;
        start += bytes + ((4 - (bytes % 4)) % 4);
      }
      const layer = this.layer(told.layer);
      if (told.near) record.before = layer.records[layer.records.length - 1] ?? null;
      layer.times.push(told.t);
      layer.records.push(record);
      this.end = Math.max(this.end, told.t);
      for (const listener of this.listeners) listener(told.layer, record);
    }
  }
}

const joined = new Map(); // of each layer the record that was read last, and its arrays

/** The arrays of a record by name; positions in metres. Of one that tells what is near a place, with what was told of
 * elsewhere before. */
function arrays(record) {
  if (record.arrays && !record.before) return record.arrays;
  const layer = record.told.layer,
    last = joined.get(layer),
    chain = [record];
  while (chain[0].before && last?.record !== chain[0]) chain.unshift(chain[0].before);
  let found = last?.record === chain[0] ? last.arrays : own(chain[0]);
  for (const one of chain.slice(1)) found = within(found, own(one), one.told.near);
  joined.set(layer, { record, arrays: found });
  return found;
}

/** Arrays with what is near a place, [x, y, reach], as some others have it. */
function within(before, now, [x, y, reach]) {
  const places = before.points ?? before.segments,
    columns = before.points ? 2 : 4,
    known = new Set(now.ids);
  const far = (i) => {
    const p = columns * i,
      last = p + columns - 2;
    return Math.hypot((places[p] + places[last]) / 2 - x, (places[p + 1] + places[last + 1]) / 2 - y) > reach;
  };
  const count = places.length / columns,
    byId = before.facing ? before.ids.length : count;
  const stays = new Uint8Array(count).map((_, i) => far(i) && !(before.points && known.has(before.ids[i])));
  const others = before.facing ? new Uint8Array(byId).map((_, i) => !known.has(before.ids[i])) : stays;
  const result = {};
  for (const name of Object.keys(before)) {
    const kept = name === "ids" || name === "facing" ? others : stays;
    result[name] = merged(before[name], now[name] ?? before[name].slice(0, 0), kept);
  }
  return result;
}

/** The rows of an array that stay, and then those of another. */
function merged(before, now, stays) {
  const columns = before.length / (stays.length || 1),
    kept = stays.reduce((sum, one) => sum + one, 0);
  const all = new before.constructor(kept * columns + now.length);
  let place = 0;
  for (let i = 0; i < stays.length; i++)
    if (stays[i]) for (let c = 0; c < columns; c++) all[place++] = before[i * columns + c];
  all.set(now, place);
  return all;
}

function own(record) {
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
