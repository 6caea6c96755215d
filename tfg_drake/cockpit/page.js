// The page of a mission: a timeline (see tfg_drake/storage/timeline.py) read from the file itself or from the server,
// drawn with the viewer that Drake ships. Lengths in metres, times in seconds of the mission.
"use strict";

const element = (id) => document.getElementById(id);

// Before anything that may fail: a page that cannot draw stops the robot all the same.
element("stop").hidden = !(SOURCE && SOURCE.controls);
element("stop").onclick = () => request("stop");
for (const event of ["error", "unhandledrejection"])
  addEventListener(event, (failure) => notice(`This page has failed: ${failure.message ?? failure.reason}`));

const T = MeshCat.THREE;
const dark = window.matchMedia("(prefers-color-scheme: dark)");
const colour = (name) => (name === "white" ? "#ffffff" : COLOURS[dark.matches ? "dark" : "light"][name]);

// The timeline ---------------------------------------------------------------------------------------------------------

const MAGIC = 24;
const TYPES = { mm: Int32Array, i4: Int32Array, f4: Float32Array, u2: Uint16Array, u1: Uint8Array };

async function inflated(block) {
  return new Response(new Blob([block]).stream().pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
}

/** Last index whose time is at most t, -1 where there is none. */
function before(times, t) {
  let low = 0, high = times.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= t) low = middle + 1; else high = middle;
  }
  return low - 1;
}

class Timeline {
  constructor() {
    this.layers = new Map();
    this.end = 0;
    this.waiting = new Uint8Array(0);
    this.read = 0;  // bytes of the file
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
    const view = new DataView(buffer), text = new TextDecoder();
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

// The scene ------------------------------------------------------------------------------------------------------------

const viewer = new MeshCat.Viewer(element("scene"), false);
viewer.gui.domElement.remove();
for (const name of ["Background", "Grid", "Axes", "Lights"]) viewer.set_property([name], "visible", false);
viewer.renderer.toneMapping = T.NoToneMapping;  // A colour is what it is named.

const world = new T.Group();  // z up, whatever the viewer's scene is turned by
world.rotation.x = -Math.PI / 2 - viewer.scene.rotation.x;
viewer.scene.add(world);
const sky = new T.HemisphereLight(0xffffff, 0x8a8f99, 0.86 * Math.PI), sun = new T.DirectionalLight(0xffffff, 0.16 * Math.PI);
sky.position.set(0, 0, 1);
sun.position.set(4, -7, 10);
world.add(sky, sun);
const map = new T.Group();
world.add(map);

// Heights of what lies flat, so that nothing fights for the same pixel.
const Z = { free: 0, grid: 0.005, camera: 0.012, roadmap: 0.016, trail: 0.02, gains: 0.03, frontiers: 0.04,
  uncertainty: 0.05, path: 0.06, scan: 0.2, tags: 0.3 };
const WALL_HEIGHT = 1.0, MAP_HEIGHT = 0.5;
const BOX = new T.BoxGeometry(1, 1, 1), DISC = new T.CircleGeometry(1, 24), RING = new T.RingGeometry(0.86, 1, 32);

// name, words, swatch, shown at first, explanation.
const LAYERS = [
  ["walls", "walls", "wall", true, "The true walls, which the robot does not know (simulation only)"],
  ["map", "map", "landmark", true,
    "What the robot has mapped: tags, and walls. Dark: between two tags; grey: beyond the last tag; orange: without a tag"],
  ["uncertainty", "uncertainty", "landmark", true, "Ellipses of three standard deviations round each tag and the robot"],
  ["frontiers", "frontiers", "frontier", true, "Where known free space ends at the unknown"],
  ["gains", "gains", "path", true, "Places that the robot could go to: the darker, the more information is to be gained"],
  ["roadmap", "roadmap", "roadmap", false, "The ways that the robot knows it can drive"],
  ["path", "path", "path", true, "The path that it drives, and its goal"],
  ["trail", "trail", "trail", true, "The way that it has driven, as it believes; beside it, grey, the true one"],
  ["scan", "scan", "scan", true, "What its laser scanner meets"],
  ["camera", "camera", "camera", true, "What its camera sees"],
  ["free", "free space", "free", true, "Floor that the robot has seen to be free"],
];
const groups = {};
for (const [name] of LAYERS) groups[name] = new T.Group();
for (const name of ["walls"]) world.add(groups[name]);
for (const name of ["map", "uncertainty", "frontiers", "gains", "roadmap", "path", "free"]) map.add(groups[name]);
const trails = { pose: new T.Group(), truth: new T.Group() };
map.add(trails.pose, groups.scan, groups.camera);
world.add(trails.truth, groups.trail);

const materials = new Map();
function material(name, options = {}) {
  const key = name + JSON.stringify(options);
  if (!materials.has(key)) {
    const kind = options.lit ? T.MeshLambertMaterial : T.MeshBasicMaterial;
    const made = new kind({ color: colour(name), side: T.DoubleSide });
    if (options.opacity) Object.assign(made, { transparent: true, opacity: options.opacity, depthWrite: false });
    if (options.above) made.depthTest = false;
    made.userData.name = name;
    materials.set(key, made);
  }
  return materials.get(key);
}

/** Puts an object into a group in place of the one of that name there. */
function put(group, name, object) {
  const old = group.getObjectByName(name);
  if (old) {
    group.remove(old);
    old.traverse((part) => {
      if (part.geometry && part.geometry !== BOX && part.geometry !== DISC && part.geometry !== RING)
        part.geometry.dispose();
      if (part.isInstancedMesh) part.dispose();
    });
  }
  if (object) {
    object.name = name;
    group.add(object);
  }
}

function instances(geometry, look, count, place, order = 0) {
  if (!count) return null;
  const mesh = new T.InstancedMesh(geometry, look, count), m = mesh.instanceMatrix.array;
  for (let i = 0; i < count; i++) {
    m[16 * i + 10] = m[16 * i + 15] = 1;
    place(i, m, 16 * i);
  }
  mesh.frustumCulled = false;
  mesh.renderOrder = order;
  return mesh;
}

/** Segments (n, 4) as boxes: width across, height up from z. */
function boxes(segments, rows, width, height, z, look, order = 0) {
  const count = rows ? rows.length : segments.length / 4;
  return instances(BOX, look, count, (i, m, o) => {
    const s = 4 * (rows ? rows[i] : i);
    const dx = segments[s + 2] - segments[s], dy = segments[s + 3] - segments[s + 1], length = Math.hypot(dx, dy);
    const c = length > 0 ? dx / length : 1, n = length > 0 ? dy / length : 0;
    m[o] = c * (length + width); m[o + 1] = n * (length + width);
    m[o + 4] = -n * width; m[o + 5] = c * width;
    m[o + 10] = height;
    m[o + 12] = 0.5 * (segments[s] + segments[s + 2]); m[o + 13] = 0.5 * (segments[s + 1] + segments[s + 3]);
    m[o + 14] = z + 0.5 * height;
  }, order);
}

function discs(points, rows, radius, z, look, order = 0, geometry = DISC) {
  const count = rows ? rows.length : points.length / 2;
  return instances(geometry, look, count, (i, m, o) => {
    const p = 2 * (rows ? rows[i] : i);
    m[o] = m[o + 5] = radius;
    m[o + 12] = points[p]; m[o + 13] = points[p + 1]; m[o + 14] = z;
  }, order);
}

/** Ellipses of three standard deviations: a root of the covariance takes the unit circle there. */
function ellipses(points, covariance, rows, z, look, order, geometry = DISC) {
  return instances(geometry, look, rows.length, (i, m, o) => {
    const p = 2 * rows[i], c = 3 * rows[i];
    const a = Math.sqrt(Math.max(covariance[c], 1e-12)), b = covariance[c + 1] / a;
    m[o] = 3 * a; m[o + 1] = 3 * b; m[o + 5] = 3 * Math.sqrt(Math.max(covariance[c + 2] - b * b, 0));
    m[o + 12] = points[p]; m[o + 13] = points[p + 1]; m[o + 14] = z;
  }, order);
}

function rows(count, which) {
  const found = [];
  for (let i = 0; i < count; i++) if (which(i)) found.push(i);
  return found;
}

function lines(pairs, z, look) {
  if (!pairs.length) return null;
  const vertices = new Float32Array((3 * pairs.length) / 2);
  for (let i = 0; 2 * i < pairs.length; i++) {
    vertices[3 * i] = pairs[2 * i];
    vertices[3 * i + 1] = pairs[2 * i + 1];
    vertices[3 * i + 2] = z;
  }
  const geometry = new T.BufferGeometry();
  geometry.setAttribute("position", new T.BufferAttribute(vertices, 3));
  const object = new T.LineSegments(geometry, look);
  object.frustumCulled = false;
  return object;
}

// A TurtleBot: a base, three plates on poles, a camera that looks ahead. Radius 1.
function turtlebot(name) {
  const robot = new T.Group(), lit = material(name, { lit: true });
  const part = (geometry, x, y, z, look = lit) => {
    const mesh = new T.Mesh(geometry, look);
    mesh.position.set(x, y, z);
    robot.add(mesh);
    return mesh;
  };
  const plate = (radius, height) => new T.CylinderGeometry(radius, radius, height, 40).rotateX(Math.PI / 2);
  part(plate(1, 0.5), 0, 0, 0.3);
  for (const height of [0.85, 1.3, 2.0]) part(plate(0.92, 0.07), 0, 0, height);
  for (const [x, y] of [[0.6, 0.6], [-0.6, 0.6], [0.6, -0.6], [-0.6, -0.6]])
    part(plate(0.05, 1.5), x, y, 1.25, material("truth", { lit: true }));
  part(new T.BoxGeometry(0.25, 0.9, 0.3), 0.35, 0, 2.2, material("edge", { lit: true }));
  // Ahead, seen from above.
  const arrow = new T.Shape([new T.Vector2(0.85, 0), new T.Vector2(-0.15, 0.5), new T.Vector2(-0.15, -0.5)]);
  part(new T.ShapeGeometry(arrow), 0, 0, 2.38, material("camera"));
  return robot;
}

const robot = turtlebot("robot"), ghost = new T.Group();
map.add(robot);
world.add(ghost);
ghost.add(new T.Mesh(new T.RingGeometry(1.12, 1.3, 40), material("truth")));
ghost.add(new T.Mesh(new T.PlaneGeometry(1.2, 0.16).translate(0.6, 0, 0), material("truth")));
ghost.position.z = 0.03;
// A symbol's size, m: so many pixels as can be seen, whatever the zoom.
let unit = 0.05;

const drawn = {};  // the record that each layer shows
const draw = {
  world(record) {
    const { segments, tags } = arrays(record);
    const look = flat ? material("wall") : material("wall", { lit: true, opacity: 0.45 });
    put(groups.walls, "walls", segments && boxes(segments, null, Math.max(0.06, 1.1 * unit), flat ? 0.002 : WALL_HEIGHT,
      Z.free, look));
    put(groups.walls, "tags", tags && discs(tags, null, 0.8 * unit, 0.004, material("wall")));
  },

  map(record) {
    const { points, covariance, doubtful } = arrays(record), count = points.length / 2;
    const surfaces = timeline.at("tfg", time), facing = surfaces && arrays(surfaces).facing;
    const faces = facing && facing.length === points.length;
    for (const [name, value] of [["landmark", 0], ["doubtful", 1]]) {
      const some = rows(count, (i) => doubtful[i] === value);
      put(groups.map, name, flat ? discs(points, some, 1.5 * unit, MAP_HEIGHT + 0.02, material(name)) :
        instances(BOX, material(name, { lit: true }), some.length, (i, m, o) => {
          const p = 2 * some[i], side = Math.max(0.2, 2.2 * unit);
          const fx = faces ? facing[p] : 1, fy = faces ? facing[p + 1] : 0;
          m[o] = -fy * side; m[o + 1] = fx * side; m[o + 4] = -0.06 * fx; m[o + 5] = -0.06 * fy;
          if (!fx && !fy) { m[o] = side; m[o + 5] = side; }
          m[o + 10] = side;
          m[o + 12] = points[p] + 0.05 * fx; m[o + 13] = points[p + 1] + 0.05 * fy; m[o + 14] = Z.tags + 0.1;
        }));
      put(groups.uncertainty, name, ellipses(points, covariance, some, Z.uncertainty,
        material(name, { opacity: 0.18, above: true }), 3));
      put(groups.uncertainty, `${name} outline`, ellipses(points, covariance, some, Z.uncertainty,
        material(name, { opacity: 0.6, above: true }), 3, RING));
    }
  },

  tfg(record) {
    const { segments, kind } = arrays(record);
    ["edge", "wall_end", "bare_surface"].forEach((name, value) => {
      const some = rows(kind.length, (i) => kind[i] === value), look = material(flat || value ? name : "edge_in_space", { lit: true });
      put(groups.map, name, boxes(segments, some, Math.max(0.05, unit), MAP_HEIGHT, 0, look));
    });
  },

  frontiers(record) {
    const { segments } = arrays(record);
    put(groups.frontiers, "frontiers", boxes(segments, null, 1.6 * unit, 0.01, Z.frontiers, material("frontier")));
  },

  gains(record) {
    const { points, share } = arrays(record);
    const mesh = discs(points, null, 1.6 * unit, Z.gains, material("white"));
    if (mesh) {
      const shades = new Float32Array(3 * share.length), shade = new T.Color();
      for (let i = 0; i < share.length; i++) {
        const scale = COLOURS.gains, place = share[i] * (scale.length - 1), k = Math.min(Math.floor(place), scale.length - 2);
        shade.set(scale[k]).lerp(new T.Color(scale[k + 1]), place - k).toArray(shades, 3 * i);
      }
      mesh.instanceColor = new T.InstancedBufferAttribute(shades, 3);
    }
    put(groups.gains, "gains", mesh);
  },

  roadmap(record) {
    const { points, edges } = arrays(record), pairs = new Float32Array(2 * edges.length);
    for (let i = 0; i < edges.length; i++) {
      pairs[2 * i] = points[2 * edges[i]];
      pairs[2 * i + 1] = points[2 * edges[i] + 1];
    }
    put(groups.roadmap, "roadmap", lines(pairs, Z.roadmap, lineLook("roadmap")));
  },

  path(record) {
    put(groups.path, "path", boxes(arrays(record).segments, null, 1.1 * unit, 0.004, Z.path,
      material("path", { above: true }), 5));
  },

  goal(record) {
    put(groups.path, "goal", discs(arrays(record).points, null, 5 * unit, Z.path, material("path", { above: true }), 5, RING));
  },

  scan(record) {
    const { points } = arrays(record), vertices = new Float32Array((3 * points.length) / 2);
    for (let i = 0; 2 * i < points.length; i++) vertices.set([points[2 * i], points[2 * i + 1], Z.scan], 3 * i);
    const geometry = new T.BufferGeometry();
    geometry.setAttribute("position", new T.BufferAttribute(vertices, 3));
    const object = new T.Points(geometry, scanLook);
    object.frustumCulled = false;
    object.renderOrder = 4;
    put(groups.scan, "scan", object);
  },

  people(record) {
    put(world, "people", instances(new T.CylinderGeometry(0.25, 0.25, 1.6, 20).rotateX(Math.PI / 2).translate(0, 0, 0.8),
      material("person", { lit: true }), arrays(record).points.length / 2, (i, m, o) => {
        const { points } = arrays(record);
        m[o] = m[o + 5] = 1; m[o + 12] = points[2 * i]; m[o + 13] = points[2 * i + 1];
      }));
  },

  grid(record) {
    const { free, occupied } = arrays(record), size = record.told.resolution;
    put(groups.free, "grid", boxes(free, null, size, 0.002, Z.free, material("free")));
    put(groups.map, "grid", boxes(occupied, null, size, MAP_HEIGHT, 0, material("edge", { lit: true })));
  },

  free(_, t) {
    put(groups.free, "free", freeMesh(t));
  },
};
const NEEDS_UNIT = ["world", "map", "tfg", "frontiers", "gains", "path", "goal"];

const lookCache = {};
function lineLook(name) {
  lookCache[name] ??= new T.LineBasicMaterial({ color: colour(name) });
  return lookCache[name];
}
const scanLook = new T.PointsMaterial({ color: colour("scan"), size: 3.5, sizeAttenuation: false, depthTest: false });

// Free space: star polygons, each as it was last told. -------------------------------------------------------------------

const stars = [];  // of each: times and its points, the centre first
const CELL = 0.25;
const seen = new Set(), area = { times: [0], values: [0] };

function addStars(record) {
  const { index, count, points } = arrays(record);
  let start = 0;
  for (let i = 0; i < index.length; i++) {
    const star = (stars[index[i]] ??= { times: [], points: [] });
    star.times.push(record.time);
    const mine = points.slice(2 * start, 2 * (start + count[i]));
    star.points.push(mine);
    if (star.times.length === 1) fill(mine);
    start += count[i];
  }
  area.times.push(record.time);
  area.values.push(seen.size * CELL * CELL);
}

/** Takes note of the cells whose middle is in a polygon; its first point is not a corner. */
function fill(points) {
  const corners = points.length / 2 - 1;
  let low = Infinity, high = -Infinity;
  for (let i = 1; i <= corners; i++) {
    low = Math.min(low, points[2 * i + 1]);
    high = Math.max(high, points[2 * i + 1]);
  }
  for (let row = Math.ceil(low / CELL - 0.5); (row + 0.5) * CELL <= high; row++) {
    const y = (row + 0.5) * CELL, crossings = [];
    for (let i = 1, j = corners; i <= corners; j = i++) {
      const yi = points[2 * i + 1], yj = points[2 * j + 1];
      if (yi > y !== yj > y) crossings.push(points[2 * i] + ((y - yi) / (yj - yi)) * (points[2 * j] - points[2 * i]));
    }
    crossings.sort((a, b) => a - b);
    for (let k = 0; k + 1 < crossings.length; k += 2)
      for (let column = Math.ceil(crossings[k] / CELL - 0.5); (column + 0.5) * CELL <= crossings[k + 1]; column++)
        seen.add((column + 32768) * 65536 + row + 32768);
  }
}

function freeMesh(t) {
  const shown = [];
  let vertices = 0, triangles = 0;
  for (const star of stars) {
    const row = star ? before(star.times, t) : -1;
    if (row < 0) continue;
    const points = star.points[row], corners = points.length / 2 - 1;
    if (corners < 3) continue;
    shown.push(points);
    vertices += corners + 1;
    triangles += corners;
  }
  if (!triangles) return null;
  const place = new Float32Array(3 * vertices), faces = new Uint32Array(3 * triangles);
  let v = 0, f = 0;
  for (const points of shown) {
    const corners = points.length / 2 - 1, first = v;
    for (let i = 0; i <= corners; i++, v++) {
      place[3 * v] = points[2 * i];
      place[3 * v + 1] = points[2 * i + 1];
      place[3 * v + 2] = Z.free;
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
  const mesh = new T.Mesh(geometry, material("free"));
  mesh.frustumCulled = false;
  return mesh;
}

// Trails ---------------------------------------------------------------------------------------------------------------

/** The way driven, as a ribbon that grows; shown up to a time. */
class Trail {
  constructor(group, name, z) {
    Object.assign(this, { group, z, points: [], times: [], width: 0, mesh: null, length: [0] });
    this.look = material(name);
  }

  add(t, x, y) {
    const n = this.points.length;
    if (n) {
      const [a, b] = this.points[n - 1], step = Math.hypot(x - a, y - b);
      if (step < 0.03) return;
      this.length.push(this.length[n - 1] + step);
    }
    this.points.push([x, y]);
    this.times.push(t);
  }

  show(t) {
    const count = this.points.length;
    if (!this.mesh || this.built < count || this.width !== unit) this.build();
    if (this.mesh) this.mesh.geometry.setDrawRange(0, 6 * Math.max(before(this.times, t), 0));
  }

  build() {
    const count = this.points.length, capacity = Math.max(256, 2 ** Math.ceil(Math.log2(count + 1)));
    const anew = !this.mesh || this.capacity < count || this.width !== unit;
    if (anew) {
      this.capacity = capacity;
      const geometry = new T.BufferGeometry(), faces = new Uint32Array(6 * capacity);
      for (let i = 0; i < capacity; i++)
        faces.set([4 * i, 4 * i + 1, 4 * i + 2, 4 * i, 4 * i + 2, 4 * i + 3], 6 * i);
      geometry.setAttribute("position", new T.BufferAttribute(new Float32Array(12 * capacity), 3));
      geometry.setIndex(new T.BufferAttribute(faces, 1));
      this.mesh = new T.Mesh(geometry, this.look);
      this.mesh.frustumCulled = false;
      put(this.group, "trail", this.mesh);
      this.width = unit;
      this.built = 1;
    }
    const position = this.mesh.geometry.attributes.position, half = 0.35 * unit;
    for (let i = Math.max(this.built, 1); i < count; i++) {
      const [x0, y0] = this.points[i - 1], [x1, y1] = this.points[i], length = Math.hypot(x1 - x0, y1 - y0) || 1;
      const c = ((x1 - x0) / length) * half, s = ((y1 - y0) / length) * half;
      position.array.set([x0 - c + s, y0 - s - c, this.z, x1 + c + s, y1 + s - c, this.z,
        x1 + c - s, y1 + s + c, this.z, x0 - c - s, y0 - s + c, this.z], 12 * (i - 1));
    }
    position.needsUpdate = true;
    this.built = count;
  }
}

const driven = new Trail(trails.pose, "trail", Z.trail), trueWay = new Trail(trails.truth, "truth", Z.trail - 0.004);

// What is told over time -------------------------------------------------------------------------------------------------

const series = { sigma: { times: [], values: [] }, error: { times: [], values: [] }, tags: { times: [], values: [] },
  entropy: { times: [], values: [] } };
const stageTimes = [];
let bounds = null, wallBounds = null;

function widen(box, points) {
  for (let i = 0; i + 1 < points.length; i += 2) {
    box[0] = Math.min(box[0], points[i]); box[1] = Math.min(box[1], points[i + 1]);
    box[2] = Math.max(box[2], points[i]); box[3] = Math.max(box[3], points[i + 1]);
  }
  return box;
}
const emptyBox = () => [Infinity, Infinity, -Infinity, -Infinity];

function frameAt(t) {
  const record = timeline.at("frame", t);
  return record ? arrays(record).pose : [0, 0, 0];
}

function inWorld(frame, x, y) {
  const c = Math.cos(frame[2]), s = Math.sin(frame[2]);
  return [frame[0] + c * x - s * y, frame[1] + s * x + c * y];
}

timeline.listeners.push((layer, record) => {
  if (layer === "pose") {
    const p = arrays(record).pose;
    driven.add(record.time, p[0], p[1]);
    series.sigma.times.push(record.time);
    series.sigma.values.push(100 * Math.sqrt(Math.max((p[3] + p[5]) / 2, 0)));
  } else if (layer === "truth") {
    const q = arrays(record).pose, pose = timeline.at("pose", record.time);
    trueWay.add(record.time, q[0], q[1]);
    if (pose) {
      const p = arrays(pose).pose, [x, y] = inWorld(frameAt(record.time), p[0], p[1]);
      series.error.times.push(record.time);
      series.error.values.push(100 * Math.hypot(x - q[0], y - q[1]));
    }
  } else if (layer === "map") {
    const { points } = arrays(record);
    series.tags.times.push(record.time);
    series.tags.values.push(points.length / 2);
    series.entropy.times.push(record.time);
    series.entropy.values.push(record.told.entropy);
    if (record.told.stage > stageTimes.length) stageTimes.push(record.time);
  } else if (layer === "free") {
    addStars(record);
  } else if (layer === "world") {
    const { segments } = arrays(record);
    if (segments && segments.length) wallBounds = widen(emptyBox(), segments);
    element("layer-walls").parentElement.hidden = !wallBounds;
    document.title = record.told.title;
    element("title").textContent = record.told.title;
    buildCamera(record.told);
    buildControls(record.told);
  }
});

/** The building as far as it is known at a time, in W: x_min, y_min, x_max, y_max. */
function boundsAt(t) {
  if (wallBounds && groups.walls.visible) return wallBounds;
  const box = emptyBox(), frame = frameAt(t);
  const add = (points) => {
    for (let i = 0; i + 1 < points.length; i += 2) widen(box, inWorld(frame, points[i], points[i + 1]));
  };
  for (const [name, array] of [["map", "points"], ["tfg", "segments"], ["grid", "occupied"], ["scan", "points"]]) {
    const record = timeline.at(name, t);
    if (record) add(arrays(record)[array]);
  }
  const pose = timeline.at("pose", t);
  const [x, y] = inWorld(frame, ...(pose ? arrays(pose).pose.slice(0, 2) : [0, 0]));
  return widen(box, [x - 3, y - 3, x + 3, y + 3]);
}

function buildCamera({ camera, radius }) {
  robot.scale.setScalar(radius);
  ghost.scale.setScalar(radius);
  robotRadius = radius;
  if (!camera) return;
  const steps = 32, half = camera.field_of_view / 2, corners = [new T.Vector2(0, 0)];
  for (let i = 0; i <= steps; i++) {
    const angle = -half + (2 * half * i) / steps;
    corners.push(new T.Vector2(camera.range * Math.cos(angle), camera.range * Math.sin(angle)));
  }
  const cone = new T.Mesh(new T.ShapeGeometry(new T.Shape(corners)), material("camera", { opacity: 0.1 }));
  cone.position.z = Z.camera;
  put(groups.camera, "cone", cone);
}
let robotRadius = 0.18;

// Cameras --------------------------------------------------------------------------------------------------------------

let flat = true, following = false, framed = true;  // framed: the window follows what is known
const above = new T.OrthographicCamera(-1, 1, 1, -1, 0.1, 400), inSpace = new T.PerspectiveCamera(40, 1, 0.1, 2000);
const size = () => [element("scene").clientWidth || 1, element("scene").clientHeight || 1];
/** What panels leave free of the window: left, top, right, bottom, pixels. */
function margins() {
  const [w, h] = size(), side = element("side").getBoundingClientRect(), wide = w > 760;
  if (!side.width) return [20, 20, 20, 20];
  const layers = element("layers").getBoundingClientRect();
  return wide ? [element("layers").open ? layers.right + 16 : 30, 56, w - side.left + element("scene").getBoundingClientRect().left + 20, 30] :
    [12, 50, 12, h - (side.top - element("scene").getBoundingClientRect().top) + 12];
}

function useCamera() {
  const camera = flat ? above : inSpace;
  if (viewer.controls) viewer.controls.dispose();
  viewer.set_camera(camera);
  const controls = viewer.controls;
  controls.enableRotate = !flat;
  controls.screenSpacePanning = flat;
  controls.maxPolarAngle = flat ? Math.PI : 0.49 * Math.PI;
  controls.zoomToCursor = true;
  if (flat) controls.mouseButtons = { LEFT: T.MOUSE.PAN, MIDDLE: T.MOUSE.DOLLY, RIGHT: T.MOUSE.PAN };
  controls.addEventListener("start", () => { framed = false; });
  controls.addEventListener("change", () => { dirty = true; });
  fit();
}

function fit() {
  const [w, h] = size(), [left, top, right, bottom] = margins();
  const box = following ? followBox() : boundsAt(time);
  if (!(box[2] >= box[0])) return;
  const pad = 0.3, x = (box[0] + box[2]) / 2, y = (box[1] + box[3]) / 2;
  const width = Math.max(box[2] - box[0] + 2 * pad, 2), height = Math.max(box[3] - box[1] + 2 * pad, 2);
  const freeWidth = Math.max(w - left - right, 60), freeHeight = Math.max(h - top - bottom, 60);
  if (flat) {
    const scale = Math.max(width / freeWidth, height / freeHeight);  // m a pixel
    const cx = x + ((right - left) / 2) * scale, cy = y + ((top - bottom) / 2) * scale;
    above.left = (-w / 2) * scale; above.right = (w / 2) * scale;
    above.top = (h / 2) * scale; above.bottom = (-h / 2) * scale;
    above.zoom = 1;
    above.position.set(cx, 100, -cy + 1e-3);
    viewer.controls.target.set(cx, 0, -cy);
  } else {
    inSpace.aspect = w / h;
    inSpace.setViewOffset(w, h, (right - left) / 2, (bottom - top) / 2, w, h);
    const tilt = (52 * Math.PI) / 180, tan = Math.tan((inSpace.fov * Math.PI) / 360);
    // Far enough that the near edge fits, too.
    const across = (width / 2 / tan) * (h / freeWidth), along = ((height / 2) * Math.sin(tilt) * 1.12) / tan * (h / freeHeight);
    const distance = Math.max(across + (height / 2) * Math.cos(tilt), along + (height / 2) * Math.cos(tilt) * 0.6);
    viewer.controls.target.set(x, 0, -y);
    inSpace.position.set(x, distance * Math.sin(tilt), -y + distance * Math.cos(tilt));
  }
  resize();
  viewer.controls.update();
}

function followBox() {
  const p = robotPlace();
  return [p[0] - 5, p[1] - 4, p[0] + 5, p[1] + 4];
}

function robotPlace() {
  const place = new T.Vector3();
  robot.getWorldPosition(place);
  return [place.x, -place.z];
}

function resize() {
  const [w, h] = size(), camera = viewer.camera;
  if (camera === above) {
    const middle = (above.top + above.bottom) / 2, scale = (above.top - above.bottom) / 2 / (h / 2);
    above.top = middle + (h / 2) * scale; above.bottom = middle - (h / 2) * scale;
    above.left = (-w / 2) * scale; above.right = (w / 2) * scale;
  } else {
    camera.aspect = w / h;
  }
  camera.updateProjectionMatrix();
  viewer.renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
  viewer.renderer.setSize(w, h);
  dirty = true;
}
viewer.set_3d_pane_size = () => resize();

function metresPerPixel() {
  const [, h] = size();
  if (flat) return (above.top - above.bottom) / above.zoom / h;
  const distance = inSpace.position.distanceTo(viewer.controls.target);
  return (2 * distance * Math.tan((inSpace.fov * Math.PI) / 360)) / h;
}

// Every picture --------------------------------------------------------------------------------------------------------

let time = 0, live = false, playing = false, dirty = true, last = 0, shownBounds = "";

function interpolated(name, t) {
  const layer = timeline.layers.get(name);
  const row = layer ? before(layer.times, t) : -1;
  if (row < 0) return layer && layer.records.length ? arrays(layer.records[0]).pose : null;
  const a = arrays(layer.records[row]).pose;
  if (row + 1 >= layer.records.length) return a;
  const b = arrays(layer.records[row + 1]).pose, span = layer.times[row + 1] - layer.times[row];
  const share = span > 0 ? Math.min((t - layer.times[row]) / span, 1) : 0;
  const turn = Math.atan2(Math.sin(b[2] - a[2]), Math.cos(b[2] - a[2])), mixed = Float32Array.from(a);
  mixed[0] += share * (b[0] - a[0]);
  mixed[1] += share * (b[1] - a[1]);
  mixed[2] += share * turn;
  return mixed;
}

function show(t) {
  const frame = frameAt(t);
  map.position.set(frame[0], frame[1], 0);
  map.rotation.z = frame[2];
  for (const name of Object.keys(draw)) {
    const record = timeline.at(name, t);
    if (record !== (drawn[name] ?? null)) {
      drawn[name] = record;
      if (record) draw[name](record, t); else clear(name);
      if (name === "tfg" && drawn.map) draw.map(drawn.map, t);
    }
  }
  const pose = interpolated("pose", t), truth = interpolated("truth", t);
  robot.visible = Boolean(pose);
  if (pose) {
    robot.position.set(pose[0], pose[1], 0);
    robot.rotation.z = pose[2];
    groups.camera.position.set(pose[0], pose[1], 0);
    groups.camera.rotation.z = pose[2];
    const covariance = [pose[3], pose[4], pose[5]];
    put(groups.uncertainty, "robot", ellipses([pose[0], pose[1]], covariance, [0], Z.uncertainty + 0.01,
      material("robot", { opacity: 0.3, above: true }), 3));
  }
  ghost.visible = Boolean(truth) && groups.trail.visible;
  if (truth) {
    ghost.position.set(truth[0], truth[1], Z.trail);
    ghost.rotation.z = truth[2];
  }
  driven.show(t);
  trueWay.show(t);
  trails.pose.visible = trails.truth.visible = groups.trail.visible;
  const mission = timeline.at("mission", t);
  const drives = mission ? mission.told.drives : false;
  for (const child of groups.path.children) child.visible = drives;
  const over = Boolean(mission && mission.told.outcome);
  for (const child of groups.gains.children) child.visible = !over;  // There is nowhere left to go.
}

const DRAWS_INTO = { world: [["walls", "walls"], ["walls", "tags"]], tfg: [["map", "edge"], ["map", "wall_end"],
  ["map", "bare_surface"]], map: [["map", "landmark"], ["map", "doubtful"], ["uncertainty", "landmark"],
  ["uncertainty", "doubtful"], ["uncertainty", "landmark outline"], ["uncertainty", "doubtful outline"]],
  goal: [["path", "goal"]], grid: [["free", "grid"], ["map", "grid"]] };
function clear(name) {
  for (const [group, object] of DRAWS_INTO[name] ?? [[name, name]]) put(groups[group] ?? world, object, null);
}

function redraw(names) {
  for (const name of names) if (drawn[name]) draw[name](drawn[name], time);
  dirty = true;
}

function picture(now) {
  requestAnimationFrame(picture);
  const passed = Math.min((now - last) / 1000, 0.25);
  last = now;
  const from = time;
  if (live) {
    const behind = timeline.end - time;
    time = behind > 30 || behind < 0.01 ? timeline.end : time + behind * Math.min(1, 5 * passed);
  } else if (playing) {
    time = Math.min(time + passed * Number(element("rate").value), timeline.end);
    if (time >= timeline.end && (ended() || !SOURCE)) setPlaying(false);
  }
  if (dark.matches !== painted) paint();
  if (time !== from || dirty) render();
}

function render() {
  dirty = false;
  show(time);
  if (framed || following) frame();
  const wanted = Math.min(Math.max(1.9 * metresPerPixel(), 0.015), 0.6);
  if (wanted / unit > 1.15 || unit / wanted > 1.15) {
    unit = wanted;
    const scale = Math.max(robotRadius, 3.2 * unit);
    robot.scale.setScalar(scale);
    ghost.scale.setScalar(scale);
    redraw(NEEDS_UNIT);
    show(time);
  }
  viewer.controls.update();
  viewer.scene.background = null;
  viewer.renderer.setClearColor(new T.Color(colour("ground")), 1);
  viewer.renderer.render(viewer.scene, viewer.camera);
  dirty = false;
  tell();
}

/** Keeps what is known, or the robot, in the window as it grows. */
function frame() {
  if (following) {
    const [x, y] = robotPlace(), target = viewer.controls.target, dx = x - target.x, dz = -y - target.z;
    const shift = flat ? offset() : [0, 0];
    viewer.camera.position.x += dx + shift[0]; viewer.camera.position.z += dz + shift[1];
    target.x += dx + shift[0]; target.z += dz + shift[1];
    return;
  }
  const box = boundsAt(time), key = box.map((value) => Math.round(value / 0.5)).join() + flat + size();
  if (key !== shownBounds) {
    shownBounds = key;
    fit();
  }
}

function offset() {
  const [left, top, right, bottom] = margins(), scale = metresPerPixel();
  return [((right - left) / 2) * scale, -((top - bottom) / 2) * scale];
}

// Panels ---------------------------------------------------------------------------------------------------------------

const ended = () => timeline.at("end", Infinity);
const PHASES = { observe: "looks round", glance: "glances ahead", map: "maps", choose: "chooses a goal", plan: "plans a path",
  follow: "drives", paused: "paused", done: "done" };

function value(s, t) {
  const row = before(s.times, t);
  return row < 0 ? null : s.values[row];
}

function clock(t) {
  const minutes = Math.floor(t / 60), seconds = Math.floor(t % 60);
  return `${minutes}:${String(seconds).padStart(2, "0")}`;
}

const number = (value, digits, unit) => (value === null || value === undefined || !isFinite(value) ? "–" :
  `${value.toFixed(digits)}${unit ? " " + unit : ""}`);

let told = "", toldAt = -1;
function tell() {
  const now = performance.now();
  element("slider").max = timeline.end || 1;
  if (!sliding) element("slider").value = time;
  element("time").textContent = `${clock(time)} of ${clock(timeline.end)}`;
  if (now - toldAt < 80 && (live || playing)) return;
  toldAt = now;
  const mission = timeline.at("mission", time), mapped = timeline.at("map", time), enabled = timeline.at("enabled", time);
  const stage = mapped ? mapped.told.stage : mission ? mission.told.stage : 0, over = timeline.at("end", time + 0.2);
  const outcome = over ? over.told.outcome : mission ? mission.told.outcome : "";
  const waits = mission && mission.told.phase === "paused" && enabled && !enabled.told.enabled;
  element("phase").textContent = waits && !outcome ? "waits for the wheels to be enabled" :
    mission ? outcome.replace("_", " ") || PHASES[mission.told.phase] || mission.told.phase : "";
  element("phase").className = `chip ${outcome === "complete" ? "good" : outcome ? "bad" : ""}`;
  element("clock").textContent = `${time.toFixed(1)} s` + (element("clock").dataset.held === "true" ? ", held" : "");
  element("wheels").textContent = enabled ? (enabled.told.enabled ? "wheels enabled" : "wheels stopped") : "";
  element("wheels").className = `chip ${enabled ? (enabled.told.enabled ? "good" : "bad") : ""}`;
  const way = before(driven.times, time);
  const figures = [
    ["stage", stage, "One look in the map and the choice after it"],
    ["tags mapped", value(series.tags, time) ?? 0, "Landmarks in the map"],
    ["floor seen", number(value(area, time), 0, "m²"), "Floor known to be free"],
    ["driven", number(way < 0 ? 0 : driven.length[way], 1, "m"), "As the robot believes"],
    ["stated uncertainty", number(value(series.sigma, time), 1, "cm"), "One standard deviation of the robot's position"],
  ];
  if (series.error.times.length)
    figures.push(["true error", number(value(series.error, time), 1, "cm"), "Of the robot's position (simulation only)"]);
  figures.push(["map entropy", mapped ? number(mapped.told.entropy, 0, "nats") : "–",
    "Of all landmarks: the less, the more accurate the map"]);
  figures.push(["stages a minute", number(time > 1 ? (60 * stage) / time : null, 1), "On average so far"]);
  if (live && speed !== null) figures.push(["speed", number(speed, 1, "×"), "Times real time"]);
  const html = figures.map(([name, text, hint]) => `<span title="${hint}">${name}</span><b>${text}</b>`).join("");
  if (html !== told) element("numbers").innerHTML = told = html;
  tellChoice();
  tellEnd();
  drawPlots();
}

const RULES = { tour: "The goal comes first in the tour that sees all frontiers nearby in the least time.",
  argmax: "The goal is where most is to be gained.", nearest: "The goal is the nearest." };
let choiceShown = null;
function tellChoice() {
  const record = timeline.at("gains", time);
  if (record === choiceShown) return;
  choiceShown = record;
  const table = record ? record.told.explained : [];
  element("choice").hidden = !table.length;
  if (!table.length) return;
  const world = timeline.at("world", Infinity), rule = RULES[world && world.told.rule] ?? "";
  const cell = (v) => `<td>${number(v, Math.abs(v) < 99.95 ? 1 : 0)}</td>`;
  const head = [["goal", ""], ["known", "What seeing mapped tags again is worth, nats: exploitation; the pose's price is off it"],
    ["new", "What new tags are worth, nats: exploration"], ["price", "The price of driving there less certain, nats"],
    ["gain", "known + new, nats"], ["s", "Time to get there"], ["gain/s", "nats a second"]];
  element("choice").innerHTML = "<h2>Why this goal</h2><table><tr>" +
    head.map(([name, hint]) => `<th title="${hint}">${name}</th>`).join("") + "</tr>" +
    table.map((row, i) => `<tr class="${row.chosen ? "chosen" : ""}"><td>${row.chosen ? "chosen" : `next ${i}`}</td>` +
      cell(row.exploitation) + cell(row.exploration) + cell(row.pose_price) + cell(row.gain) + cell(row.time) +
      cell(row.rate) + "</tr>").join("") + `</table><p>${rule}</p>`;
}

let cardClosed = false;
function tellEnd() {
  const record = timeline.at("end", time + 0.2), card = element("card");
  if (!record) { cardClosed = false; }
  if (!record || cardClosed) { card.hidden = true; return; }
  if (!card.hidden) return;
  const end = record.told, list = [["why", end.reason], ["time", `${number(end.sim_time_s, 0)} s, ${end.stages} stages`],
    ["driven", number(end.distance_m, 1, "m")]];
  if (end.landmarks_mapped !== null) list.push(["tags", `${end.landmarks_mapped}` +
    (end.landmarks_reachable !== null ? ` of ${end.landmarks_reachable} within reach` : " mapped")]);
  if (end.landmark_rmse_aligned_m !== null) list.push(["map error", `${number(end.landmark_rmse_aligned_m, 3, "m")} (root mean square)`]);
  if (end.position_error_m && end.position_error_m.mean !== null && end.position_error_m.mean !== undefined)
    list.push(["pose error", `${number(end.position_error_m.mean, 3, "m")} on average`]);
  if (end.area_coverage !== null) list.push(["floor", `${number(100 * end.area_coverage, 1)} % of what can be reached`]);
  if (end.contacts !== null) list.push(["contacts", `${end.contacts}`]);
  list.push(["folder", end.folder]);
  card.replaceChildren();
  const title = document.createElement("h2"), names = document.createElement("dl"), close = document.createElement("button");
  title.textContent = `Mission ${end.outcome.replace("_", " ")}`;
  for (const [name, text] of list) {
    const dt = document.createElement("dt"), dd = document.createElement("dd");
    dt.textContent = name;
    dd.textContent = text;
    names.append(dt, dd);
  }
  close.textContent = "×";
  close.title = "Close";
  close.onclick = () => { cardClosed = true; card.hidden = true; };
  card.append(title, names, close);
  card.hidden = false;
}

// Plots ----------------------------------------------------------------------------------------------------------------

const PLOTS = [
  ["tags mapped", [[series.tags, "landmark"]], 0, ""],
  ["floor seen, m²", [[area, "frontier"]], 0, ""],
  ["map entropy, nats", [[series.entropy, "doubtful"]], 0, ""],
  ["position, cm: stated and true", [[series.sigma, "robot"], [series.error, "path"]], 1, ""],
];
for (const [title] of PLOTS) {
  const box = document.createElement("div");
  box.className = "plot";
  box.innerHTML = `<canvas></canvas><span>${title}</span><b></b>`;
  element("plots").append(box);
}

function drawPlots() {
  [...element("plots").children].forEach((box, i) => {
    const canvas = box.querySelector("canvas"), ratio = window.devicePixelRatio || 1;
    const w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
    if (!w || !h) return;
    if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
    const context = canvas.getContext("2d"), [, parts, digits] = PLOTS[i], span = timeline.end || 1, top = 15 * ratio;
    context.clearRect(0, 0, w, h);
    let low = 0, high = 1e-9;
    for (const [s] of parts) for (const v of s.values) { if (v < low) low = v; if (v > high) high = v; }
    const x = (t) => (t / span) * w, y = (v) => h - 1 - ((v - low) / (high - low)) * (h - top - 2);
    for (const [s, name] of parts) {
      context.beginPath();
      context.strokeStyle = colour(name);
      context.lineWidth = 1.4 * ratio;
      const step = Math.max(1, Math.floor(s.times.length / (2 * w)));
      for (let k = 0; k < s.times.length; k += step) {
        if (k && !digits) context.lineTo(x(s.times[k]), y(s.values[k - step]));  // It has been so until then.
        context.lineTo(x(s.times[k]), y(s.values[k]));
      }
      if (s.values.length) context.lineTo(x(span), y(s.values[s.values.length - 1]));
      context.stroke();
    }
    context.fillStyle = getComputedStyle(document.body).color;
    context.globalAlpha = 0.5;
    context.fillRect(x(time) - 0.5 * ratio, top - 2, ratio, h);
    context.globalAlpha = 1;
    if (parts.length > 1) box.querySelector("span").textContent = PLOTS[i][0].replace(/ and true$/, parts[1][0].times.length ? " and true" : "");
    box.querySelector("b").textContent = parts.filter(([s]) => s.times.length)
      .map(([s]) => number(value(s, time), digits)).join(" / ");
  });
  drawTicks();
}

function drawTicks() {
  const canvas = element("ticks"), ratio = window.devicePixelRatio || 1;
  const w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
  const context = canvas.getContext("2d"), inset = 8 * ratio;
  context.clearRect(0, 0, w, h);
  context.fillStyle = colour("truth");
  context.globalAlpha = 0.55;
  for (const t of stageTimes) context.fillRect(inset + (t / (timeline.end || 1)) * (w - 2 * inset), h - 5 * ratio, ratio, 5 * ratio);
}

// What can be pressed --------------------------------------------------------------------------------------------------

let sliding = false, speed = null;
const slider = element("slider");
slider.addEventListener("input", () => {
  sliding = true;
  setLive(false);
  setPlaying(false);
  time = Number(slider.value);
  render();
});
slider.addEventListener("change", () => { sliding = false; });

function pressed(button, is) {
  element(button).setAttribute("aria-pressed", is ? "true" : "false");
}

function setLive(is) {
  live = is;
  pressed("live", is);
}

function setPlaying(is) {
  playing = is;
  element("play").textContent = is ? "❚❚" : "▶";
}

element("play").onclick = () => {
  setLive(false);
  if (!playing && time >= timeline.end - 0.05) time = 0;
  setPlaying(!playing);
};
element("live").onclick = () => { setPlaying(false); setLive(true); };
element("layers").ontoggle = () => { shownBounds = ""; dirty = true; };
element("fit").onclick = () => { following = false; pressed("follow", false); framed = true; fit(); dirty = true; };
element("follow").onclick = () => {
  following = !following;
  pressed("follow", following);
  framed = !following;
  shownBounds = "";
  fit();
  dirty = true;
};
element("mode").onclick = () => {
  flat = !flat;
  element("mode").textContent = flat ? "3D" : "2D";
  useCamera();
  redraw(NEEDS_UNIT);
};

function step(direction) {
  setLive(false);
  setPlaying(false);
  const row = before(stageTimes, time + (direction > 0 ? 1e-6 : -1e-6));
  const next = direction > 0 ? stageTimes[row + 1] : stageTimes[stageTimes[row] >= time ? row - 1 : row];
  time = next ?? (direction > 0 ? timeline.end : 0);
  render();
}

for (const [name, words, swatch, shown, hint] of LAYERS) {
  const label = document.createElement("label"), box = document.createElement("input"), mark = document.createElement("i");
  label.className = "layer";
  label.title = hint;
  Object.assign(box, { type: "checkbox", checked: shown, id: `layer-${name}` });
  mark.dataset.colour = swatch;
  label.append(box, mark, words);
  groups[name].visible = shown;
  box.onchange = () => {
    groups[name].visible = box.checked;
    shownBounds = "";
    dirty = true;
  };
  element("layers").append(label);
}

let painted = null;
function paint() {
  painted = dark.matches;
  for (const made of materials.values()) made.color.set(colour(made.userData.name));
  for (const [name, look] of Object.entries(lookCache)) look.color.set(colour(name));
  scanLook.color.set(colour("scan"));
  for (const mark of document.querySelectorAll("i[data-colour]")) mark.style.background = colour(mark.dataset.colour);
  dirty = true;
}

document.addEventListener("keydown", (event) => {
  if (event.target.tagName === "SELECT" || event.ctrlKey || event.metaKey || event.altKey) return;
  const keys = { k: "play", v: "mode", f: "follow", 0: "fit", l: "live" };
  if (event.key === " " && SOURCE && SOURCE.controls) element("stop").click();
  else if (event.key === "ArrowRight" || event.key === "ArrowLeft") step(event.key === "ArrowRight" ? 1 : -1);
  else if (keys[event.key]) element(keys[event.key]).click();
  else return;
  event.preventDefault();
});

// The operator -----------------------------------------------------------------------------------------------------------

function token() {
  return new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
}

function notice(text) {
  element("notice").textContent = text;
  element("notice").hidden = !text;
}

async function request(what, more = {}) {
  try {
    const answer = await fetch("request", { method: "POST", headers: { "X-Token": token() },
      body: JSON.stringify({ request: what, ...more }) });
    notice(answer.ok ? "" : await answer.text());
  } catch {
    notice("The mission's program does not answer.");
  }
}

let built = false;
function buildControls(world) {
  const controls = Boolean(SOURCE && SOURCE.controls);
  if (!controls || built) return;
  built = true;
  const clock = world.simulated ? "the clock of the simulation" : "the mission";
  const buttons = [["hold", "Pause", `Hold ${clock}`], ["resume", "Resume", `Go on with ${clock}`],
    ["step", "Step a stage", "Go on until the next stage, then pause"]];
  const enable = ["enable", world.simulated ? "Enable wheels" : "Start", "Enable the wheels, also after a stop"];
  const push = ["push", "Push", "Push the robot half a metre to its left and turn it by 30 degrees, and see it recover"];
  if (world.simulated) buttons.push(enable, push); else buttons.unshift(enable);
  buttons.push(["recall", "Return home", "Explore no more, and come back to where it began"],
    ["end", "End", "End the mission, and write what is known"]);
  for (const [what, words, hint] of buttons) {
    const button = document.createElement("button");
    Object.assign(button, { id: `request-${what}`, textContent: words, title: hint });
    button.onclick = () => request(what);
    element("controls").append(button);
  }
  if (world.simulated) {
    const rate = document.createElement("select");
    Object.assign(rate, { id: "clock-rate", title: "Speed of the simulation, times real time" });
    for (const [value, words] of [[1, "1 × real time"], [2, "2 ×"], [4, "4 ×"], [8, "8 ×"], [16, "16 ×"], [0, "as fast as it can"]])
      rate.append(new Option(words, value, false, value === SOURCE.rate));
    if (![...rate.options].some((option) => Number(option.value) === SOURCE.rate))
      rate.append(new Option(`${SOURCE.rate} ×`, SOURCE.rate, false, true));
    rate.onchange = () => request("rate", { rate: Number(rate.value) });
    element("controls").append(rate);
  }
}

// Begin ----------------------------------------------------------------------------------------------------------------

async function readEmbedded() {
  const text = element("data").textContent.trim();
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  await timeline.feed(bytes);
}

/** What is going on that the timeline does not tell: asked for again and again. */
async function readState() {
  for (;;) {
    try {
      const state = await (await fetch("state")).json();
      const waiting = !timeline.layers.has("pose") || (state.word && !ended());
      if (waiting && state.word) notice(state.word);
      else if (element("notice").dataset.word) notice("");
      element("notice").dataset.word = waiting ? state.word : "";
      if (SOURCE.controls && "held" in state) {
        const buttons = [element("request-hold"), element("request-resume")];
        if (buttons[0]) [buttons[0].disabled, buttons[1].disabled] = [state.held, !state.held];
        if (element("clock-rate") && document.activeElement !== element("clock-rate")) element("clock-rate").value = state.rate;
        element("clock").dataset.held = state.held;
      }
    } catch { /* readServed tells it */ }
    if (ended()) {
      for (const part of element("controls").children) part.disabled = true;
      element("stop").disabled = true;
      notice("");
      return;
    }
    await pause(0.4);
  }
}

const pause = (seconds) => new Promise((resolve) => setTimeout(resolve, 1000 * seconds));

/** What the server has, and then what comes; where the connection is lost it goes on where it was. */
async function readServed() {
  let marks = [];
  for (;;) {
    try {
      const answer = await fetch(`timeline?from=${timeline.read}`);
      const reader = answer.ok ? answer.body.getReader() : null;
      for (;;) {
        const { done, value } = reader ? await reader.read() : { done: true };
        if (done) break;
        notice("");
        await timeline.feed(value);
        const now = performance.now() / 1000;
        marks = [...marks.filter(([t]) => now - t < 3), [now, timeline.end]];
        const [first] = marks;
        speed = now - first[0] > 0.5 ? (timeline.end - first[1]) / (now - first[0]) : speed;
        dirty = true;
      }
    } catch { /* told below */ }
    if (ended() || !SOURCE.live) return;
    notice("The connection to the mission is lost.");
    await pause(1);
  }
}

async function begin() {
  element("layers").open = size()[0] > 760;
  element("live").hidden = !(SOURCE && SOURCE.live);
  paint();
  useCamera();
  requestAnimationFrame(picture);
  if (SOURCE) {
    setLive(SOURCE.live);
    if (SOURCE.live) readState();
    const reading = readServed();
    if (!SOURCE.live) await reading;
  } else {
    await readEmbedded();
  }
  element("slider").max = timeline.end;
  if (!live) time = Number(new URLSearchParams(location.hash.slice(1)).get("t") ?? timeline.end);
  if (location.hash.includes("3d")) element("mode").click();
  framed = true;
  shownBounds = "";
  render();  // Shaders are compiled before anybody waits for them.
  viewer.renderer.getContext().finish();
  document.body.dataset.ready = "true";
}

new ResizeObserver(() => { shownBounds = ""; resize(); }).observe(element("scene"));
begin();
