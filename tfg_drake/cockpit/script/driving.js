// Driving: the robot is sent to the place that is clicked, or follows keys and a gamepad where somebody drives it.

const DRIVING = {
  send: "Click on the picture to send the robot there (g)",
  drive: "Drive by w a s d x or arrows (l looks round) or by a gamepad: stick, A looks round, B is STOP (m)",
};
// What the keys of the terminal are called, see tfg_drake/mission/manual_drive.py.
const DRIVE_KEYS = {
  ...{ w: "forward", x: "back", a: "left", d: "right", s: "halt", l: "look" },
  ...{ ArrowUp: "forward", ArrowDown: "back", ArrowLeft: "left", ArrowRight: "right" },
};
// A stick nearer to its middle is at rest; seconds between two requests of one that is not.
const AT_REST = 0.12,
  STICK_PERIOD = 0.15;
let armed = ""; // which of DRIVING is on

function arm(what) {
  if (armed === "drive" && what !== "drive") request("key", { key: "halt" });
  armed = armed === what ? "" : what;
  for (const name of [...Object.keys(DRIVING), "keep"]) pressed(name, armed === name);
  element("scene").style.cursor = ["send", "keep"].includes(armed) ? "crosshair" : "";
  if (!armed || armed === "keep") return;
  setPlaying(false);
  setLive(true);
}

for (const [name, hint] of Object.entries(DRIVING)) {
  element(name).title = hint;
  element(name).onclick = () => arm(name);
}

/** Where on the floor somebody has clicked, m in M; null above the horizon. */
function placeAt(event) {
  const box = viewer.renderer.domElement.getBoundingClientRect(),
    ray = new T.Raycaster();
  const x = (2 * (event.clientX - box.left)) / box.width - 1,
    y = 1 - (2 * (event.clientY - box.top)) / box.height;
  ray.setFromCamera(new T.Vector2(x, y), viewer.camera);
  const floor = ray.ray.intersectPlane(new T.Plane(new T.Vector3(0, 1, 0)), new T.Vector3());
  return floor && map.worldToLocal(floor);
}

const asked = moves(new T.Group()); // where the robot was sent, until it says itself where it goes
map.add(asked);
let down = null;
element("scene").addEventListener("pointerdown", (event) => {
  down = [event.clientX, event.clientY];
});
element("scene").addEventListener("click", (event) => {
  // Who moves the picture sends nobody.
  if (armed !== "send" || !down || Math.hypot(event.clientX - down[0], event.clientY - down[1]) > 4) return;
  const place = placeAt(event);
  if (!place) return;
  const look = material("path", { above: true, opacity: 0.6 });
  put(asked, "asked", discs([place.x, place.y], null, 5 * unit, Z.path, look, 5, RING));
  dirty = true;
  request("goal", { x: place.x, y: place.y });
});
timeline.listeners.push((layer) => {
  if (layer === "goal") put(asked, "asked", null);
});

/** Whether a key drives the robot. */
function drivenBy(key) {
  if (armed !== "drive" || !DRIVE_KEYS[key]) return false;
  request("key", { key: DRIVE_KEYS[key] });
  return true;
}

let stickAt = -Infinity,
  stickMoved = false,
  buttonsDown = [];
/** Asks the first gamepad what it wants; called with every picture of the browser. */
function readGamepad(now) {
  const pad = armed === "drive" ? [...navigator.getGamepads()].find((one) => one) : null;
  if (!pad) return;
  const calm = (value) => (Math.abs(value) < AT_REST ? 0 : value);
  const forward = -calm(pad.axes[1]),
    left = -calm(pad.axes[0]) || -calm(pad.axes[2] ?? 0),
    moved = Boolean(forward || left);
  if ((moved && now > stickAt + 1000 * STICK_PERIOD) || (stickMoved && !moved)) {
    request("stick", { x: forward, y: left });
    stickAt = now;
  }
  stickMoved = moved;
  const buttons = pad.buttons.map((button) => button.pressed);
  if (buttons[0] && !buttonsDown[0]) request("key", { key: "look" });
  if (buttons[1] && !buttonsDown[1]) request("stop");
  buttonsDown = buttons;
}
