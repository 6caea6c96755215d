// Free space: star polygons, each as it was last told.

const stars = []; // of each: times and its points, the centre first
const CELL = 0.25;
const seen = new Set(),
  area = { times: [0], values: [0] };

const glimpses = { times: [], points: [] }; // what the scans of the first look saw, before there is a map

function addGlimpse(record) {
  const { rays = [] } = arrays(record),
    before = seen.size,
    mine = [...rays.slice(0, 2), ...rays]; // Where the scanner is, is a corner of what it sees.
  fill(mine);
  if (seen.size > before) {
    glimpses.times.push(record.time);
    glimpses.points.push(mine);
  }
  area.times.push(record.time);
  area.values.push(seen.size * CELL * CELL);
}

function addStars(record) {
  const { index, count, points } = arrays(record);
  if (!stars.length) seen.clear(); // The map knows it better.
  let start = 0;
  for (let i = 0; i < index.length; i++) {
    const star = (stars[index[i]] ??= { times: [], points: [] }),
      before = seen.size;
    const mine = points.slice(2 * start, 2 * (start + count[i]));
    fill(mine);
    // One that shows nothing new is left out: there are many, one over the other.
    if (star.times.length || seen.size > before) {
      star.times.push(record.time);
      star.points.push(mine);
    }
    start += count[i];
  }
  area.times.push(record.time);
  area.values.push(seen.size * CELL * CELL);
}

/** Of a grid: runs of free cells, from the middle of the first to that of the last. */
function addFreeCells(record) {
  const { free } = arrays(record),
    size = record.told.resolution;
  let length = 0;
  for (let i = 0; i < free.length; i += 4) length += free[i + 2] - free[i] + size;
  area.times.push(record.time);
  area.values.push(length * size);
}

/** Takes note of the cells whose middle is in a polygon round its first point. */
function fill(points) {
  const corners = points.length / 2 - 1;
  let low = Infinity,
    high = -Infinity;
  for (let i = 1; i <= corners; i++) {
    low = Math.min(low, points[2 * i + 1]);
    high = Math.max(high, points[2 * i + 1]);
  }
  for (let row = Math.ceil(low / CELL - 0.5); (row + 0.5) * CELL <= high; row++) {
    const y = (row + 0.5) * CELL,
      crossings = [];
    for (let i = 1, j = corners; i <= corners; j = i++) {
      const yi = points[2 * i + 1],
        yj = points[2 * j + 1];
      if (yi > y !== yj > y) crossings.push(points[2 * i] + ((y - yi) / (yj - yi)) * (points[2 * j] - points[2 * i]));
    }
    crossings.sort((a, b) => a - b);
    for (let k = 0; k + 1 < crossings.length; k += 2)
      for (let column = Math.ceil(crossings[k] / CELL - 0.5); (column + 0.5) * CELL <= crossings[k + 1]; column++)
        seen.add((column + 32768) * 65536 + row + 32768);
  }
}

/** The newest star polygons of all views at a time. */
function starsAt(t) {
  const shown = [];
  for (const star of stars) {
    const row = star ? before(star.times, t) : -1;
    if (row >= 0) shown.push(star.points[row]);
  }
  return shown;
}

let glimpsed = 0;
function showFirstLook(t) {
  const count = firstLook(t) ? before(glimpses.times, t) + 1 : 0;
  if (count === glimpsed) return;
  glimpsed = count;
  put(groups.free, "first look", fans(glimpses.points.slice(0, count), Z.free, material("free", { once: true })));
}

/** Polygons (1 + corners, 2), each round its first point, as one mesh. */
function fans(polygons, z, look, order = 0) {
  const shown = polygons.filter((points) => points.length >= 8),
    vertices = shown.reduce((sum, points) => sum + points.length / 2, 0),
    triangles = vertices - shown.length;
  if (!triangles) return null;
  const place = new Float32Array(3 * vertices),
    faces = new Uint32Array(3 * triangles);
  let v = 0,
    f = 0;
  for (const points of shown) {
    const corners = points.length / 2 - 1,
      first = v;
    for (let i = 0; i <= corners; i++, v++) {
      place[3 * v] = points[2 * i];
      place[3 * v + 1] = points[2 * i + 1];
      place[3 * v + 2] = z;
    }
    for (let i = 1; i <= corners; i++) {
      faces[f++] = first;
      faces[f++] = first + i;
      faces[f++] = first + (i % corners) + 1;
    }
  }
  const geometry = new T.BufferGeometry();
  geometry.setAttribute("position", new T.BufferAttribute(place, 3));
  geometry.setIndex(new T.BufferAttribute(faces, 1));
  const mesh = new T.Mesh(geometry, look);
  mesh.frustumCulled = false;
  mesh.renderOrder = order;
  return mesh;
}
