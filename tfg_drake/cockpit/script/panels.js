// Panels: numbers, why this goal, and how it ended.

const ended = () => timeline.at("end", Infinity);
// What the mission's phases are, as the terminal names them, too.
const PHASES = {
  observe: "It looks round where it stands",
  glance: "It looks ahead for a moment while it drives",
  map: "What it has seen is put into the map",
  choose: "It chooses its next goal",
  plan: "It plans a path to its goal",
  follow: "It drives along its path",
  paused: "It waits",
  done: "The mission is over",
};

function value(s, t) {
  const row = before(s.times, t);
  return row < 0 ? null : s.values[row];
}

const roundings = {}; // as Python rounds: what lies in the middle to the even digit
function number(value, digits, unit) {
  if (!Number.isFinite(value)) return "–";
  const [minimumFractionDigits, maximumFractionDigits] = [digits, digits],
    options = { minimumFractionDigits, maximumFractionDigits, roundingMode: "halfEven", useGrouping: false };
  roundings[digits] ??= new Intl.NumberFormat("en", options);
  return roundings[digits].format(value) + (unit ? ` ${unit}` : "");
}

/** A share in per cent, on one line: less than all stays below 100. */
const percent = (share) => `${number(share < 1 ? Math.min(100 * share, 99.9) : 100 * share, 1)}\u00a0%`;

/** A time as it is told: a mission has ended when its summary says so, its recording a moment later. */
function asTold(t) {
  const ends = [timeline, forks.timeline].map((run) => run?.at("end", Infinity)?.told.sim_time_s);
  return ends.find((end) => t > end && t < end + 0.5) ?? t;
}

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
  element("time").textContent = `${number(asTold(time), 1)} of ${number(asTold(timeline.end), 1, "s")}`;
  const mission = timeline.at("mission", time),
    mapped = timeline.at("map", time),
    enabled = timeline.at("enabled", time);
  const stage = mapped ? mapped.told.stage : mission ? mission.told.stage : 0,
    over = timeline.at("end", time + 0.2);
  const outcome = over ? over.told.outcome : mission ? mission.told.outcome : "";
  const waits = mission && mission.told.phase === "paused" && enabled && !enabled.told.enabled;
  const looks = firstLook(time),
    phase = mission ? mission.told.phase : "",
    hint = over ? over.told.reason : looks && phase === "observe" ? FIRST_LOOK : (PHASES[phase] ?? "");
  element("phase").textContent =
    waits && !outcome
      ? "waits for the wheels to be enabled"
      : outcome.replace("_", " ") || (looks && phase === "observe" ? "observe: first look" : phase);
  element("phase").title = `${element("phase").textContent}. ${hint}`;
  element("phase").className = `chip ${outcome === "complete" ? "good" : outcome ? "bad" : ""}`;
  element("clock").textContent = number(asTold(time), 1, "s") + (element("clock").dataset.held === "true" ? ", held" : "");
  const wheels = timeline.at("world", Infinity)?.told.wheels !== false; // Nobody drives a recording.
  element("wheels").textContent = enabled && wheels ? (enabled.told.enabled ? "wheels enabled" : "wheels stopped") : "";
  element("wheels").className = `chip ${enabled ? (enabled.told.enabled ? "good" : "bad") : ""}`;
  const sighted = looks ? sightedTags(time).length / 2 : 0;
  const figures = [
    ["stage", stage, "One look in the map and the choice after it"],
    [
      `${sighted ? "tags" : counted()} mapped`,
      `${value(wallsAlone() ? series.walls : series.tags, time) ?? 0}${looks && sighted ? `, ${sighted} seen` : ""}`,
      "Landmarks in the map; what is seen in the first look is mapped when that ends",
    ],
    ["floor seen", number(value(area, time), 0, "m²"), "Floor known to be free"],
    ["driven", number(over ? over.told.distance_m : (value(series.driven, time) ?? 0), 1, "m"), "As the robot believes"],
    [
      "stated uncertainty",
      Number.isNaN(value(series.sigma, time)) ? "not known yet" : number(value(series.sigma, time), 1, "cm"),
      "One standard deviation of the robot's position",
    ],
  ];
  const places = timeline.at("places", time)?.told.places ?? -1; // -1: the robot knows where it is
  if (places >= 0)
    figures.unshift([
      "place in its map",
      places > 1 ? `one of ${places}` : "not found yet",
      "Until the robot has found itself in its map it maps apart from that",
    ]);
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
  // A real robot's is 1.
  if (live && speed !== null && timeline.at("world", Infinity)?.told.simulated)
    figures.push(["speed", number(speed, 1, "×"), "Times real time"]);
  if (told !== (told = figures.join()))
    element("numbers").replaceChildren(
      ...figures.flatMap(([name, text, hint]) => [made("span", { title: hint }, name), made("b", {}, `${text}`)]),
    );
  tellChoice();
  if (forks.possible && stageTold !== (stageTold = stageToFork())) tellFork();
  tellEnd();
  drawPlots();
}

const FIRST_LOOK =
  "The robot's first look: it stands, then turns round. What it sees is placed by its wheels and gyro alone; the map " +
  "begins when the look ends.";
const RULES = {
  argmax: "The goal is where most is to be gained.",
  gain_per_time: "The goal is where most is to be gained a second.",
  nearest_frontier: "The goal is the place before the nearest frontier.",
  random: "The goal is drawn at random.",
};

/** Why the goal was chosen, given its record. */
function whyGoal(record) {
  const { sent, reason } = record.told,
    { done = [], tour = [] } = arrays(record),
    stops = tour.length / 2; // as many as are numbered
  if (sent) return "Somebody has sent the robot there.";
  if (!stops) return RULES[timeline.at("world", Infinity)?.told.rule] ?? reason;
  const spent = number(done.at(-1), 0, "s");
  return stops === 1
    ? `A tour of one stop, ${spent}: from the goal all frontiers nearby are seen.`
    : `A tour of ${stops} stops, ${spent} in all: from them all frontiers nearby are seen in the least time. The ` +
        "goal is its first stop, whatever is to be gained at others.";
}

let choiceShown = [],
  stageTold = -1;
function tellChoice() {
  const record = timeline.at("gains", time),
    goal = timeline.at("goal", time), // It may change while the gains stay.
    looks = firstLook(time),
    shown = looks ? [FIRST_LOOK] : [record, goal];
  if (shown.every((one, i) => one === choiceShown[i])) return;
  choiceShown = shown;
  const table = record ? record.told.explained : [];
  element("most").lastChild.textContent = `${table.length ? number(goal?.told.most, 0) : "–"} nats`;
  element("choice").hidden = !table.length && !looks;
  if (looks) element("choice").replaceChildren(made("h2", {}, "First look"), made("p", {}, FIRST_LOOK));
  if (!table.length || looks) return;
  const toured = goal && (arrays(goal).tour ?? []).length > 0;
  const cell = (v) => made("td", {}, number(v, Math.abs(v) < 9.95 ? 1 : 0));
  const head = [
    ["goal", ""],
    ["known", "What seeing mapped tags and walls again is worth, nats: exploitation; the pose's price is off it"],
    ["new", "What new ones are worth, nats: exploration"],
    ["price", "The price of driving there less certain, nats"],
    ["gain", "known + new, nats"],
    ["s", "Time to get there"],
    ["gain/s", "nats a second"],
  ];
  const rows = table.map((row, i) => {
    const numbers = [row.exploitation, row.exploration, row.pose_price, row.gain, row.time, row.rate],
      badge = made("i", { className: row.chosen ? "badge" : "badge instead" }, row.chosen ? "1" : nameOf("instead", i - 1)),
      name = row.chosen ? made("td", {}, "chosen ", toured ? badge : "") : made("td", {}, "instead ", badge),
      line = made("tr", { className: row.chosen ? "chosen" : "" }, name, ...numbers.map(cell));
    if (!row.chosen && forks.possible) line.dataset.row = i;
    return line;
  });
  const names = made("tr", {}, ...head.map(([name, hint]) => made("th", { title: hint }, name)));
  element("choice").replaceChildren(
    made("h2", {}, "Why this goal"),
    made("table", {}, names, ...rows),
    made("p", {}, goal ? whyGoal(goal) : ""),
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
      ["time", `${number(end.sim_time_s, 1, "s")}, ${end.stages} stages`],
      ["driven", number(end.distance_m, 1, "m")],
    ];
  if (end.walls_mapped && !end.landmarks_mapped && !end.landmarks_reachable)
    list.push(["walls", `${end.walls_mapped} mapped`]);
  else if (end.landmarks_mapped !== null)
    list.push([
      "tags",
      `${end.landmarks_mapped}` +
        (end.landmarks_reachable !== null ? ` mapped of ${end.landmarks_reachable} reachable` : " mapped"),
    ]);
  if (end.landmark_rmse_m !== null)
    list.push([
      "map error",
      `${number(end.landmark_rmse_m, 3, "m")} RMSE (${number(end.landmark_rmse_aligned_m, 3, "m")} aligned)`,
    ]);
  if (Number.isFinite(end.position_error_moving_m?.mean))
    list.push(["pose error", `${number(end.position_error_moving_m.mean, 3, "m")} mean from the first drive on`]);
  const shares = [
    [end.area_coverage, "area"],
    [end.surface_coverage_5cm, "surface within 5 cm"],
  ].filter(([share]) => Number.isFinite(share));
  if (shares.length) list.push(["coverage", shares.map(([share, what]) => `${percent(share)} of the ${what}`).join(", ")]);
  if (end.contacts !== null)
    list.push(["contacts", `${end.contacts} by the robot, ${end.contacts_received} by others`]);
  list.push(...(end.left_open ?? []), ["folder", end.folder]);
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
