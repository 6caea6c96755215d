// Plots over time, and the stages beside the slider.

const WALLS = ["", [[series.walls, "landmark"]], 0, ""];
const PLOTS = [
  [
    "",
    [
      [series.tags, "landmark"],
      [forkSeries.tags, "fork"],
    ],
    0,
    "",
  ],
  ["floor seen, m²", [[area, "frontier"]], 0, ""],
  [
    "map entropy, nats",
    [
      [series.entropy, "doubtful"],
      [forkSeries.entropy, "fork"],
    ],
    0,
    "",
  ],
  [
    "position, cm: stated and true",
    [
      [series.sigma, "robot"],
      [series.error, "path"],
    ],
    1,
    "",
  ],
];
for (const [title] of PLOTS) {
  element("plots").append(
    made("div", { className: "plot" }, made("canvas"), made("span", {}, title), made("b")),
  );
}

function drawPlots() {
  [...element("plots").children].forEach((box, i) => {
    const canvas = box.querySelector("canvas"),
      ratio = window.devicePixelRatio || 1;
    const w = Math.round(canvas.clientWidth * ratio),
      h = Math.round(canvas.clientHeight * ratio);
    if (!w || !h) return;
    if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
    const context = canvas.getContext("2d"),
      [title, parts, digits] = i === 0 && wallsAlone() ? WALLS : PLOTS[i],
      span = timeline.end || 1,
      top = 15 * ratio;
    context.clearRect(0, 0, w, h);
    let low = 0,
      high = 1e-9;
    for (const [s] of parts)
      for (const v of s.values) {
        if (v < low) low = v;
        if (v > high) high = v;
      }
    const x = (t) => (t / span) * w,
      y = (v) => h - 1 - ((v - low) / (high - low)) * (h - top - 2);
    for (const [s, name] of parts) {
      context.beginPath();
      context.strokeStyle = colour(name);
      context.lineWidth = 1.4 * ratio;
      const step = Math.max(1, Math.floor(s.times.length / (2 * w)));
      for (let k = 0; k < s.times.length; k += step) {
        if (k && !digits) context.lineTo(x(s.times[k]), y(s.values[k - step])); // It has been so until then.
        if (Number.isNaN(s.values[k - step])) context.moveTo(x(s.times[k]), y(s.values[k]));
        else context.lineTo(x(s.times[k]), y(s.values[k]));
      }
      if (s.values.length) context.lineTo(x(span), y(s.values[s.values.length - 1]));
      context.stroke();
    }
    context.fillStyle = getComputedStyle(document.body).color;
    context.globalAlpha = 0.5;
    context.fillRect(x(time) - 0.5 * ratio, top - 2, ratio, h);
    context.globalAlpha = 1;
    box.querySelector("span").textContent = (title || `${counted()} mapped`).replace(
      / and true$/,
      parts.length > 1 && parts[1][0].times.length ? " and true" : "",
    );
    box.querySelector("b").textContent = parts
      .filter(([s]) => s.times.length)
      .map(([s]) => number(value(s, time), digits))
      .join(" / ");
  });
  drawTicks();
}

function drawTicks() {
  const canvas = element("ticks"),
    ratio = window.devicePixelRatio || 1;
  const w = Math.round(canvas.clientWidth * ratio),
    h = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
  const context = canvas.getContext("2d"),
    inset = 8 * ratio;
  context.clearRect(0, 0, w, h);
  context.fillStyle = colour("truth");
  context.globalAlpha = 0.55;
  for (const t of stageTimes)
    context.fillRect(inset + (t / (timeline.end || 1)) * (w - 2 * inset), h - 5 * ratio, ratio, 5 * ratio);
  drawMarks();
}

let marked = "";
/** Marks where something else than its wheels has moved the robot. */
function drawMarks() {
  const told = (name, who) =>
      (timeline.at(name, Infinity)?.told.pushes ?? []).map((push) => ({ ...push, who })),
    pushes = [...told("world", "Slip or push of the scenario"), ...told("pushes", "Somebody has pushed the robot")];
  const marks = pushes.filter((push) => push.time <= timeline.end);
  if (marked === (marked = JSON.stringify([marks, marks.length && timeline.end]))) return;
  element("marks").replaceChildren(
    ...marks.map(({ time: t, ahead, left, turn, who }) => {
      const turned = `${number((180 * turn) / Math.PI, 0)}°`,
        moved = `${number(ahead, 2, "m")} ahead, ${number(left, 2, "m")} to its left, turned by ${turned}`;
      const mark = made("i", { title: `${number(t, 1, "s")}: ${who}: ${moved}`, onclick: () => slideTo(t) });
      mark.style.left = `${(100 * t) / (timeline.end || 1)}%`;
      return mark;
    }),
  );
}
