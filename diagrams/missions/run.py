"""A whole mission: station, explorer and picture in one diagram, run to its end, and what is kept of it.

A run's folder holds summary.json, stages.jsonl (a line a stage), map.npz (grid.npz of a method that keeps a grid),
trajectory.tum (in W), truth.tum where the truth is known, keys.csv of a drive by hand, ports.mcap (what the station's
ports carried), timeline.tfg (what the mission looked like), mission.html (the page that shows it), figure.png,
scenario.yaml (resolved) and log.txt. The map is there while it grows, and checkpoint.bin as long as the mission can be
gone on with. A file that cannot be written, as to a full disk, ends no mission.
"""

from __future__ import annotations

import contextlib
import copy
import dataclasses
import gc
import logging
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tfg_drake import __version__
from tfg_drake.cockpit.page import FILE_NAME as PAGE
from tfg_drake.cockpit.page import export_page, viewer_script
from tfg_drake.diagrams.interruption import Interruption
from tfg_drake.diagrams.methods import METHODS
from tfg_drake.diagrams.missions.mission import STATE, Mission, MissionRequest, stage_lines
from tfg_drake.diagrams.missions.mission_runner import MissionRunner
from tfg_drake.diagrams.missions.report import write_map, write_report
from tfg_drake.diagrams.missions.resume import KNOWN_MAP, scenario_digest
from tfg_drake.diagrams.missions.run_folder import RunFolder, open_run_folder
from tfg_drake.diagrams.missions.summary_words import ON_PAGE, left_open_rows
from tfg_drake.diagrams.scenario import AreasOutside, DumpScenario, MakeWorld, Scenario
from tfg_drake.io.files import of_run, write_atomic
from tfg_drake.notes import NoteKeeper
from tfg_drake.storage import port_recording
from tfg_drake.storage import timeline as timeline_file
from tfg_drake.storage.checkpoint import FILE_NAME as CHECKPOINT
from tfg_drake.storage.checkpoint import write_checkpoint
from tfg_drake.storage.port_recording import FILE_NAME, PortWriter
from tfg_drake.storage.timeline import FILE_NAME as TIMELINE
from tfg_drake.storage.timeline import TimelineWriter
from tfg_drake.world.world import odd_tags

# Greatest share of the wall time spent on saving mission and map: a killed mission loses the work of a few seconds, of
# ten in a large building.
KEPT_SHARE = 0.03

# Fields of the summary too long for the page's last card.
TOO_LONG = ("open_edges", "openings")

_log, _of_world = logging.getLogger("tfg_drake.run"), logging.getLogger("tfg_drake.world")


@dataclasses.dataclass(frozen=True)
class RunResult:
    """A finished mission: the contents of summary.json and stages.jsonl, the folder they are in, the files there that
    could not be written, with the reason, the CPU seconds of the explorer's components by what they did, and the
    mission itself."""

    summary: dict[str, Any]
    stages: list[dict[str, Any]]
    folder: Path
    unwritten: dict[str, str]
    spent: dict[str, float]
    mission: Mission


def run_mission(request: MissionRequest | Scenario, **given: Any) -> RunResult:
    """Run one mission to its end and write its folder.

    request: what is asked for, or its scenario. given: by keyword, what else the MissionRequest has.

    The first Ctrl-C, SIGTERM or SIGHUP ends the mission (outcome "interrupted"), a second one raises KeyboardInterrupt.
    An error inside the diagram, or while it is built, ends it with outcome "fault"; its traceback goes to log.txt.
    Either way what there is gets written.

    Raises:
        FileError: the mission that is in out_dir cannot be gone on with.
        OSError: the folder cannot be written at the beginning, or another run is at work in it. What cannot be written
            later is told in the log and in the result.
    """
    request = MissionRequest(request) if isinstance(request, Scenario) else request
    request = dataclasses.replace(request, **given)
    scenario, method, robot, before = request.scenario, request.method, request.robot, request.before
    name, cockpit = f"{request.name}-{scenario.seed}", request.cockpit
    with open_run_folder(request.out_dir, name, goes_on=before is not None) as folder, folder.logging():
        if before is None:
            scenario = _with_map_kept(scenario, folder.path)
            request = dataclasses.replace(request, scenario=scenario)
        _log.info("tfg_drake %s: %s, %s, seed %d", __version__, method.name, request.name, scenario.seed)
        if request.record and robot.world_known:
            for line in (*odd_tags(MakeWorld(scenario.world)), *AreasOutside(scenario)):
                _of_world.warning(line)
        with contextlib.ExitStack() as stack:
            # Existing objects are exempt from garbage collection until the end; new ones, such as a figure's megabytes,
            # are collected.
            gc.freeze()
            stack.callback(gc.unfreeze)
            stack.callback(gc.collect)
            writer = timeline = None
            if request.record:
                ports = None if before is None else before.take("ports", port_recording.Standing)
                picture = None if before is None else before.take("timeline", timeline_file.Standing)
                writer = stack.enter_context(PortWriter(folder.path / FILE_NAME, robot.name, ports))
                watched = (lambda: cockpit.watched) if cockpit is not None else (lambda: False)
                timeline = stack.enter_context(TimelineWriter(folder.path / TIMELINE, watched, picture))
            if cockpit is not None and timeline is not None:
                cockpit.follow(folder.path / TIMELINE)
            folder.keep_reserve()
            interrupted = request.interrupted
            if interrupted is None:
                interrupted = Interruption()
                interrupted.first = lambda *_: None
                stack.enter_context(interrupted.heard())
            mission = Mission(request, writer, timeline)
            mission.notes += request.notes
            stack.enter_context(NoteKeeper(mission.notes))
            rows = [] if before is None else before.take("stages", STATE["stages"])
            folder.attempt("stages.jsonl", lambda path: write_atomic(path, stage_lines(rows)))
            told = {"scenario": request.name, "world": request.world, "seed": scenario.seed}
            told |= {"method": method.name, "own": bool(method.source) or method.name not in METHODS}
            told |= {"robot": robot.name, "scenario_digest": scenario_digest(folder.path)}
            keep = _keeper(mission, folder, told, writer, timeline) if writer and timeline else None
            MissionRunner(mission, interrupted).run(lambda line: folder.append("stages.jsonl", line), keep)
            folder.give_up_reserve()
            summary = write_report(mission, folder)
            if mission.outcome in ("complete", "stuck", "apart"):
                folder.attempt(CHECKPOINT, lambda path: path.unlink(missing_ok=True))
            mission.say(mission.outcome.replace("_", " "))
            mission.show()
            if timeline is not None:
                told = {name: value for name, value in summary.items() if name not in TOO_LONG}
                told["left_open"] = left_open_rows(summary, ON_PAGE)
                timeline.write("end", mission.time, {}, **told, folder=str(folder.path))
        if timeline is not None:
            page = lambda path: export_page(folder.path / TIMELINE, path, mission.request.title, viewer_script())  # noqa: E731
            folder.attempt(PAGE, page)
        for name, one in ((TIMELINE, timeline), (FILE_NAME, writer)):
            if one is not None and one.failure is not None:
                folder.unwritten[name] = one.failure.strerror or str(one.failure)
        folder.append("stages.jsonl", "")  # Write the lines that could not be written before.
        _log.info("%s: %s", summary["outcome"], summary["reason"])
    return RunResult(summary, mission.stages, folder.path, folder.unwritten, mission.meter.spent, mission)


def _with_map_kept(scenario: Scenario, folder: Path) -> Scenario:
    """Writes the scenario of a run into its folder, and the map that it begins with; the scenario that reads it
    there."""
    kept = copy.deepcopy(scenario)
    if scenario.explorer.known_map:
        path, known = folder / KNOWN_MAP, of_run(Path(scenario.explorer.known_map), "map.npz")
        if not (path.exists() and path.samefile(known)):
            write_atomic(path, known.read_bytes())
        kept.explorer.known_map = KNOWN_MAP
    write_atomic(folder / "scenario.yaml", DumpScenario(kept))
    if scenario.explorer.known_map:
        kept.explorer.known_map = str((folder / KNOWN_MAP).resolve())
    return kept


def _keeper(
    mission: Mission, folder: RunFolder, told: dict[str, Any], writer: PortWriter, timeline: TimelineWriter
) -> Callable[[bool], None]:
    """Keeps a mission under way on the disk, to be gone on with, and its map: as often as KEPT_SHARE allows, or now.

    told: of the mission, with its checkpoint.
    """
    kept_stage, again = 0, 0.0

    def keep_mission() -> None:
        state = mission.state()
        state["ports"] = port_recording.Standing, writer.standing()
        state["timeline"] = timeline_file.Standing, timeline.standing()
        stamps, X_WB = mission.estimated_poses()
        now = {**told, "sim_time_s": mission.time, "stamps": stamps, "X_WB": X_WB}
        now["contacts"] = None if mission.truth is None else mission.truth.contacts
        try:
            folder.attempt(CHECKPOINT, lambda path: write_checkpoint(path, now, state))
        except TypeError as error:  # A user's own part may have state of any type.
            folder.lost(CHECKPOINT, OSError(f"the mission could not be gone on with: {error}"))

    def keep(now: bool) -> None:
        nonlocal kept_stage, again
        if not now and time.monotonic() < again:
            return
        start = time.thread_time()
        newest = mission.tfg if mission.tfg is not None else mission.grid
        if newest is not None and newest.stage > kept_stage:
            write_map(folder, mission.grid, mission.newest_map(), final=False)
            kept_stage = newest.stage
        if math.isinf(mission.robot.end_time):  # A replay has its recording.
            keep_mission()
        again = time.monotonic() + (time.thread_time() - start) / KEPT_SHARE

    return keep
