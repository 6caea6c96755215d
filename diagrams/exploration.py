"""Missions from Python with access to every Drake object: `tfg_drake.explore`, `tfg_drake.fork`."""

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
    """Build a mission and run it.

    A simulated mission can be advanced further, step by step. A mission whose files are kept (out, page) and that of a
    real robot are over when explore returns. They leave the files of the command line; equal seeds give equal files.

    Args:
        scenario: name of a shipped scenario, a YAML file, or a Scenario in memory.
        seed: seed of all random numbers; None for the scenario's own.
        settings: changes of the scenario, such as "explorer.stop_gain=10". Not of what the method fixes.
        world: other walls, as `tfg-drake explore --world`.
        tag_spacing: distance between the tags to place, m; None removes all tags; by default the scenario's tags.
        start: (x, y, yaw) of the start in W, m and rad.
        method: the exploration method, as `tfg-drake explore --method`.
        goal_selector, estimator, planner, follower: factories of parts that replace those of the method tfg, see
            MakeTfgExplorer. A Factory is a function of a Scenario that returns a System, or a class whose constructor
            takes a Scenario, such as `estimator=lambda scenario: MyEstimator(0.1)`.
        plant: factory of the plant of the simulated station, see MakeTurtlebotStation.
        station: factory of a System with the ports of MakeTurtlebotStation that replaces it. A station that plays a
            laser recording, `functools.partial(MakeRecordedStation, recording="drive.mcap")`, is mapped by the method
            walls (the default) or grid; estimator= may replace the estimator. A station of a real robot,
            `functools.partial(MakeTurtlebotStation, hardware=True)`, runs in real time; the mission is first rehearsed
            in simulation, its files are kept, and the robot's devices are closed at the end. Any other station counts
            as simulated, even if it drives a robot: with the output `truth.pose` the scenario's world and start are
            true, else unknown. There is no enabling, no watchdog and no limit of the rate. For a robot pass
            realtime_rate=1.0, and let its driver stop the wheels when this program hangs. Safer is a driver behind ROS
            or rosbridge, with a preset.
        enable: the wheels of a real robot are enabled from the beginning; otherwise by the page or its buttons.
        meshcat: a Meshcat that shows the running mission, such as `pydrake.all.StartMeshcat()`.
        page: serve the page that shows and operates the mission until explore returns, and print its address.
        map: a map file of the building, or the folder of a run, to begin with; `changes` in the summary lists what has
            changed since.
        resume: folder of an interrupted mission to continue, in this folder unless out is given. Scenario, settings,
            seed, world, start, map and a method known by name are the run's, and refused here; a method, parts or a
            station of your own must be given again.
        out: the run's folder; by default runs/<time>-<name>-<seed> with a page or a real robot, otherwise no files are
            kept. A simulated run in the folder is replaced.
        realtime_rate: limit of simulated seconds per second; 0 for no limit.
        until: duration of the mission, s, unless it ends earlier; 0 only builds it.

    Returns:
        The Exploration, run for `until` s or to its end: its Drake objects, its map, the values of all ports.

    Raises:
        ScenarioError, MethodError: the scenario or the method cannot be used.
        ValueError: until or realtime_rate is negative.
        TypeError: a part is not a factory, lacks a port that another part reads, or has another type of message there.
        BadInput: the folder holds a real robot's run or the scenario file itself; the page cannot be served; or there
            is no mission to resume.
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
        given: dict[str, Any] = {"seed": seed, "world": world, "start": start, "map": map, "tag_spacing": spacing}
        given |= {"settings": settings or None, "scenario": None if named == "paper" else scenario}
        if again := [name for name, value in given.items() if value is not None]:
            raise BadInput(f"{'=, '.join(again)}=: of the run that is resumed, {resume}; leave out")
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
    robot: Robot = SIMULATED
    explorer: Method | None = None
    if station is not None:
        made = MakePart("station", station, station, loaded)
        recording = RecordingOf(made)
        if recording is None:
            explorer = _explorer_of(method, own)
            robot, loaded = _robot_of(made, explorer.Fixed(loaded), enable)
        else:
            robot, request = RecordedRobot(recording, made), dataclasses.replace(request, name=recording.name)
            loaded = RecordedScenario(recording, loaded)
            explorer = MappingMethod("walls" if method == "tfg" else method, length_of(recording), **own)
    explorer = explorer or _explorer_of(method, own)
    explorer.Check(loaded, settings)
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
    """Return a simulator of a run at a stage, with the goal chosen but not yet driven to.

    Args:
        run: the folder of a simulated run, or its Run from `load_run`.
        stage: number of the stage, from 1 on.
        goal: (2,) another goal in W, m: the robot drives to the nearest reachable place, at most 0.5 m away, and looks
            around.
        candidate: or the number of another candidate, 1 for the one with the most gain.

    The simulator's system is the mission's diagram with "station" and "explorer"; its Context can be cloned. The robot
    drives to the new goal as the simulator advances. Without goal and candidate the mission ends as the run did, to the
    bit.

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


def _explorer_of(method: str, own: dict[str, Any]) -> Method:
    """Return a method by its name, or the method tfg with a user's own parts."""
    return Method("own", functools.partial(MakeTfgExplorer, **own)) if own else FindMethod(method)


def _robot_of(station: System, scenario: Scenario, enable: bool) -> tuple[Robot, Scenario]:
    """Return the robot of a user's station, and the scenario within its limits."""
    devices = DevicesOf(station)
    if devices is None:
        known = station.HasOutputPort("truth.pose")
        return dataclasses.replace(SIMULATED, MakeStation=lambda _: station, world_known=known), scenario
    if not enable:
        _log.warning("nothing moves before it is enabled: by enable=True, the page or the robot's buttons")
    return RobotOf(scenario, devices, (), lambda _: station, enabled=enable), Bounded(scenario, devices)


class Exploration:
    """A running or finished mission. A notebook displays its `figure`.

    scenario: the Scenario that defines it. Its Drake objects: simulator (advance it by `advance`, which also notes
    the stages); diagram, which contains station, explorer and recorders; station; explorer; context, the
    diagram's root Context. stages: one row per stage, as in a run's stages.jsonl. folder: the run's folder, summary:
    the contents of its summary.json; both None if no files are kept.
    """

    def __init__(self, mission: Mission, kept: RunResult | None = None) -> None:
        """mission: a mission that has begun; kept: its result if it is finished and its files are kept."""
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
        """The diagram's root Context with all state; a system's own is `system.GetMyContextFromRoot(context)`."""
        return self.simulator.get_mutable_context()

    @property
    def time(self) -> float:
        """The simulated time, s."""
        return self._mission.time

    @property
    def outcome(self) -> str:
        """The outcome of the mission, "" while it runs."""
        return self._mission.outcome or self.status.outcome

    @property
    def status(self) -> MissionStatus:
        """The mission's status."""
        return self._mission.look("mission", MissionStatus)

    @property
    def map(self) -> MapEstimate | None:
        """The tags and views in the map frame M; None before the first view, and for grid methods."""
        now = self._mission.look_for("map", MapEstimate)
        return now if now is not None and now.stage else None

    @property
    def tfg(self) -> TfgMap | None:
        """The surfaces, free space and frontiers in M; None for grid methods."""
        return self._mission.look_for("tfg", TfgMap)

    @property
    def X_WM(self) -> FloatArray:
        """(3,) pose of the map frame in the world, m and rad."""
        return self._mission.X_WM

    @property
    def X_WB(self) -> tuple[FloatArray, FloatArray]:
        """Stamps (n,), s, and poses (n, 3), m and rad, of the online estimate."""
        return self._mission.estimated_poses()

    @property
    def X_WB_true(self) -> tuple[FloatArray, FloatArray]:
        """Stamps (m,), s, and true poses (m, 3), m and rad; the stamps differ from those of X_WB."""
        return self._mission.true_poses() or (np.zeros(0), np.zeros((0, 3)))

    def advance(self, seconds: float = math.inf) -> Exploration:
        """Simulate for `seconds` more, to the mission's end, or until the simulator's monitor stops. Returns self.

        Raises:
            ValueError: seconds is negative.
            RuntimeError: the mission is over, as its files are kept or it is that of a real robot.
        """
        if self.folder is not None:
            raise RuntimeError(f"{self.folder}: the run is over; only one without out=, page= or a real robot goes on")
        if not seconds >= 0.0:
            raise ValueError(f"{seconds:g} s: must be 0 or more; time does not run backwards")
        self._mission.forgive_delay()
        self._mission.advance(self.time + seconds)
        return self

    def look(self, port: str) -> Any:
        """The current value of an output port of the explorer or, for names such as "truth.pose", of the station: a
        message or a vector (n,). Raises KeyError if neither has the port."""
        for system in (self.explorer, self.station):
            if system.HasOutputPort(port):
                return system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(self.context))
        systems = (self.explorer, self.station)
        names = [one.get_output_port(i).get_name() for one in systems for i in range(one.num_output_ports())]
        raise KeyError(f"no port {port}; there are {', '.join(names)}")

    def figure(self) -> Figure:
        """A matplotlib Figure of the building, the map and the path so far; `savefig` writes it."""
        # The reachable area is computed for a run's summary only.
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
        return f"<{self._title}, {self.status.stage} stages, {landmarks}>"
