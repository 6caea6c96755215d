// Panels: numbers, why this goal, and how it ended.

const ended = () => timeline.at("end", Infinity);
const PHASES = {
  observe: "looks round",
  glance: "glances ahead",
  map: "maps",
  choose: "chooses a goal",
  plan: "plans a path",
  follow: "drives",
  paused: "paused",
  done: "done",
};

function value(s, t) {
  const row = before(s.times, t);
  return row < 0 ? null : s.values[row];
}

function clock(t) {
  const minutes = Math.floor(t / 60),
    seconds = Math.floor(t % 60);
  return `${minutes}:${String(seconds).padStart(2, "0")}`;
}

const number = (value, digits, unit) =>
  Number.isFinite(value) ? `${value.toFixed(digits)}${unit ? " " + unit : ""}` : "–";

// Panels are written anew so often at most, ms, while time goes on by itself.
const TOLD_EVERY = 150;
let told = "",
  toldAt = -Infinity,
  untold = false; // The panels say less than is known: `picture` has them written when it is time to.
function tell() {
  untold = false;
  toldAt = performance.now();
  element("slider").max = timeline.end || 1;
  if (!sliding) element("slider").value = time;
  element("time").textContent = `${clock(time)} of ${clock(timeline.end)}`;
  const mission = timeline.at("mission", time),
    mapped = timeline.at("map", time),
    enabled = timeline.at("enabled", time);
  const stage = mapped ? mapped.told.stage : mission ? mission.told.stage : 0,
    over = timeline.at("end", time + 0.2);
  const outcome = over ? over.told.outcome : mission ? mission.told.outcome : "";
  const waits = mission && mission.told.phase === "paused" && enabled && !enabled.told.enabled;
  element("phase").textContent =
    waits && !outcome
      ? "waits for the wheels to be enabled"
      : mission
        ? outcome.replace("_", " ") || PHASES[mission.told.phase] || mission.told.phase
        : "";
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
    [
      "stated uncertainty",
      number(value(series.sigma, time), 1, "cm"),
      "One standard deviation of the robot's position",
    ],
  ];
  if (series.error.times.length)
    figures.push([
      "true error",
      number(value(series.error, time), 1, "cm"),
      "Of the robot's position (simulation only)",
    ]);
  figures.push([
    "map entropy",
    mapped ? number(mapped.told.entropy, 0, "nats") : "–",
    "Of all landmarks: the less, the more accurate the map",
  ]);
  figures.push(["stages a minute", number(time > 1 ? (60 * stage) / time : null, 1), "On average so far"]);
  if (live && speed !== null) figures.push(["speed", number(speed, 1, "×"), "Times real time"]);
  if (told !== (told = figures.join()))
    element("numbers").replaceChildren(
      ...figures.flatMap(([name, text, hint]) => [made("span", { title: hint }, name), made("b", {}, `${text}`)]),
    );
  tellChoice();
  if (forks.possible && stageTold !== (stageTold = stageToFork())) tellFork();
  tellEnd();
  drawPlots();
}

const RULES = {
  tour: "The goal comes first in the tour that sees all frontiers nearby in the least time.",
  argmax: "The goal is where most is to be gained.",
  nearest: "The goal is the nearest.",
};
let choiceShown = null,
  stageTold = -1;
function tellChoice() {
  const record = timeline.at("gains", time);
  if (record === choiceShown) return;
  choiceShown = record;
  const table = record ? record.told.explained : [];
  element("choice").hidden = !table.length;
  if (!table.length) return;
  const world = timeline.at("world", Infinity),
    goal = timeline.at("goal", time),
    rule = goal && goal.told.sent ? "Somebody has sent the robot there." : (RULES[world && world.told.rule] ?? "");
  const cell = (v) => made("td", {}, number(v, Math.abs(v) < 9.95 ? 1 : 0));
  const head = [
    ["goal", ""],
    ["known", "What seeing mapped tags again is worth, nats: exploitation; the pose's price is off it"],
    ["new", "What new tags are worth, nats: exploration"],
    ["price", "The price of driving there less certain, nats"],
    ["gain", "known + new, nats"],
    ["s", "Time to get there"],
    ["gain/s", "nats a second"],
  ];
  const rows = table.map((row, i) => {
    const numbers = [row.exploitation, row.exploration, row.pose_price, row.gain, row.time, row.rate],
      name = made("td", {}, row.chosen ? "chosen" : `next ${i}`),
      line = made("tr", { className: row.chosen ? "chosen" : "" }, name, ...numbers.map(cell));
    if (!row.chosen && forks.possible) line.dataset.row = i;
    return line;
  });
  const names = made("tr", {}, ...head.map(([name, hint]) => made("th", { title: hint }, name)));
  element("choice").replaceChildren(
    made("h2", {}, "Why this goal"),
    made("table", {}, names, ...rows),
    made("p", {}, rule),
  );
}

let cardClosed = false;
function tellEnd() {
  const record = timeline.at("end", time + 0.2),
    card = element("card");
  if (!record) {
    cardClosed = false;
  }
  if (!record || cardClosed) {
    card.hidden = true;
    return;
  }
  if (!card.hidden) return;
  const end = record.told,
    list = [
      ["why", end.reason],
      ["time", `${number(end.sim_time_s, 0)} s, ${end.stages} stages`],
      ["driven", number(end.distance_m, 1, "m")],
    ];
  if (end.landmarks_mapped !== null)
    list.push([
      "tags",
      `${end.landmarks_mapped}` +
        (end.landmarks_reachable !== null ? ` of ${end.landmarks_reachable} within reach` : " mapped"),
    ]);
  if (end.landmark_rmse_aligned_m !== null)
    list.push(["map error", `${number(end.landmark_rmse_aligned_m, 3, "m")} (root mean square)`]);
  if (end.position_error_m && end.position_error_m.mean !== null && end.position_error_m.mean !== undefined)
    list.push(["pose error", `${number(end.position_error_m.mean, 3, "m")} on average`]);
  if (end.area_coverage !== null)
    list.push(["floor", `${number(100 * end.area_coverage, 1)} % of what can be reached`]);
  if (end.contacts !== null) list.push(["contacts", `${end.contacts}`]);
  list.push(["folder", end.folder]);
  const title = made("h2", {}, `Mission ${end.outcome.replace("_", " ")}`),
    names = made("dl", {}, ...list.flatMap(([name, text]) => [made("dt", {}, name), made("dd", {}, `${text}`)])),
    close = made("button", { title: "Close" }, "×");
  close.onclick = () => {
    cardClosed = true;
    card.hidden = true;
  };
  card.replaceChildren(title, names, close);
  card.hidden = false;
}
