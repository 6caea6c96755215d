// The timeline, see tfg_drake/storage/timeline.py: read as it comes, kept as it is told.

const MAGIC = 24;
const TYPES = {
  mm: Int32Array,
  c2: Int16Array,
  c4: Int32Array,
  i4: Int32Array,
  f4: Float32Array,
  u2: Uint16Array,
  u1: Uint8Array,
};

/** A block unpacked, an error where it has more than so many bytes: of zeros a few stand for gigabytes. */
async function inflated(block, most) {
  let size = 0;
  const bounded = new TransformStream({
    transform(part, out) {
      size += part.length;
      if (size > most) throw new RangeError("the timeline is damaged: it stands for too many bytes");
      out.enqueue(part);
    },
  });
  const unpacked = new Blob([block]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Response(unpacked.pipeThrough(bounded)).arrayBuffer();
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
    this.unpacked = 0; // bytes that those stood for
    this.listeners = [];
  }

  layer(name) {
    if (!this.layers.has(name)) this.layers.set(name, { name, times: [], records: [], rows: new Rows() });
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
      const most = Math.max(2 ** 26, 32 * this.read) - this.unpacked; // as in tfg_drake/io/files.py
      const buffer = await inflated(joined.subarray(start + 4, start + 4 + length), most);
      this.unpacked += buffer.byteLength;
      this.block(buffer);
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
      const record = { told, time: told.t, buffer, start, rows: null };
      for (const [, type, shape] of told.arrays) {
        const bytes = shape.reduce((a, b) => a * b, 1) * TYPES[type].BYTES_PER_ELEMENT;
        start += bytes + ((4 - (bytes % 4)) % 4);
      }
      const layer = this.layer(told.layer);
      if (told.arrays.some(([name]) => name === "gone")) layer.rows.add(record);
      layer.times.push(told.t);
      layer.records.push(record);
      this.end = Math.max(this.end, told.t);
      for (const listener of this.listeners) listener(told.layer, record);
    }
  }
}

/** The rows of a layer that is a table: all that there have ever been, one behind the other, with the records from
 * which on each was there and was gone. */
class Rows {
  constructor() {
    this.written = this.there = this.records = 0;
    this.columns = new Map(); // of each array its width and its values
    this.first = new Int32Array(64);
    this.end = new Int32Array(64);
    this.shown = { number: -1, arrays: null };
  }

  add(record) {
    const found = own(record),
      number = this.records++;
    for (const row of found.gone) this.end[row] = number;
    let added = 0;
    for (const [name, , [count, width = 1]] of record.told.arrays)
      if (name !== "gone") {
        added = count;
        this.append(name, width, found[name]);
      }
    this.first = room(this.first, this.written + added).fill(number, this.written, this.written + added);
    this.end = room(this.end, this.written + added).fill(0x7fffffff, this.written, this.written + added);
    this.written += added;
    this.there += added - found.gone.length;
    Object.assign(record, { rows: this, number, count: this.there, buffer: null, arrays: null });
  }

  append(name, width, values) {
    // What are small integers in one record need not be in the next.
    const kind = values instanceof Uint16Array ? Int32Array : values.constructor;
    const column = this.columns.get(name) ?? { width, values: new kind(64) };
    column.values = room(column.values, width * this.written + values.length);
    column.values.set(values, width * this.written);
    this.columns.set(name, column);
  }

  /** The arrays of all rows that were there at a record. */
  at({ number, count }) {
    if (this.shown.number === number) return this.shown.arrays;
    const which = new Int32Array(count),
      found = {};
    for (let row = 0, k = 0; k < count; row++)
      if (this.first[row] <= number && number < this.end[row]) which[k++] = row;
    for (const [name, { width, values }] of this.columns) {
      const array = (found[name] = new values.constructor(width * count));
      for (let k = 0; k < count; k++)
        for (let c = 0; c < width; c++) array[width * k + c] = values[width * which[k] + c];
    }
    this.shown = { number, arrays: found };
    return found;
  }
}

/** An array with room for so many values, those that it has in front. */
function room(array, count) {
  if (count <= array.length) return array;
  const larger = new array.constructor(Math.max(count, 2 * array.length));
  larger.set(array);
  return larger;
}

/** The arrays of a record by name; positions in metres. */
const arrays = (record) => (record.rows ? record.rows.at(record) : own(record));

function own(record) {
  if (record.arrays) return record.arrays;
  let start = record.start;
  const found = {};
  for (const [name, type, shape] of record.told.arrays) {
    const count = shape.reduce((a, b) => a * b, 1);
    const array = new TYPES[type](record.buffer, start, count);
    if (type === "mm") found[name] = Float32Array.from(array, (value) => 1e-3 * value);
    else found[name] = type[0] === "c" ? summed(array, shape) : array;
    start += array.byteLength + ((4 - (array.byteLength % 4)) % 4);
  }
  // Only what is small is kept: the whole of a long mission would not fit.
  if (start - record.start < 4096) record.arrays = found;
  return found;
}

/** Metres, row by row, of centimetres by which each row of a column differs from the one before. */
function summed(steps, [rows, columns]) {
  const found = new Float32Array(steps.length);
  for (let c = 0; c < columns; c++)
    for (let row = 0, sum = 0; row < rows; row++) found[columns * row + c] = 1e-2 * (sum += steps[rows * c + row]);
  return found;
}

const timeline = new Timeline();
