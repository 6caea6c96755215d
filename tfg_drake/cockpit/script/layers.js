// Layers: what each of them looks like, made anew when its record or the zoom changes.

// A symbol's size, m: so many pixels as can be seen, whatever the zoom.
let unit = 0.05;

const drawn = {}; // the record that each layer shows
const draw = {
  world(record) {
    const { segments, tags } = arrays(record);
    const look = flat ? material("wall") : material("wall", { lit: true, opacity: 0.45 });
    put(
      groups.walls,
      "walls",
      segments && boxes(segments, null, Math.max(0.06, LOOKS.wall.size * unit), flat ? 0.002 : WALL_HEIGHT, Z.free, look),
    );
    put(groups.walls, "tags", tags && discs(tags, null, 0.8 * unit, 0.004, material("wall")));
  },

  map(record) {
    const { points, covariance, doubtful } = arrays(record),
      count = points.length / 2;
    for (const [name, value] of [
      ["landmark", 0],
      ["doubtful", 1],
    ]) {
      const some = rows(count, (i) => doubtful[i] === value);
      put(
        groups.map,
        name,
        flat
          ? discs(points, some, LOOKS[name].size * unit, MAP_HEIGHT + 0.02, material(name))
          : copies(count > MANY ? BOX : POST, material(name, { lit: true }), some.length, (i, m) => {
              m[0] = m[5] = LOOKS[name].size * unit;
              m[10] = LOOKS[name].high;
              m[14] = 0.5 * m[10];
              m[12] = points[2 * some[i]];
              m[13] = points[2 * some[i] + 1];
            }),
      );
      // What the tag's own symbol hides is not drawn.
      const seen = some.filter((i) => 9 * (covariance[3 * i] + covariance[3 * i + 2]) > (LOOKS[name].size * unit) ** 2);
      put(
        groups.uncertainty,
        name,
        ellipses(points, covariance, seen, Z.uncertainty, material(name, { opacity: 0.18, above: true }), 3),
      );
      put(
        groups.uncertainty,
        `${name} outline`,
        ellipses(points, covariance, seen, Z.uncertainty, material(name, { opacity: 0.6, above: true }), 3, RING),
      );
    }
  },

  wall_landmarks(record) {
    const { segments, deviation } = arrays(record),
      width = LOOKS.wall_landmark.size * unit,
      spread = [];
    for (let i = 0; 2 * i < deviation.length; i++) {
      const [x0, y0, x1, y1] = segments.slice(4 * i, 4 * i + 4),
        length = Math.hypot(x1 - x0, y1 - y0) || 1,
        [nx, ny] = [(3 * (y0 - y1)) / length, (3 * (x1 - x0)) / length],
        [a, b] = deviation.slice(2 * i, 2 * i + 2);
      // What the line itself hides is not drawn.
      if (6 * Math.max(a, b) < width) continue;
      const sides = [x0 - a * nx, y0 - a * ny, x1 - b * nx, y1 - b * ny, x1 + b * nx, y1 + b * ny, x0 + a * nx, y0 + a * ny];
      spread.push([(x0 + x1) / 2, (y0 + y1) / 2, ...sides]);
    }
    const look = material("wall_landmark", { opacity: 0.3, above: true });
    put(groups.wall_landmarks, "spread", fans(spread, Z.uncertainty, look, 3));
    const line = material("wall_landmark");
    put(groups.wall_landmarks, "lines", boxes(segments, null, width, 0.004, MAP_HEIGHT + 0.01, line));
  },

  tfg(record) {
    const { segments, kind } = arrays(record);
    ["edge", "wall_end", "bare_surface", "keep_out"].forEach((name, value) => {
      const some = rows(kind.length, (i) => kind[i] === value),
        look = flat ? material(name) : material(value ? name : "edge_in_space", { lit: true });
      put(groups[name] ?? groups.map, name, boxes(segments, some, Math.max(0.05, LOOKS[name].size * unit), MAP_HEIGHT, 0, look));
    });
  },

  frontiers(record) {
    const { segments } = arrays(record);
    put(groups.frontiers, "frontiers", boxes(segments, null, LOOKS.frontier.size * unit, 0.01, Z.frontiers, material("frontier")));
  },

  gains(record) {
    const { points, share } = arrays(record);
    const mesh = discs(points, null, 1.6 * unit, Z.gains, material("white", { shaded: true }));
    if (mesh) {
      const size = mesh.geometry.attributes.position.count / share.length,
        shade = new T.Color();
      const shades = new Float32Array(3 * size * share.length),
        scale = shadesOfGain().map((name) => new T.Color(name));
      for (let i = 0; i < share.length; i++) {
        const place = (share[i] / 255) * (scale.length - 1),
          k = Math.min(Math.floor(place), scale.length - 2);
        shade.lerpColors(scale[k], scale[k + 1], place - k);
        for (let c = 0; c < size; c++) shade.toArray(shades, 3 * (size * i + c));
      }
      mesh.geometry.setAttribute("color", new T.BufferAttribute(shades, 3));
    }
    put(groups.gains, "gains", mesh);
    const others = record.told.explained.filter((row) => !row.chosen && row.at);
    put(groups.tour, "instead", badges(others.flatMap((row) => row.at), "instead", 3.6 * unit));
  },

  roadmap(record, t) {
    const { edges } = arrays(record),
      { points, ids } = arrays(timeline.at("nodes", t)),
      pairs = new Float32Array(2 * edges.length),
      place = new Map(); // of each node in points
    ids.forEach((id, row) => place.set(id, 2 * row));
    for (let i = 0; i < edges.length; i++) {
      const p = place.get(edges[i]);
      pairs[2 * i] = points[p];
      pairs[2 * i + 1] = points[p + 1];
    }
    put(groups.roadmap, "roadmap", lines(pairs, Z.roadmap, lineLook("roadmap")));
  },

  path(record) {
    put(
      groups.path,
      "path",
      boxes(arrays(record).segments, null, LOOKS.path.size * unit, 0.004, Z.path, material("path", { above: true }), 5),
    );
  },

  goal(record) {
    const { tour = [], legs = [] } = arrays(record),
      look = material("path", { above: true, opacity: 0.55 });
    put(groups.tour, "legs", boxes(legs, null, LOOKS.leg.size * unit, 0.004, Z.tour, look, 5));
    put(groups.tour, "stops", badges(tour, "stop", 4.4 * unit));
    put(
      groups.path,
      "goal",
      discs(arrays(record).points, null, 5 * unit, Z.path, material("path", { above: true }), 5, RING),
    );
  },

  scan(record) {
    const points = metPoints(record),
      vertices = new Float32Array((3 * points.length) / 2);
    for (let i = 0; 2 * i < points.length; i++) vertices.set([points[2 * i], points[2 * i + 1], Z.scan], 3 * i);
    const geometry = new T.BufferGeometry();
    geometry.setAttribute("position", new T.BufferAttribute(vertices, 3));
    const object = new T.Points(geometry, scanLook);
    object.frustumCulled = false;
    object.renderOrder = 4;
    put(groups.scan, "scan", object);
  },

  sighted(_, t) {
    const look = material("landmark", { above: true, opacity: 0.6 });
    put(groups.map, "sighted", discs(sightedTags(t), null, 1.6 * unit, MAP_HEIGHT, look, 5, DISC));
  },

  people(record) {
    put(
      people,
      "people",
      copies(
        new T.CylinderGeometry(0.25, 0.25, 1.6, 20).rotateX(Math.PI / 2).translate(0, 0, 0.8),
        material("person", { lit: true }),
        arrays(record).points.length / 2,
        (i, m) => {
          const { points } = arrays(record);
          m[0] = m[5] = 1;
          m[12] = points[2 * i];
          m[13] = points[2 * i + 1];
        },
      ),
    );
  },

  grid(record) {
    const { free, occupied } = arrays(record),
      size = record.told.resolution;
    put(groups.free, "grid", boxes(free, null, size, 0.002, Z.free, material("free")));
    put(groups.map, "grid", boxes(occupied, null, size, MAP_HEIGHT, 0, material("edge", { lit: true })));
  },

  free(_, t) {
    put(groups.free, "free", fans(starsAt(t), Z.free, material("free", { once: true })));
  },
};
const NEEDS_UNIT = ["world", "map", "wall_landmarks", "tfg", "frontiers", "gains", "path", "goal", "sighted"];

/** Where the rays of a scan met something. */
function metPoints(record) {
  const { rays = [], met = [] } = arrays(record),
    points = [];
  met.forEach((is, i) => is && points.push(rays[2 * i + 2], rays[2 * i + 3]));
  return points;
}

/** Tags that were seen and are not in the map yet: all of them in the first look, else those of the way since the last. */
function sightedTags(t) {
  const { times = [], records } = timeline.layers.get("sighted") ?? {},
    last = before(times, t),
    places = new Map();
  for (let row = firstLook(t) ? 0 : Math.max(last, 0); row <= last; row++) {
    const { ids, points } = arrays(records[row]);
    ids.forEach((id, i) => places.set(id, [points[2 * i], points[2 * i + 1]]));
  }
  return [...places.values()].flat();
}

/** Of no gain to the most: what promises the most stands out. */
const shadesOfGain = () => (dark.matches ? [...COLOURS.gains].reverse() : COLOURS.gains);

const lookCache = {};
function lineLook(name) {
  lookCache[name] ??= new T.LineBasicMaterial({ color: colour(name) });
  return lookCache[name];
}
const scanLook = new T.PointsMaterial({ color: colour("scan"), size: 3.5, sizeAttenuation: false, depthTest: false });
