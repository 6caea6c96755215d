// The operator: what is asked of the mission.

function token() {
  return new URLSearchParams(location.hash.slice(1)).get("token") ?? "";
}

function notice(text) {
  element("notice").textContent = text;
  element("notice").hidden = !text;
}

/** Asks for something; for a stop again and again, where the server is so busy that it hangs up. */
async function request(what, more = {}, tries = what === "stop" ? 5 : 1) {
  try {
    const answer = await fetch("request", {
      method: "POST",
      headers: { "X-Token": token() },
      body: JSON.stringify({ request: what, ...more }),
    });
    notice(answer.ok ? "" : await answer.text());
  } catch {
    if (tries > 1) return request(what, more, tries - 1);
    notice("The mission's program does not answer.");
  }
}

/** Lets only that be asked for which changes something. held: the clock of a simulation is, undefined without one. */
function allow(held) {
  const waits = held ?? timeline.at("mission", Infinity)?.told.phase === "paused",
    enable = Boolean(timeline.at("enabled", Infinity)?.told.enabled),
    idle = { hold: waits, resume: !waits || (held === undefined && !enable), enable };
  for (const what in idle) if (element(`request-${what}`)) element(`request-${what}`).disabled = idle[what];
}

let built = false;
function buildControls(world) {
  const controls = Boolean(SOURCE && SOURCE.controls),
    wheels = world.wheels !== false; // Nobody drives a recording.
  if (!wheels) for (const what of ["stop", "keep"]) element(what).hidden = true;
  if (!controls || built) return;
  built = true;
  const clock = world.simulated ? "the clock of the simulation" : "the mission";
  const buttons = [
    ["hold", "Pause", `Hold ${clock}`],
    ["resume", "Resume", `Go on with ${clock}`],
    ["step", "Step a stage", "Go on until the next stage, then pause"],
  ];
  const enable = ["enable", world.simulated ? "Enable wheels" : "Start", "Enable the wheels, also after a stop"];
  const push = [
    "push",
    "Push",
    "Push the robot half a metre to its left and turn it by 30 degrees, and see it recover",
  ];
  if (world.simulated) buttons.push(enable, push);
  else buttons.unshift(enable);
  buttons.push(
    ["recall", "Return home", "Explore no more, and come back to where it began"],
    ["end", "End", "End the mission, and write what is known"],
  );
  for (const [what, words, hint] of buttons) {
    if (!wheels && ["enable", "push", "recall"].includes(what)) continue;
    const button = document.createElement("button");
    Object.assign(button, { id: `request-${what}`, textContent: words, title: hint });
    button.onclick = () => request(what);
    element("controls").append(button);
  }
  if (world.simulated) {
    const rate = document.createElement("select");
    Object.assign(rate, { id: "clock-rate", title: "Speed of the simulation, times real time" });
    for (const [value, words] of [
      [1, "1 ×"],
      [2, "2 ×"],
      [4, "4 ×"],
      [8, "8 ×"],
      [16, "16 ×"],
      [0, "no limit"],
    ])
      rate.append(new Option(words, value, false, value === SOURCE.rate));
    if (![...rate.options].some((option) => Number(option.value) === SOURCE.rate))
      rate.append(new Option(`${SOURCE.rate} ×`, SOURCE.rate, false, true));
    rate.onchange = () => request("rate", { rate: Number(rate.value) });
    element("controls").append(made("label", {}, "speed ", rate));
  }
}
