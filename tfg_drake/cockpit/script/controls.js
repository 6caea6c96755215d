// What can be pressed, but for what is asked of the mission.

let sliding = false,
  speed = null;
const slider = element("slider");
slider.addEventListener("input", () => {
  sliding = true;
  slideTo(Number(slider.value));
});
function slideTo(t) {
  setLive(false);
  setPlaying(false);
  time = t;
  render();
}
slider.addEventListener("change", () => {
  sliding = false;
});

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
element("live").onclick = () => {
  setPlaying(false);
  setLive(true);
};
element("layers").ontoggle = () => {
  shownBounds = "";
  dirty = true;
};
element("fit").onclick = () => {
  following = false;
  pressed("follow", false);
  framed = true;
  fit();
  dirty = true;
};
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
  const label = document.createElement("label"),
    box = document.createElement("input"),
    mark = document.createElement("i");
  label.className = "layer";
  label.title = hint;
  Object.assign(box, { type: "checkbox", checked: shown, id: `layer-${name}` });
  mark.dataset.colour = swatch;
  mark.dataset.layer = name;
  label.append(box, mark, words);
  groups[name].visible = shown;
  label.hidden = ["wall_landmarks", "keep_out"].includes(name); // Until there is one.
  box.onchange = () => {
    groups[name].visible = box.checked;
    shownBounds = "";
    dirty = true;
  };
  element("layers").append(label);
  if (name === "gains") element("layers").append(made("div", { id: "most" }, "0", made("i"), made("span")));
}

let painted = null;
function paint() {
  painted = dark.matches;
  for (const made of materials.values()) made.color.set(colour(made.userData.name));
  redraw(Object.keys(drawn));
  for (const [name, look] of Object.entries(lookCache)) look.color.set(colour(name));
  scanLook.color.set(colour("scan"));
  for (const mark of document.querySelectorAll("i[data-colour]"))
    mark.style.setProperty("--colour", colour(mark.dataset.colour));
  const root = document.documentElement.style;
  for (const [name, of] of [...Object.entries(BADGES), ["free", "free"]]) root.setProperty(`--${name}`, colour(of));
  root.setProperty("--shades", shadesOfGain().join());
  dirty = true;
}

document.addEventListener("keydown", (event) => {
  if (event.target.tagName === "SELECT" || event.ctrlKey || event.metaKey || event.altKey) return;
  const keys = { k: "play", v: "mode", f: "follow", 0: "fit", l: "live" };
  for (const [key, what] of [["a", "keep"], ["g", "send"], ["m", "drive"]]) if (!element(what).hidden) keys[key] = what;
  if (event.key === " " && !element("stop").hidden) element("stop").click();
  else if (event.key === "Escape" && armed) arm("");
  else if (drivenBy(event.key)) {
    /* It is asked for. */
  } else if (event.key === "ArrowRight" || event.key === "ArrowLeft") step(event.key === "ArrowRight" ? 1 : -1);
  else if (keys[event.key]) element(keys[event.key]).click();
  else return;
  event.preventDefault();
});
