// What is told over time, and how far the building goes.

const series = {
  sigma: { times: [], values: [] },
  error: { times: [], values: [] },
  tags: { times: [], values: [] },
  walls: { times: [], values: [] },
  entropy: { times: [], values: [] },
  driven: { times: [], values: [] },
};
const forkSeries = { tags: { times: [], values: [] }, entropy: { times: [], values: [] } };
const stageTimes = [];
// A robot may be anywhere whose position is stated worse than this, cm.
const NOWHERE = 1000;
let wallBounds = null,
  lastPlace = null;

/** Whether the map has walls alone as landmarks, as that of a robot without tags. */
function wallsAlone() {
  return !series.tags.values.some(Boolean) && series.walls.values.some(Boolean);
}

/** What the chart counts: tags, walls where the map has no tags, landmarks as long as it has neither. */
function counted() {
  return wallsAlone() ? "walls" : series.tags.values.some(Boolean) ? "tags" : "landmarks";
}

/** Whether the robot has not mapped anything yet. */
function firstLook(t) {
  const mission = timeline.at("mission", t);
  return Boolean(mission) && mission.told.stage === 0 && !mission.told.outcome;
}

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
    const { times, values } = series.driven;
    const step = times.length ? Math.hypot(p[0] - lastPlace[0], p[1] - lastPlace[1]) : 0;
    values.push((values.at(-1) ?? 0) + (step > JUMP ? 0 : step));
    times.push(record.time);
    lastPlace = p;
    series.sigma.times.push(record.time);
    const sigma = 100 * Math.sqrt(Math.max((p[3] + p[5]) / 2, 0));
    series.sigma.values.push(sigma > NOWHERE ? NaN : sigma);
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
  } else if (layer === "wall_landmarks") {
    series.walls.times.push(record.time);
    series.walls.values.push(record.count);
    if (record.count) element("layer-wall_landmarks").parentElement.hidden = false;
  } else if (layer === "tfg") {
    if (arrays(record).kind.includes(3)) element("layer-keep_out").parentElement.hidden = false;
  } else if (layer === "free") {
    addStars(record);
  } else if (layer === "grid") {
    addFreeCells(record);
  } else if (layer === "scan") {
    if (firstLook(record.time)) addGlimpse(record);
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
  ]) {
    const record = timeline.at(name, t);
    if (record) add(arrays(record)[array]);
  }
  const scan = timeline.at("scan", t);
  if (scan) add(metPoints(scan));
  const pose = timeline.at("pose", t);
  const [x, y] = inWorld(frame, ...(pose ? arrays(pose).pose.slice(0, 2) : [0, 0]));
  return widen(box, [x - 3, y - 3, x + 3, y + 3]);
}

let camera = null,
  robotRadius = 0.18;
function buildCamera(told) {
  ({ camera, radius: robotRadius } = told);
  element("layer-camera").parentElement.hidden = !camera;
  robot.scale.setScalar(robotRadius);
  ghost.scale.setScalar(robotRadius);
}

// Between rays farther apart than this, rad, nothing is known of what is in the way.
const RAYS_APART = 0.1;

/** Draws what the camera sees from a pose: as far as its range, or as the scan knows that something is in the way. */
function showCamera([x, y, turn], scan) {
  if (!camera) return;
  const half = camera.field_of_view / 2,
    { rays = [], met = [] } = scan ? arrays(scan) : {},
    ends = [];
  met.forEach((is, i) => {
    const dx = rays[2 * i + 2] - x,
      dy = rays[2 * i + 3] - y,
      bearing = Math.atan2(dy, dx) - turn,
      ahead = Math.atan2(Math.sin(bearing), Math.cos(bearing));
    if (Math.abs(ahead) <= half) ends.push([ahead, is ? Math.min(Math.hypot(dx, dy), camera.range) : camera.range]);
  });
  ends.sort((a, b) => a[0] - b[0]);
  const corners = [0, 0, 0, 0];
  let at = -half;
  for (const [angle, reach] of [...ends, [half, null]]) {
    for (; angle - at > RAYS_APART; at += RAYS_APART / 2) corners.push(camera.range * Math.cos(at), camera.range * Math.sin(at));
    if (reach !== null) corners.push(reach * Math.cos(angle), reach * Math.sin(angle));
    at = angle;
  }
  put(groups.camera, "cone", fans([corners], Z.camera, material("camera", { opacity: 0.16 })));
}
