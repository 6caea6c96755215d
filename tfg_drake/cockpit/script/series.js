// What is told over time, and how far the building goes.

const series = {
  sigma: { times: [], values: [] },
  error: { times: [], values: [] },
  tags: { times: [], values: [] },
  entropy: { times: [], values: [] },
};
const forkSeries = { tags: { times: [], values: [] }, entropy: { times: [], values: [] } };
const stageTimes = [];
let wallBounds = null;

function widen(box, points) {
  for (let i = 0; i + 1 < points.length; i += 2) {
    box[0] = Math.min(box[0], points[i]);
    box[1] = Math.min(box[1], points[i + 1]);
    box[2] = Math.max(box[2], points[i]);
    box[3] = Math.max(box[3], points[i + 1]);
  }
  return box;
}
const emptyBox = () => [Infinity, Infinity, -Infinity, -Infinity];

function frameAt(t) {
  const record = timeline.at("frame", t);
  return record ? arrays(record).pose : [0, 0, 0];
}

function inWorld(frame, x, y) {
  const c = Math.cos(frame[2]),
    s = Math.sin(frame[2]);
  return [frame[0] + c * x - s * y, frame[1] + s * x + c * y];
}

timeline.listeners.push((layer, record) => {
  if (layer === "pose") {
    const p = arrays(record).pose;
    driven.add(record.time, p[0], p[1]);
    series.sigma.times.push(record.time);
    series.sigma.values.push(100 * Math.sqrt(Math.max((p[3] + p[5]) / 2, 0)));
  } else if (layer === "truth") {
    const q = arrays(record).pose,
      pose = timeline.at("pose", record.time);
    trueWay.add(record.time, q[0], q[1]);
    if (pose) {
      const p = arrays(pose).pose,
        [x, y] = inWorld(frameAt(record.time), p[0], p[1]);
      series.error.times.push(record.time);
      series.error.values.push(100 * Math.hypot(x - q[0], y - q[1]));
    }
  } else if (layer === "map") {
    series.tags.times.push(record.time);
    series.tags.values.push(record.count);
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
  const box = emptyBox(),
    frame = frameAt(t);
  const add = (points) => {
    for (let i = 0; i + 1 < points.length; i += 2) widen(box, inWorld(frame, points[i], points[i + 1]));
  };
  for (const [name, array] of [
    ["map", "points"],
    ["tfg", "segments"],
    ["grid", "occupied"],
    ["scan", "points"],
  ]) {
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
  const steps = 32,
    half = camera.field_of_view / 2,
    corners = [new T.Vector2(0, 0)];
  for (let i = 0; i <= steps; i++) {
    const angle = -half + (2 * half * i) / steps;
    corners.push(new T.Vector2(camera.range * Math.cos(angle), camera.range * Math.sin(angle)));
  }
  const cone = new T.Mesh(new T.ShapeGeometry(new T.Shape(corners)), material("camera", { opacity: 0.1 }));
  cone.position.z = Z.camera;
  put(groups.camera, "cone", cone);
}
let robotRadius = 0.18;
