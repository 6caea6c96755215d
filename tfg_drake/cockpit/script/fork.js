// What if: a stage's other candidate is picked, and the run that went there is drawn beside the original.

const forks = { possible: Boolean(SOURCE && SOURCE.forks), number: 0, state: null, picked: null, timeline: null, end: null };

const forkMap = moves(new T.Group()), // the frame of the fork's map
  forkRobot = turtlebot("fork"),
  pick = moves(new T.Group());
world.add(forkMap);
map.add(pick);
forkMap.add(moves(forkRobot));
const forkTrail = moves(new T.Group());
forkMap.add(forkTrail);
let forkWay = null;

/** The stage whose choice is shown, 0 where there is none. */
function stageToFork() {
  const gains = timeline.at("gains", time);
  return gains && gains.told.explained.length ? (gains.told.stage ?? 0) : 0;
}

/** Picks a place of the shown stage, m in M. */
function pickCandidate(x, y) {
  forks.picked = { x, y, stage: stageToFork() };
  const look = material("fork", { above: true });
  put(pick, "pick", discs([x, y], null, 3.2 * unit, Z.path, look, 5, RING));
  dirty = true;
  tellFork();
}

element("scene").addEventListener("click", (event) => {
  if (!forks.possible || armed || !down || Math.hypot(event.clientX - down[0], event.clientY - down[1]) > 4) return;
  const place = placeAt(event),
    gains = timeline.at("gains", time);
  if (!place || !gains || !stageToFork()) return;
  const { points } = arrays(gains);
  let best = -1,
    nearest = 14 * metresPerPixel();
  for (let i = 0; 2 * i < points.length; i++) {
    const distance = Math.hypot(points[2 * i] - place.x, points[2 * i + 1] - place.y);
    if (distance < nearest) [best, nearest] = [i, distance];
  }
  if (best >= 0) pickCandidate(points[2 * best], points[2 * best + 1]);
});

element("choice").addEventListener("click", (event) => {
  const row = event.target.closest("tr[data-row]");
  if (!forks.possible || !row) return;
  const { at } = timeline.at("gains", time).told.explained[Number(row.dataset.row)];
  if (at) pickCandidate(...at);
});

/** Draws the fork at a time. */
function showFork(t) {
  const stage = stageToFork();
  if (forks.picked && forks.picked.stage !== stage) {
    forks.picked = null;
    put(pick, "pick", null);
    tellFork();
  }
  const other = forks.timeline,
    pose = other && interpolated("pose", t, other);
  forkMap.visible = Boolean(pose) && groups.trail.visible;
  if (!pose) return;
  const frame = other.at("frame", t);
  if (frame) {
    const [x, y, turn] = arrays(frame).pose;
    forkMap.position.set(x, y, 0);
    forkMap.rotation.z = turn;
  }
  forkRobot.position.set(pose[0], pose[1], 0);
  forkRobot.rotation.z = pose[2];
  forkRobot.scale.copy(robot.scale);
  forkWay.show(t);
}

function tellFork() {
  const section = element("fork"),
    { state, picked } = forks;
  section.hidden = !forks.possible;
  if (section.hidden) return;
  const stage = stageToFork();
  const parts = [made("h2", {}, "What if it had gone elsewhere")],
    mark = made("i", { className: "fork" });
  mark.style.background = colour("fork");
  if (state && state.running) {
    parts.push(made("p", {}, mark, ` forking stage ${state.stage}: ${state.line}`));
  } else {
    if (stage && picked) {
      const button = made(
        "button",
        { id: "request-fork" },
        `Fork stage ${stage} to (${picked.x.toFixed(1)}, ${picked.y.toFixed(1)})`,
      );
      button.onclick = () => {
        const [x, y] = inWorld(frameAt(time), picked.x, picked.y);
        request("fork", { stage: picked.stage, x, y });
      };
      parts.push(button);
    } else {
      const click = `Click another candidate of stage ${stage}, in the picture or in the table, to fork the run there.`;
      parts.push(made("p", {}, stage ? click : "No goal is chosen at this time."));
    }
    if (state && state.failure) parts.push(made("p", { className: "bad" }, state.failure));
    if (state && state.rows.length) {
      const [head, ...rows] = state.rows,
        line = (row, tag) => made("tr", {}, ...row.map((cell) => made(tag, {}, cell.replaceAll("_", " ")))),
        table = made("table", {}, line(head, "th"), ...rows.map((row) => line(row, "td")));
      parts.push(made("p", {}, mark, ` the fork of stage ${state.stage}`), table);
      parts.push(made("p", {}, state.folder));
    }
  }
  section.replaceChildren(...parts);
  section.className = picked || (state && state.number) ? "first" : ""; // What somebody does is in sight.
}

/** Reads a fork's timeline as it grows. */
async function readFork() {
  const other = (forks.timeline = new Timeline());
  for (const s of Object.values(forkSeries)) s.times.length = s.values.length = 0;
  put(forkTrail, "trail", null);
  forkWay = new Trail(forkTrail, "fork", Z.trail + 0.004);
  timeline.end = forks.end ??= timeline.end; // of the run itself
  other.listeners.push((layer, record) => {
    if (layer === "pose") {
      const p = arrays(record).pose;
      forkWay.add(record.time, p[0], p[1]);
    } else if (layer === "map") {
      forkSeries.tags.times.push(record.time);
      forkSeries.tags.values.push(record.count);
      forkSeries.entropy.times.push(record.time);
      forkSeries.entropy.values.push(record.told.entropy);
    }
    timeline.end = Math.max(timeline.end, record.time);
  });
  while (forks.timeline === other) {
    const running = forks.state.running;
    try {
      const reader = (await fetch(`fork?from=${other.read}`)).body.getReader();
      for (;;) {
        const { done, value } = await reader.read();
        if (done || forks.timeline !== other) break;
        await other.feed(value);
        fed = true;
      }
    } catch {
      /* It is asked for again. */
    }
    if (!running) return;
    await pause(0.5);
  }
}

/** Asks again and again how the newest fork goes. */
async function watchForks() {
  let said = "";
  for (;;) {
    try {
      const { fork } = await (await fetch("state")).json();
      forks.state = fork;
      if (fork.number !== forks.number) {
        forks.number = fork.number;
        readFork();
      }
      if (said !== (said = JSON.stringify(fork))) tellFork();
    } catch {
      /* The program has ended: what is shown stays. */
    }
    await pause(0.5);
  }
}
