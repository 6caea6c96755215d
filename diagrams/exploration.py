"""Missions from Python, with each Drake object at hand: `tfg_drake.explore`, `tfg_drake.fork`."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import io
import logging
import math
import sys
import threading
from collections.abc import Sequence
from pathlib import Path
from types import EllipsisType
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import Context, Diagram, System

from tfg_drake.bad_input import BadInput
from tfg_drake.diagrams.compile_kernels import make_kernels_ready
from tfg_drake.diagrams.explorer import MakeTfgExplorer
from tfg_drake.diagrams.hardware_station import Bounded
from tfg_drake.diagrams.mapping_explorer import MappingMethod
from tfg_drake.diagrams.methods import FindMethod, Method, MethodError
from tfg_drake.diagrams.missions.fork import Fork, ForkError, check_same, forkable
from tfg_drake.diagrams.missions.mission import Mission, MissionRequest
from tfg_drake.diagrams.missions.page import open_page
from tfg_drake.diagrams.missions.real_robot import DevicesOf, Rehearse, RobotOf
from tfg_drake.diagrams.missions.report import figure_of
from tfg_drake.diagrams.missions.resume import cut_short
from tfg_drake.diagrams.missions.run import RunResult, run_mission
from tfg_drake.diagrams.missions.run_folder import check_kept, remarks_on_screen, run_name
from tfg_drake.diagrams.parts import CheckFactory, Factory, MakePart
from tfg_drake.diagrams.recorded_station import RecordedRobot, RecordedScenario, RecordingOf, length_of
from tfg_drake.diagrams.robots import SIMULATED, Robot
from tfg_drake.diagrams.scenario import PrepareScenario, Scenario
from tfg_drake.diagrams.station import MakeTurtlebotStation
from tfg_drake.mapfile.summary import landmark_counts
from tfg_drake.messages import FloatArray, MapEstimate, MissionStatus, TfgMap
from tfg_drake.storage.run import Run

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pydrake.geometry import Meshcat

_log = logging.getLogger("tfg_drake.operator")


def explore(
    scenario: str | Path | Scenario = "paper",
    *,
    seed: int | None = None,
    settings: Sequence[str] = (),
    world: str | Path | None = None,
    tag_spacing: float | EllipsisType | None = ...,
    start: Sequence[float] | None = None,
    method: str = "tfg",
    goal_selector: Factory | None = None,
    estimator: Factory | None = None,
    planner: Factory | None = None,
    follower: Factory | None = None,
    plant: Factory | None = None,
    station: Factory | None = None,
    enable: bool = False,
    meshcat: Meshcat | None = None,
    page: bool = False,
    map: str | Path | None = None,
    resume: str | Path | None = None,
    out: str | Path | None = None,
    realtime_rate: float = 0.0,
    until: float = 3600.0,
) -> Exploration:
    """Build a mission and drive it.

    A simulated mission can be driven on, step by step. One that is kept (out, page), and that of a real robot, ends
    when explore returns, as by the command line: the same seed gives the same files.

    Args:
        scenario: a shipped scenario's name, a YAML file, or one in memory.
        seed: of every random number; None for the scenario's own.
        settings: such as "explorer.stop_gain=10".
        world: other walls, as `tfg-drake explore --world`.
        tag_spacing: m, places tags so far apart; None: without any tag; by default as the scenario has them.
        start: (x, y, yaw), m and rad.
        method: what explores, as `tfg-drake explore --method`.
        goal_selector, estimator, planner, follower: each makes a part for the scenario, in place of the method tfg's
            own, as MakeTfgExplorer has them. A Factory is a function of a Scenario that returns a System, or a class
            whose instances are made with a Scenario, such as `estimator=lambda scenario: MyEstimator(0.1)`.
        plant: makes likewise what moves in the simulated station, see MakeTurtlebotStation.
        station: makes the station, in place of MakeTurtlebotStation; a System with its ports. One that plays a laser
            recording, as `functools.partial(MakeRecordedStation, recording="drive.mcap")` makes it, is mapped by method
            walls (the default) or grid, with an estimator of one's own if there is one. That of a real robot,
            as `functools.partial(MakeTurtlebotStation, hardware=True)` makes it, keeps real time; its mission is
            rehearsed in simulation first and kept, and the robot is closed at the end.
        enable: a real robot may move from the beginning; else when somebody enables it, by the page or its buttons.
        meshcat: where the mission is shown as it goes on; `pydrake.all.StartMeshcat()` makes one.
        page: serve the page that shows and operates it until explore returns; its address is printed.
        map: the file of a map of the building, or the folder of a run: the mission begins with it; its summary's
            `changes` tells what has changed since.
        resume: the folder of a mission that was cut short, to go on with: its scenario and seed are the run's, and its
            method by name; a method, parts or a station of one's own are given again.
        out: the run's folder; with a page or a real robot runs/<time>-<name>-<seed> by default, else none is kept. A
            simulated run that is in it is replaced.
        realtime_rate: simulated s per second at most, 0 for as fast as possible.
        until: s to drive, or less where the mission ends before; 0 to build it only.

    Returns:
        The Exploration, driven until it ended or for `until` s: its Drake objects, its map, what it says at each port.

    Raises:
        ScenarioError, MethodError: the scenario or the method cannot be used.
        ValueError: until or realtime_rate is negative.
        TypeError: a part is given that is no such function, or lacks a port that others listen to, or has another kind
            of message there.
        BadInput: the folder holds a real robot's run, or the scenario that is read; the page cannot be served; or there
            is no mission to go on with.
        DeviceError: the robot cannot be used.
        OSError: the folder cannot be written.
    """
    for what, value in (("until", until), ("realtime_rate", realtime_rate)):
        if not value >= 0.0:
            raise ValueError(f"{what} {value:g}: must be 0 or more")
    if isinstance(tag_spacing, str):
        raise TypeError(f"tag_spacing {tag_spacing!r}: must be metres, or None for no tags")
    spacing = None if tag_spacing is ... else math.inf if tag_spacing is None else tag_spacing
    parts = {"goal_selector": goal_selector, "estimator": estimator, "planner": planner, "follower": follower}
    own: dict[str, Any] = {role: factory for role, factory in parts.items() if factory is not None}
    for role, factory in {**own, "plant": plant, "station": station}.items():
        CheckFactory(role, factory)
    if plant is not None and station is not None:
        raise TypeError("plant: is for the usual station; put it into the one that station= makes")
    named = "" if isinstance(scenario, Scenario) else str(scenario)
    make_kernels_ready()
    before = None
    if resume is not None:
        if out is not None and Path(out).resolve() != Path(resume).resolve():
            check_kept(Path(out))
        before = cut_short(Path(resume), None if out is None else Path(out))
        request, method = before.request, method if before.own else before.method
    else:
        loaded = PrepareScenario(scenario, settings, seed, world, spacing, start, map)
        name = run_name(named or "mission", None if world is None else Path(world))
        request = MissionRequest(loaded, name=name, world_name=str(world or named), out_dir=Path(out) if out else None)
    loaded = request.scenario
    if own and method not in ("tfg", "own"):
        raise MethodError(f"{method}: has parts of its own; with {'=, '.join(own)}= leave method out")
    if before is not None and before.own and method == "tfg" and not own:
        raise BadInput(f"{resume}: its method, {before.method}, is somebody's own; give it or its parts again")
    robot, explorer = SIMULATED, None
    if station is not None:
        made = MakePart("station", station, station, loaded)
        recording = RecordingOf(made)
        if recording is None:
            robot, loaded = _robot_of(made, loaded, enable)
        else:
            robot, request = RecordedRobot(recording, made), dataclasses.replace(request, name=recording.name)
            loaded = RecordedScenario(recording, loaded)
            explorer = MappingMethod("walls" if method == "tfg" else method, length_of(recording), **own)
    if explorer is None:
        explorer = Method("own", functools.partial(MakeTfgExplorer, **own)) if own else FindMethod(method)
    explorer.Check(loaded)
    if plant is not None:
        robot = dataclasses.replace(robot, MakeStation=functools.partial(MakeTurtlebotStation, plant=plant))
    if before is not None and before.robot != robot.name:
        raise BadInput(f"{resume}: that run drove {before.robot}, not {robot.name}; give its station= again")
    request = dataclasses.replace(request, scenario=loaded, method=explorer, robot=robot, meshcat=meshcat)
    request = dataclasses.replace(request, realtime_rate=realtime_rate, max_time=until)
    if request.out_dir is None and not page and not robot.real:
        mission = Mission(request)
        mission.begin()
        mission.simulator.set_target_realtime_rate(realtime_rate)
        return Exploration(mission).advance(until)
    with contextlib.ExitStack() as stack:
        stack.callback(robot.close)
        if out is not None and before is None:
            check_kept(Path(out), inputs=[Path(named)])
        cockpit = None
        if page:
            rate = None if robot.real else realtime_rate
            cockpit = stack.enter_context(open_page(request.title, "localhost", None, rate=rate))
        stack.enter_context(remarks_on_screen(sys.stderr))
        if robot.real:
            Rehearse(loaded, explorer, threading.Event())
        result = run_mission(request, cockpit=cockpit)
    if result.mission.failure is not None:
        raise result.mission.failure
    return Exploration(result.mission, result)


def fork(
    run: Run | str | Path, stage: int, *, goal: Sequence[float] | None = None, candidate: int | None = None
) -> Simulator:
    """A simulator of a run at a stage, its goal chosen and not yet driven to, to go on with.

    Args:
        run: the folder of a simulated run, or what `load_run` read of it.
        stage: which, from 1 on.
        goal: (2,) in W, m: drive there instead, to the reachable place next to it, and look round.
        candidate: or to the candidate of this number, 1 for that with the most gain.

    The simulator's system is the mission's diagram with "station" and "explorer"; its Context can be cloned. Whatever
    was asked for is driven to while the simulator is advanced. Without a goal or candidate it ends as the run did, to
    the bit.

    Raises:
        ForkError: the run cannot be forked there; see `forkable` and `Fork`.
    """
    make_kernels_ready()
    run, request = forkable(run, stage)
    monitor = functools.partial(Fork(stage, goal, candidate).monitor, stops=True)
    mission = Mission(dataclasses.replace(request, monitor=monitor))
    mission.begin()
    if mission.advance(math.inf):
        raise ForkError(f"stage {stage}: the mission ended before it")
    check_same(run, mission.stages, stage)
    return mission.simulator


def _robot_of(station: System, scenario: Scenario, enable: bool) -> tuple[Robot, Scenario]:
    """The robot of a station of one's own, and the scenario within its limits."""
    devices = DevicesOf(station)
    if devices is None:
        return dataclasses.replace(SIMULATED, MakeStation=lambda _: station), scenario
    if not enable:
        _log.warning("nothing moves before it is enabled: by enable=True, the page or the robot's buttons")
    return RobotOf(scenario, devices, (), lambda _: station, enabled=enable), Bounded(scenario, devices)


class Exploration:
    """A mission under way or ended. In a notebook it shows itself, as `figure` draws it.

    scenario: all that defines it. Its Drake objects: simulator, of the context, where `advance` also notes what happens
    meanwhile; diagram, the whole of station, the robot, explorer, logs and picture; and context, the diagram's root
    Context. stages: a row a stage, as in a run's stages.jsonl. folder: where it was kept, summary: as its summary.json;
    None where it was not.
    """

    def __init__(self, mission: Mission, kept: RunResult | None = None) -> None:
        """mission: begun; kept: what has become of it."""
        self.scenario, self._mission = mission.scenario, mission
        self.simulator: Simulator = mission.simulator
        self.diagram: Diagram = mission.simulator.get_system()
        self.station: System = self.diagram.GetSubsystemByName("station")
        self.explorer: Diagram = mission.explorer
        self.stages: list[dict[str, Any]] = mission.stages
        self.folder: Path | None = None if kept is None else kept.folder
        self.summary: dict[str, Any] | None = None if kept is None else kept.summary

    @property
    def context(self) -> Context:
        """The diagram's, with all state; a system's own is `system.GetMyContextFromRoot(context)`."""
        return self.simulator.get_mutable_context()

    @property
    def time(self) -> float:
        """Simulated s so far."""
        return self._mission.time

    @property
    def outcome(self) -> str:
        """How the mission ended, "" while it has not."""
        return self._mission.outcome or self.status.outcome

    @property
    def status(self) -> MissionStatus:
        """The mission's status."""
        return self._mission.status

    @property
    def map(self) -> MapEstimate | None:
        """The landmarks and views in the map frame M; None before the first view, and of a grid."""
        return self._mission.map

    @property
    def tfg(self) -> TfgMap | None:
        """The surfaces, free space and frontiers in M."""
        return self._mission.tfg

    @property
    def X_WM(self) -> FloatArray:
        """(3,) pose of the map frame in the world, m and rad."""
        return self._mission.X_WM

    @property
    def X_WB(self) -> tuple[FloatArray, FloatArray]:
        """Stamps (n,), s, and poses (n, 3), m and rad, as they were estimated at the time."""
        return self._mission.estimated_poses()

    @property
    def X_WB_true(self) -> tuple[FloatArray, FloatArray]:
        """The same, the truth, with stamps of its own."""
        return self._mission.true_poses() or (np.zeros(0), np.zeros((0, 3)))

    def advance(self, seconds: float = math.inf) -> Exploration:
        """Simulate so many s more, to the mission's end, or until a monitor of the simulator ends it. Returns itself.

        Raises:
            ValueError: seconds is negative.
            RuntimeError: the mission was kept, or is that of a real robot, and is over.
        """
        if self.folder is not None:
            raise RuntimeError(f"{self.folder}: the run is over; only one without out=, page= or a real robot goes on")
        if not seconds >= 0.0:
            raise ValueError(f"{seconds:g} s: must be 0 or more; time does not run backwards")
        self._mission.forgive_delay()
        self._mission.advance(self.time + seconds)
        return self

    def look(self, port: str) -> Any:
        """Value now of a port of the explorer or, for names such as "truth.pose", of the station: a message, or a
        vector (n,). Raises KeyError where neither has such a port."""
        for system in (self.explorer, self.station):
            if system.HasOutputPort(port):
                return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(self.context))
        systems = (self.explorer, self.station)
        names = [one.get_output_port(i).get_name() for one in systems for i in range(one.num_output_ports())]
        raise KeyError(f"no port {port}; there are {', '.join(names)}")

    def figure(self) -> Figure:
        """The building, the map so far and the way, as a matplotlib Figure; `savefig` writes it."""
        # What could have been reached is a run's summary's to say.
        return figure_of(self._mission, self._title, self.map, self.tfg)

    @property
    def _title(self) -> str:
        now = self.outcome or self.status.phase
        return f"{self._mission.request.name}, seed {self.scenario.seed}: {now} after {self.time:.0f} s"

    def _repr_png_(self) -> bytes:
        buffer = io.BytesIO()
        self.figure().savefig(buffer, format="png", dpi=100)
        return buffer.getvalue()

    def __repr__(self) -> str:
        landmarks = landmark_counts(len(self.map.ids) if self.map is not None else 0, self._mission.walls)
        return f"<{self._title}, {len(self.stages)} stages, {landmarks}>"
