// Areas that the robot must not enter, drawn by hand: the page tells the setting to begin the next mission with. It asks
// nothing of a mission under way, whose planner and safety filter have the areas that it began with.

const areas = { closed: [], open: [], drawn: moves(new T.Group()) }; // corners [x, y], m in W
world.add(areas.drawn);
element("keep").onclick = () => {
  arm("keep");
  tellAreas();
};

element("scene").addEventListener("click", (event) => {
  if (armed !== "keep" || !down || Math.hypot(event.clientX - down[0], event.clientY - down[1]) > 4) return;
  const place = placeAt(event);
  if (!place) return;
  const corner = inWorld(frameAt(time), place.x, place.y).map((value) => Number(value.toFixed(2))),
    [first] = areas.open,
    near = first && Math.hypot(corner[0] - first[0], corner[1] - first[1]) < 12 * metresPerPixel();
  if (!near) areas.open.push(corner);
  else if (areas.open.length > 2) areas.closed.push(areas.open.splice(0));
  tellAreas();
});

function drawAreas() {
  const edges = (corners, ring) => corners.flatMap((p, i) => (i || ring ? [...corners.at(i - 1), ...p] : [])),
    segments = [...areas.closed.flatMap((corners) => edges(corners, true)), ...edges(areas.open, false)],
    look = material("keep_out", { above: true });
  put(areas.drawn, "edges", boxes(segments, null, 1.2 * unit, 0.004, Z.path, look, 6));
  put(areas.drawn, "corners", discs(areas.open.flat(), null, 2.2 * unit, Z.path, look, 6, DISC));
  dirty = true;
}

/** Says what there is to do, or what was drawn as text to take along. */
function tellAreas() {
  drawAreas();
  const { closed, open } = areas,
    section = element("areas");
  section.hidden = armed !== "keep" && !closed.length;
  const text = `--set explorer.keep_out='${JSON.stringify(closed)}'`,
    button = (words, then) => Object.assign(made("button", {}, words), { onclick: then });
  const undo = () => {
    if (open.length) open.pop();
    else closed.pop();
    tellAreas();
  };
  section.replaceChildren(
    made("h2", {}, "Keep-out areas"),
    made("p", {}, "Click the corners of an area; a click on its first closes it."),
    ...(closed.length ? [made("code", {}, text), made("p", {}, "For the next mission, in place of its scenario's areas.")] : []),
    ...(closed.length ? [button("Copy", () => navigator.clipboard?.writeText(text))] : []),
    ...(closed.length || open.length ? [button("Undo", undo)] : []),
  );
}
