// The page of a mission: a timeline (see tfg_drake/storage/timeline.py) read from the file itself or from the server,
// drawn with the viewer that Drake ships. Lengths in metres, times in seconds of the mission.
"use strict";

const element = (id) => document.getElementById(id);

/** A new element. Words in it are text, whatever they hold: what a run's files say is never read as HTML. */
function made(tag, properties, ...content) {
  const node = Object.assign(document.createElement(tag), properties);
  node.append(...content);
  return node;
}

// Before anything that may fail: a page that cannot draw stops the robot all the same.
element("stop").hidden = !(SOURCE && SOURCE.controls);
element("stop").onclick = () => request("stop");
for (const event of ["error", "unhandledrejection"])
  addEventListener(event, (failure) => notice(`This page has failed: ${failure.message ?? failure.reason}`));

const T = MeshCat.THREE;
const dark = window.matchMedia("(prefers-color-scheme: dark)");
const colour = (name) => (name === "white" ? "#ffffff" : COLOURS[dark.matches ? "dark" : "light"][name]);
