// Shapes: many copies of a simple one as one mesh.

const materials = new Map();
function material(name, options = {}) {
  const key = name + JSON.stringify(options);
  if (!materials.has(key)) {
    const kind = options.lit ? T.MeshLambertMaterial : T.MeshBasicMaterial;
    const made = new kind({ color: colour(name), side: T.DoubleSide });
    if (options.opacity) Object.assign(made, { transparent: true, opacity: options.opacity, depthWrite: false });
    if (options.above) made.depthTest = false;
    if (options.shaded) made.vertexColors = true;
    if (options.once) made.depthFunc = T.LessDepth; // Where polygons overlap only the first is painted.
    made.userData.name = name;
    materials.set(key, made);
  }
  return materials.get(key);
}

let shapes = 0; // changes so far of what stands still

/** Puts an object into a group in place of the one of that name there. */
function put(group, name, object) {
  const old = group.getObjectByName(name),
    moving = !group.layers.isEnabled(STILL);
  if (old) {
    group.remove(old);
    old.traverse((part) => {
      if (part.geometry) part.geometry.dispose();
      if (part.isPoints && part.material !== scanLook) part.material.dispose();
    });
  }
  if (object) {
    object.name = name;
    group.add(moving ? moves(object) : object);
  }
  if (!moving && (old || object)) shapes++;
}

/** So many copies of a shape as one mesh, each placed by a matrix (16 numbers, by columns): with a graphics card and
 * without one that is drawn sooner than as many meshes, or as instances. */
function copies(shape, look, count, place, order = 0) {
  if (!count) return null;
  const corners = shape.attributes.position.array,
    normals = shape.attributes.normal.array,
    index = shape.index.array;
  const size = corners.length / 3,
    points = new Float32Array(3 * size * count),
    faces = new Uint32Array(index.length * count);
  const sides = look.isMeshLambertMaterial ? new Float32Array(points.length) : null,
    m = new Float32Array(16);
  for (let i = 0; i < count; i++) {
    m.fill(0);
    m[10] = m[15] = 1;
    place(i, m);
    const first = 3 * size * i;
    for (let k = 0; k < 3 * size; k += 3) {
      const x = corners[k],
        y = corners[k + 1],
        z = corners[k + 2];
      for (let r = 0; r < 3; r++) points[first + k + r] = m[r] * x + m[4 + r] * y + m[8 + r] * z + m[12 + r];
    }
    if (sides) {
      // The columns are at right angles to each other: a normal goes where they do.
      const [a, b, c] = [0, 4, 8].map((k) => 1 / (Math.hypot(m[k], m[k + 1], m[k + 2]) || 1));
      for (let k = 0; k < 3 * size; k += 3) {
        const x = normals[k] * a,
          y = normals[k + 1] * b,
          z = normals[k + 2] * c;
        for (let r = 0; r < 3; r++) sides[first + k + r] = m[r] * x + m[4 + r] * y + m[8 + r] * z;
      }
    }
    for (let k = 0; k < index.length; k++) faces[index.length * i + k] = index[k] + size * i;
  }
  const geometry = new T.BufferGeometry();
  geometry.setAttribute("position", new T.BufferAttribute(points, 3));
  if (sides) geometry.setAttribute("normal", new T.BufferAttribute(sides, 3));
  geometry.setIndex(new T.BufferAttribute(faces, 1));
  const mesh = new T.Mesh(geometry, look);
  mesh.frustumCulled = false;
  mesh.renderOrder = order;
  return mesh;
}

/** Segments (n, 4) as boxes: width across, height up from z; in space as plates that stand, where there are many. */
function boxes(segments, rows, width, height, z, look, order = 0) {
  const count = rows ? rows.length : segments.length / 4;
  return copies(
    flat || height < 0.02 ? PLATE : count > MANY ? UPRIGHT : BOX,
    look,
    count,
    (i, m) => {
      const s = 4 * (rows ? rows[i] : i);
      const dx = segments[s + 2] - segments[s],
        dy = segments[s + 3] - segments[s + 1],
        length = Math.hypot(dx, dy);
      const c = length > 0 ? dx / length : 1,
        n = length > 0 ? dy / length : 0;
      m[0] = c * (length + width);
      m[1] = n * (length + width);
      m[4] = -n * width;
      m[5] = c * width;
      m[10] = height;
      m[12] = 0.5 * (segments[s] + segments[s + 2]);
      m[13] = 0.5 * (segments[s + 1] + segments[s + 3]);
      m[14] = z + 0.5 * height;
    },
    order,
  );
}

function discs(points, rows, radius, z, look, order = 0, geometry = null) {
  const count = rows ? rows.length : points.length / 2;
  if (flat && count > MANY && !geometry) return dots(points, rows, radius, z, look, order);
  return copies(
    geometry ?? (count > MANY ? SQUARE : DISC),
    look,
    count,
    (i, m) => {
      const p = 2 * (rows ? rows[i] : i);
      m[0] = m[5] = radius;
      m[12] = points[p];
      m[13] = points[p + 1];
      m[14] = z;
    },
    order,
  );
}

/** Discs from above as what a graphics library calls points: squares of so many pixels. */
function dots(points, rows, radius, z, look, order) {
  const count = rows ? rows.length : points.length / 2,
    vertices = new Float32Array(3 * count);
  for (let i = 0; i < count; i++) {
    const p = 2 * (rows ? rows[i] : i);
    vertices[3 * i] = points[p];
    vertices[3 * i + 1] = points[p + 1];
    vertices[3 * i + 2] = z;
  }
  const geometry = new T.BufferGeometry();
  geometry.setAttribute("position", new T.BufferAttribute(vertices, 3));
  const pixels = (1.8 * radius * viewer.renderer.getPixelRatio()) / metresPerPixel();
  const own = new T.PointsMaterial({
    color: look.color,
    size: pixels,
    sizeAttenuation: false,
    vertexColors: look.vertexColors,
  });
  own.userData.name = look.userData.name;
  const object = new T.Points(geometry, own);
  object.frustumCulled = false;
  object.renderOrder = order;
  return object;
}

/** Ellipses of three standard deviations: a root of the covariance takes the unit circle there. */
function ellipses(points, covariance, rows, z, look, order, geometry = OVAL) {
  return copies(
    geometry,
    look,
    rows.length,
    (i, m) => {
      const p = 2 * rows[i],
        c = 3 * rows[i];
      const a = Math.sqrt(Math.max(covariance[c], 1e-12)),
        b = covariance[c + 1] / a;
      m[0] = 3 * a;
      m[1] = 3 * b;
      m[5] = 3 * Math.sqrt(Math.max(covariance[c + 2] - b * b, 0));
      m[12] = points[p];
      m[13] = points[p + 1];
      m[14] = z;
    },
    order,
  );
}

/** What the stops of the tour are called, 1, 2, ..., and what it could do instead, a, b, ...: nobody mixes them up. */
const nameOf = (name, i) => (name === "stop" ? `${i + 1}` : String.fromCharCode(97 + i));

/** Names at points, a disc round each, or a square: as large whatever is far away. */
function badges(points, name, radius) {
  const group = new T.Group();
  for (let i = 0; 2 * i < points.length; i++) {
    const badge = new T.Sprite(badgeLook(name, nameOf(name, i)));
    badge.position.set(points[2 * i], points[2 * i + 1], Z.path);
    badge.scale.setScalar(2 * radius);
    badge.renderOrder = name === "stop" ? 7 : 6;
    group.add(badge);
  }
  return group;
}

const BADGES = { stop: "path", instead: "truth" }, // their colours
  badgeLooks = new Map();
function badgeLook(name, words) {
  const key = [name, words, dark.matches].join();
  if (!badgeLooks.has(key)) {
    const canvas = made("canvas", { width: 64, height: 64 }),
      context = canvas.getContext("2d");
    context.fillStyle = colour(BADGES[name]);
    context.beginPath();
    if (name === "stop") context.arc(32, 32, 31, 0, 2 * Math.PI);
    else context.roundRect(5, 5, 54, 54, 8);
    context.fill();
    Object.assign(context, { fillStyle: colour("free"), font: "bold 42px sans-serif", textAlign: "center" });
    context.fillText(words, 32, 47);
    const map = new T.CanvasTexture(canvas);
    badgeLooks.set(key, new T.SpriteMaterial({ map, depthTest: false }));
  }
  return badgeLooks.get(key);
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
