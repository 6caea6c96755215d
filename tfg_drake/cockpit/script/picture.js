// Every picture: what is shown at a time.

// While time goes on by itself there are so many pictures a second at most: the explorer needs the processor, too.
const MOST = 20;
let time = 0,
  live = false,
  playing = false,
  dirty = true,
  fed = false, // There is something new in the timeline.
  last = 0,
  shownBounds = "";

function interpolated(name, t, source = timeline) {
  const layer = source.layers.get(name);
  const row = layer ? before(layer.times, t) : -1;
  if (row < 0) return layer && layer.records.length ? arrays(layer.records[0]).pose : null;
  const a = arrays(layer.records[row]).pose;
  if (row + 1 >= layer.records.length) return a;
  const b = arrays(layer.records[row + 1]).pose,
    span = layer.times[row + 1] - layer.times[row];
  const share = span > 0 ? Math.min((t - layer.times[row]) / span, 1) : 0;
  const turn = Math.atan2(Math.sin(b[2] - a[2]), Math.cos(b[2] - a[2])),
    mixed = Float32Array.from(a);
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
      if (record) draw[name](record, t);
      else clear(name);
    }
  }
  const pose = interpolated("pose", t),
    truth = interpolated("truth", t);
  robot.visible = Boolean(pose);
  if (pose) {
    robot.position.set(pose[0], pose[1], 0);
    robot.rotation.z = pose[2];
    groups.camera.position.set(pose[0], pose[1], 0);
    groups.camera.rotation.z = pose[2];
    showCamera(pose, timeline.at("scan", t));
    const covariance = [pose[3], pose[4], pose[5]];
    put(
      mine,
      "robot",
      ellipses(
        [pose[0], pose[1]],
        covariance,
        [0],
        Z.uncertainty + 0.01,
        material("robot", { opacity: 0.3, above: true }),
        3,
      ),
    );
  }
  ghost.visible = Boolean(truth) && groups.trail.visible;
  if (truth) {
    ghost.position.set(truth[0], truth[1], Z.trail);
    ghost.rotation.z = truth[2];
  }
  showFirstLook(t);
  driven.show(t);
  trueWay.show(t);
  showFork(t);
  trails.pose.visible = trails.truth.visible = groups.trail.visible;
  const mission = timeline.at("mission", t);
  const drives = mission ? mission.told.drives : false;
  for (const child of groups.path.children) child.visible = drives;
  const over = Boolean(mission && mission.told.outcome);
  // There is nowhere left to go.
  for (const child of [...groups.gains.children, ...groups.tour.children]) child.visible = !over;
}

const DRAWS_INTO = {
  world: [
    ["walls", "walls"],
    ["walls", "tags"],
  ],
  tfg: [
    ["map", "edge"],
    ["map", "wall_end"],
    ["map", "bare_surface"],
    ["keep_out", "keep_out"],
  ],
  map: [
    ["map", "landmark"],
    ["map", "doubtful"],
    ["uncertainty", "landmark"],
    ["uncertainty", "doubtful"],
    ["uncertainty", "landmark outline"],
    ["uncertainty", "doubtful outline"],
  ],
  wall_landmarks: [
    ["wall_landmarks", "spread"],
    ["wall_landmarks", "lines"],
  ],
  goal: [
    ["path", "goal"],
    ["tour", "legs"],
    ["tour", "stops"],
  ],
  gains: [
    ["gains", "gains"],
    ["tour", "instead"],
  ],
  sighted: [["map", "sighted"]],
  grid: [
    ["free", "grid"],
    ["map", "grid"],
  ],
};
function clear(name) {
  for (const [group, object] of DRAWS_INTO[name] ?? [[name, name]]) put(groups[group] ?? people, object, null);
}

function redraw(names) {
  for (const name of names) if (drawn[name]) draw[name](drawn[name], time);
  dirty = true;
}

function picture(now) {
  requestAnimationFrame(picture);
  readGamepad(now);
  if (now - last < 1000 / MOST && !dirty) return;
  const passed = Math.min((now - last) / 1000, 0.25);
  last = now;
  const from = time;
  if (live) {
    const behind = timeline.end - time;
    time = behind > 30 || behind < 0.01 ? timeline.end : time + behind * Math.min(1, 5 * passed);
  } else if (playing) {
    time = Math.min(time + passed * Number(element("rate").value), timeline.end);
    if (time >= timeline.end && SOURCE?.recorded) time = 0;
    else if (time >= timeline.end && (ended() || !SOURCE)) setPlaying(false);
  }
  if (dark.matches !== painted) paint();
  if (time !== from || dirty || fed) render();
  // Also what has come since, at the very time that is shown already.
  if (untold && performance.now() >= toldAt + TOLD_EVERY) tell();
}

function render() {
  dirty = fed = false;
  show(time);
  if (framed || following) frame();
  const wanted = Math.min(Math.max(1.9 * metresPerPixel(), 0.015), 0.6);
  if (wanted / unit > 1.15 || unit / wanted > 1.15) {
    unit = wanted;
    const scale = Math.max(robotRadius, 3.2 * unit);
    robot.scale.setScalar(scale);
    ghost.scale.setScalar(scale);
    redraw(NEEDS_UNIT);
    drawAreas();
    show(time);
  }
  viewer.controls.update();
  viewer.scene.background = null;
  viewer.renderer.setClearColor(new T.Color(colour("ground")), 1);
  kept.draw();
  showScale();
  dirty = false;
  untold = true;
  if (!live && !playing) tell();
}

/** Keeps what is known, or the robot, in the window as it grows. */
function frame() {
  if (following) {
    const [x, y] = robotPlace(),
      target = viewer.controls.target,
      dx = x - target.x,
      dz = -y - target.z;
    const shift = flat ? offset() : [0, 0];
    viewer.camera.position.x += dx + shift[0];
    viewer.camera.position.z += dz + shift[1];
    target.x += dx + shift[0];
    target.z += dz + shift[1];
    return;
  }
  const box = boundsAt(time),
    key = box.map((value) => Math.round(value / 0.5)).join() + flat + size();
  if (key !== shownBounds) {
    shownBounds = key;
    fit();
  }
}

function offset() {
  const [left, top, right, bottom] = margins(),
    scale = metresPerPixel();
  return [((right - left) / 2) * scale, -((top - bottom) / 2) * scale];
}
