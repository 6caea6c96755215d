// The beginning: all is read, from the page itself or from its server.

async function readEmbedded() {
  const text = element("data").textContent.trim();
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  await timeline.feed(bytes);
}

/** What is going on that the timeline does not tell: asked for again and again. */
async function readState() {
  for (;;) {
    try {
      const state = await (await fetch("state")).json();
      const waiting = !timeline.layers.has("pose") || (state.word && !ended());
      if (waiting && state.word) notice(state.word);
      else if (element("notice").dataset.word) notice("");
      element("notice").dataset.word = waiting ? state.word : "";
      for (const what of ["send", "drive"]) element(what).hidden = !state[what] || Boolean(ended());
      if (built) allow(state.held);
      if (SOURCE.controls && "held" in state) {
        if (element("clock-rate") && document.activeElement !== element("clock-rate"))
          element("clock-rate").value = state.rate;
        element("clock").dataset.held = state.held;
        untold = true;
      }
    } catch {
      /* readServed tells it */
    }
    if (ended()) {
      element("controls").replaceChildren(made("span", { id: "over" }, "The mission is over."));
      for (const what of ["stop", "send", "drive"]) element(what).hidden = true;
      if (armed) arm("");
      notice("");
      return;
    }
    await pause(0.4);
  }
}

/** A recorded mission is played again and again, until the one that the server is to show begins. */
async function playRecorded() {
  element("rate").value = "4";
  element("notice").className = "recorded";
  setPlaying(true);
  for (;;) {
    try {
      const state = await (await fetch("state")).json();
      if (state.begun) return location.reload();
      notice(`A recorded mission; yours begins by itself. ${state.word[0]?.toUpperCase() ?? ""}${state.word.slice(1)}`);
    } catch {
      notice("The connection to the mission is lost.");
    }
    await pause(0.4);
  }
}

const pause = (seconds) => new Promise((resolve) => setTimeout(resolve, 1000 * seconds));

/** What the server has, and then what comes; where the connection is lost it goes on where it was. */
async function readServed() {
  let marks = [];
  for (;;) {
    try {
      const answer = await fetch(`${SOURCE.recorded ? "recorded" : "timeline"}?from=${timeline.read}`);
      const reader = answer.ok ? answer.body.getReader() : null;
      for (;;) {
        const { done, value } = reader ? await reader.read() : { done: true };
        if (done) break;
        notice("");
        await timeline.feed(value);
        const now = performance.now() / 1000;
        marks = [...marks.filter(([t]) => now - t < 3), [now, timeline.end]];
        const [first] = marks;
        // What came before the page, and while it was drawn for the first time, comes at once.
        speed = now - first[0] > 2 ? (timeline.end - first[1]) / (now - first[0]) : speed;
        fed = true;
      }
    } catch {
      /* told below */
    }
    if (ended() || !SOURCE.live) return;
    notice("The connection to the mission is lost.");
    await pause(1);
  }
}

async function begin() {
  element("layers").open = size()[0] > 760;
  element("live").hidden = !(SOURCE && SOURCE.live);
  paint();
  useCamera();
  requestAnimationFrame(picture);
  if (SOURCE) {
    setLive(SOURCE.live);
    if (SOURCE.live) readState();
    if (forks.possible) watchForks();
    const reading = readServed();
    if (!SOURCE.live) await reading;
  } else {
    await readEmbedded();
  }
  element("slider").max = timeline.end;
  if (!live) time = Number(new URLSearchParams(location.hash.slice(1)).get("t") ?? (SOURCE?.recorded ? 0 : timeline.end));
  if (location.hash.includes("3d")) element("mode").click();
  framed = true;
  shownBounds = "";
  render(); // Shaders are compiled before anybody waits for them.
  viewer.renderer.getContext().finish();
  document.body.dataset.ready = "true";
  if (SOURCE?.recorded) playRecorded();
}

new ResizeObserver(() => {
  shownBounds = "";
  resize();
}).observe(element("scene"));
begin();
