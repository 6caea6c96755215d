"""One mission under way: its diagram, simulated step by step, and what is observed of it from outside."""

from __future__ import annotations

import dataclasses
import gc
import json
import logging
import math
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import Simulator, SimulatorStatus
from pydrake.systems.framework import Context, Diagram, EventStatus, System

from tfg_drake.diagrams.explorer import MapOfExplorer, StateOfExplorer, map_frame
from tfg_drake.diagrams.methods import Method
from tfg_drake.diagrams.mission_diagram import MakeMissionDiagram
from tfg_drake.diagrams.missions.truth import Truth
from tfg_drake.diagrams.robots import SIMULATED, Robot
from tfg_drake.diagrams.scenario import MakeWorld, Scenario
from tfg_drake.geometry.se2 import compose
from tfg_drake.geometry.star import covered_area
from tfg_drake.grid.frontier import FREE, classify
from tfg_drake.kernels import Compilation
from tfg_drake.mapfile.saved_map import SavedMap
from tfg_drake.messages import FloatArray, GoalChoice, GridMap, MapEstimate, MissionStatus, PoseEstimate, TfgMap
from tfg_drake.mission.manual_drive import Pressed
from tfg_drake.pictures import scene
from tfg_drake.slam.camera_model import CameraModel, exact_camera
from tfg_drake.slam.estimator import finished_map
from tfg_drake.slam.estimator_state import EstimatorState, known_camera
from tfg_drake.slam.pose_prediction import pose_at
from tfg_drake.storage.port_recording import PortWriter
from tfg_drake.storage.timeline import TimelineWriter
from tfg_drake.systems.cpu_meter import CpuMeter
from tfg_drake.world.changing import world_at
from tfg_drake.world.world import World

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

    from tfg_drake.cockpit.server import Cockpit
    from tfg_drake.mission.clock import Clock
    from tfg_drake.systems.picture import Picture
    from tfg_drake.systems.visualizer import TfgVisualizer

# Whose CPU time counts as the estimator's, as a stage's planning, and as the planner's on the whole.
ESTIMATOR = ("slam_estimator", "grid_mapper")
STAGE = ("tfg", "roadmap", "goal", "path")
PLANNER = (*STAGE, "prm_planner", "goal_selector", "grid_planner", "follower")

# A line of stages.jsonl.
STAGE_FIELDS = (
    "stage",
    "goal",
    "exploitation",
    "exploration",
    "pose_price",
    "predicted_gain",
    "realised_gain",
    "time_s",
    "entropy_nats",
    "landmarks",
)
# Time between two looks at the mission, s, simulated or real; a stage takes several times as long.
STEP = 1.0
REAL_STEP = 0.25
# While kernels are compiled a mission goes at least so fast, times real time, and so far, s, from one look at them to
# the next: the picture moves every second.
SLOWEST = 0.15
SLOW_STEP = 0.125
# Where a page is open its wishes are looked at so often, simulated s, and while the clock is held, s of wall time.
WATCHED_STEP = 0.125
HELD_INTERVAL = 0.05
# Wall time between two looks at the area seen, s: of a large building it takes a tenth of a second.
AREA_INTERVAL = 5.0
# A robot that observes this near to its goal was there, m.
AT_GOAL = 0.3

_log = logging.getLogger("tfg_drake.run")


@dataclasses.dataclass(frozen=True)
class Progress:
    """The progress of a mission: simulated and wall time (s), phase, views in the map, landmarks in the map, area seen
    (m^2), error of the estimated position (m), nan where the truth is not known; outcome: "" until it has ended; word:
    what else is done meanwhile."""

    time: float
    wall_time: float
    phase: str
    stage: int
    landmarks: int
    area: float
    position_error: float
    outcome: str = ""
    word: str = ""


@dataclasses.dataclass(frozen=True)
class Departure:
    """The pose at the end of one turn or glance as it was estimated then.

    since: s, when it began. stamp: s. X_MD: (3,). covariance: (3, 3).
    """

    since: float
    stamp: float
    X_MD: FloatArray
    covariance: FloatArray


class Mission:
    """One mission and what is observed of it from outside.

    world: as the mission found it, None where it is not known.
    truth: what only a simulation knows, None for any other robot and until the diagram is built. meter: the CPU time of
    the explorer's components.
    """

    def __init__(
        self,
        scenario: Scenario,
        method: Method,
        meshcat: Meshcat | Picture | None,
        title: str,
        robot: Robot = SIMULATED,
        writer: PortWriter | None = None,
        timeline: TimelineWriter | None = None,
        cockpit: Cockpit | None = None,
    ) -> None:
        """writer: where the station's ports are recorded, timeline: where the picture is; see `explore` for the
        others."""
        self._cpu_start, self.meter = time.process_time(), CpuMeter()
        self.world: World | None = MakeWorld(scenario.world) if robot.world_known else None
        self._X_WS = self.world.start if self.world is not None else None
        self._final: EstimatorState | None = None  # what the estimator knows with the final map
        self.method, self.robot = method, robot
        self.truth: Truth | None = None
        self._scenario, self._writer, self._timeline, self._cockpit = scenario, writer, timeline, cockpit
        self._clock = cockpit.clock if cockpit is not None else None
        self._clock_version = -1  # what the simulator knows of it
        if timeline is not None:
            self._begin_timeline(timeline, title)
        self._visualizer: TfgVisualizer | None = None
        if meshcat is not None:
            # Only a picture needs what this imports.
            from tfg_drake.systems.visualizer import TfgVisualizer

            X_WM = np.zeros(3) if self._X_WS is None else self._X_WS
            self._visualizer = TfgVisualizer(meshcat, self.world, X_WM, scenario.robot.radius, title)
        self._word = ""  # what else is done
        self._recorder: System | None = None  # of the timeline
        self._context: Context | None = None  # until the diagram is built

        self.status = MissionStatus(phase="observe", stage=0, since=0.0)
        self.pose: PoseEstimate | None = None
        self.tfg: TfgMap | None = None
        self.map: MapEstimate | None = None
        self.grid: GridMap | None = None
        self.departures: list[Departure] = []  # one a stage
        self.stages: list[dict[str, Any]] = []
        self.outcome, self.reason = "", ""
        self.stage_cpu: dict[int, float] = {}
        self.wall_time = self.cpu_time = self.estimator_cpu = self.planner_cpu = 0.0
        self._choice: GoalChoice | None = None
        self._area, self._next_area = 0.0, 0.0

    def run(
        self,
        realtime_rate: float,
        max_time: float,
        interrupted: threading.Event,
        write: Callable[[str], object],
        on_progress: Callable[[Progress], None] | None,
        keep: Callable[[], None] | None = None,
        kernels: Compilation | None = None,
        monitor: Callable[[Context], EventStatus] | None = None,
    ) -> None:
        """Simulate until the mission ends, for a reason. write: takes a line a stage. keep: called now and then, to
        keep what there is; what these two raise ends the mission. kernels: as for `explore`. monitor: called with the
        diagram's Context after every step."""
        wall_start = time.monotonic()
        try:
            self._build(monitor)
            # What there is so far stays: looking through all of it for garbage, again and again, takes its time.
            gc.freeze()
            self._simulator.set_target_realtime_rate(1.0 if self.robot.real else realtime_rate)
            self._simulator.Initialize()
            self._observe(write)
            terminated = False
            while not self._ended(interrupted, max_time):
                step = REAL_STEP if self.robot.real else STEP
                if kernels is not None and self._pace(kernels, realtime_rate):
                    kernels = None
                elif kernels is not None:
                    step = SLOW_STEP
                boundary = step * (math.floor(self.time / step) + 1.0)
                terminated = self._advance(min(boundary, max_time, self.robot.end_time), interrupted)
                self._observe(write)
                if keep is not None:
                    keep()
                if on_progress is not None:
                    on_progress(self._progress(time.monotonic() - wall_start))
            if not terminated:
                # A mission that ends by itself does all that is due at its last instant; so that a recording of any
                # gives the same once more, whatever ended it then and ends it now, so does every other.
                self._simulator.AdvancePendingEvents()
                self._observe(write)
            self.say(f"{self.outcome.replace('_', ' ')}: solving the whole map")
            self.show()
        except (Exception, SystemExit) as error:  # Drake's failed assertions come as SystemExit.
            self.outcome = "fault"
            first_line = next(iter(str(error).strip().splitlines()), "no message")
            self.reason = f"{type(error).__name__} at {self.time:.2f} s: {first_line}"
            _log.exception("the mission failed at %.3f s", self.time)
        finally:
            gc.unfreeze()
            self.robot.close()
        self.wall_time = time.monotonic() - wall_start
        self.cpu_time = time.process_time() - self._cpu_start
        self.estimator_cpu, self.planner_cpu = self._spent(ESTIMATOR), self._spent(PLANNER)
        if on_progress is not None and self._context is not None:
            on_progress(self._progress(self.wall_time))

    def _advance(self, boundary: float, interrupted: threading.Event) -> bool:
        """Simulates up to a time, s, or less when interrupted; whether the mission has ended by itself. Whoever looks
        on may hold the clock meanwhile or change its speed, at instants that change nothing."""
        clock = self._clock
        while self.time < boundary and not interrupted.is_set():
            ahead = math.inf
            if clock is not None:
                if self._is_held(clock, interrupted):
                    break
                if self._cockpit is not None and self._cockpit.watched:
                    ahead = WATCHED_STEP * (math.floor(self.time / WATCHED_STEP) + 1.0)
            status = self._simulator.AdvanceTo(min(boundary, ahead))
            if status.reason() == SimulatorStatus.ReturnReason.kReachedTerminationCondition:
                return True
        return False

    def _is_held(self, clock: Clock, interrupted: threading.Event) -> bool:
        """Does what is wanted of the clock, waiting while it is held; whether somebody has interrupted it then."""
        clock.at_stage(self._eval(self._explorer, "mission", MissionStatus).stage)
        if clock.version == self._clock_version:
            return False
        if clock.held:
            self._record_now()
            while clock.held and not interrupted.wait(HELD_INTERVAL):
                pass
        self._clock_version = clock.version
        self._simulator.set_target_realtime_rate(clock.rate)
        self._simulator.ResetStatistics()  # or it would make up for the time that it stood
        return interrupted.is_set()

    def _record_now(self) -> None:
        """Writes the timeline as everything is now."""
        if self._recorder is not None and self._context is not None:
            self._recorder.ForcedPublish(self._recorder.GetMyContextFromRoot(self._context))

    def begin(self, monitor: Callable[[Context], EventStatus] | None = None) -> None:
        """Build the diagram, to be advanced step by step instead of by `run`. monitor: as there."""
        self._build(monitor)
        self._simulator.Initialize()
        self._observe(lambda _line: None)

    def advance(self, until: float) -> bool:
        """Simulate up to a time, s, or the mission's end; whether it got that far and its monitor did not end it."""
        while self.time < until and self.status.phase != "done":
            boundary = STEP * (math.floor(self.time / STEP) + 1.0)
            status = self._simulator.AdvanceTo(min(boundary, until))
            ended = status.reason() == SimulatorStatus.ReturnReason.kReachedTerminationCondition
            if ended and status.system() is self._simulator.get_system():
                return False
            self._observe(lambda _line: None)
        return True

    def say(self, word: str) -> None:
        """From now on picture and progress say what else is done, "" for nothing."""
        self._word = word
        if self._cockpit is not None:
            self._cockpit.word = word
        if self._visualizer is not None:
            self._visualizer.word = word

    def show(self) -> None:
        """Draws the picture as everything is now, what is said included."""
        if self.outcome != "fault":
            self._record_now()
        if self._visualizer is None:
            return
        if self._context is None or self.outcome == "fault":
            self._visualizer.ShowBeginning()
        else:
            self._visualizer.ForcedPublish(self._visualizer.GetMyContextFromRoot(self._context))

    def _pace(self, kernels: Compilation, realtime_rate: float) -> bool:
        """Goes as slowly as it takes that all kernels are there before the first look is over; whether they are."""
        ended, rate = kernels.ended, realtime_rate
        if not ended:
            left = self._scenario.explorer.first_look - self.time
            rate = min(max(SLOWEST, left / max(kernels.left, 1e-3)), realtime_rate or math.inf)
        self.say("" if ended else kernels.word)
        self._simulator.set_target_realtime_rate(rate)
        self._simulator.ResetStatistics()  # or it would make up for the time that it went slowly
        return ended

    @property
    def simulator(self) -> Simulator:
        """Of the diagram, once it is built."""
        return self._simulator

    @property
    def explorer(self) -> Diagram:
        """What explores, once the diagram is built."""
        return self._explorer

    @property
    def time(self) -> float:
        """Simulated time, s."""
        return float(self._context.get_time()) if self._context is not None else 0.0

    @property
    def end_time(self) -> float:
        """When the mission ended or, if it has not, the simulated time, s."""
        return self.status.since if self.status.phase == "done" else self.time

    @property
    def explored_time(self) -> float:
        """Since when nothing has been left to explore, s; nan where something is."""
        if self._choice is not None and self._choice.explored <= self.end_time:
            return self._choice.explored
        return self.end_time if self.outcome == "complete" else math.nan

    @property
    def camera(self) -> CameraModel:
        """What the estimator knows of the camera; of a method without one it looks ahead."""
        state = self._estimator_state()
        return exact_camera() if state is None else known_camera(state)

    @property
    def X_WM(self) -> FloatArray:
        """(3,) pose of the map frame in the world, see `map_frame`."""
        state = self._estimator_state()
        if state is None:
            return np.zeros(3) if self._X_WS is None else self._X_WS
        return map_frame(self._X_WS, state)

    def _estimator_state(self) -> EstimatorState | None:
        """What the estimator knows, in the end with the final map; None of a method without one."""
        if self._final is not None or self._context is None or not self._explorer.HasOutputPort("map"):
            return self._final
        return StateOfExplorer(self._explorer, self._explorer.GetMyContextFromRoot(self._context))

    @property
    def world_then(self) -> World | None:
        """The world as the mission left it, None where it is not known."""
        if self.world is None or not self._scenario.reality.changes:
            return self.world
        now = self.truth.world(self._context) if self.truth is not None else None
        # Of a recording it is not known whether a change had to wait for the robot.
        return now if now is not None else world_at(self.world, self._scenario.reality.changes, self.end_time)

    def true_poses(self) -> tuple[FloatArray, FloatArray] | None:
        """Stamps (n,) in s and true poses X_WB (n, 3), one an odometry period, to the end; None where not known."""
        return self.truth.poses(self._context, self.end_time) if self.truth is not None else None

    def estimated_poses(self) -> tuple[FloatArray, FloatArray]:
        """Stamps (n,) in s and estimates X_WB (n, 3) as they were at the time, one an odometry period, to the end."""
        if self._context is None:
            return np.zeros(0), np.zeros((0, 3))
        data = self._pose_log.FindLog(self._context).data()
        stamps, first = np.unique(data[0], return_index=True)
        lived = stamps <= self.end_time
        stamps, X_MB = stamps[lived], data[1:, first[lived]].T
        return stamps, compose(self.X_WM, X_MB) if len(X_MB) else X_MB

    def final_map(self) -> tuple[SavedMap, MapEstimate, TfgMap] | None:
        """The map as it is now, to be kept, its estimate and TFG; None before the first view."""
        if self._context is None or not self._explorer.HasOutputPort("map"):
            return None
        context = self._explorer.GetMyContextFromRoot(self._context)
        self._final = finished_map(StateOfExplorer(self._explorer, context))
        return MapOfExplorer(self._explorer, context, self._X_WS, self._final)

    def pressed(self) -> tuple[Pressed, ...] | None:
        """The keys that somebody has driven by, None where nobody has."""
        if self._context is None or not self._explorer.HasSubsystemNamed("manual_driver"):
            return None
        driver = self._explorer.GetSubsystemByName("manual_driver")
        pressed: tuple[Pressed, ...] = driver.pressed(driver.GetMyContextFromRoot(self._context))
        return pressed

    def newest_map(self) -> SavedMap | None:
        """The map as it is while the mission runs, to be kept; None before the first view, and of a grid."""
        if self._context is None or not self._explorer.HasOutputPort("map"):
            return None
        context = self._explorer.GetMyContextFromRoot(self._context)
        found = MapOfExplorer(self._explorer, context, self._X_WS)
        return found[0] if found is not None else None

    def _build(self, monitor: Callable[[Context], EventStatus] | None) -> None:
        diagram, truth_log, self._pose_log = MakeMissionDiagram(
            self._scenario,
            self.world,
            self._visualizer,
            self.method.MakeExplorer,
            self.robot,
            self._writer,
            self._timeline,
            (self._cockpit.requests,) if self._cockpit is not None else (),
            self._cockpit.pushes if self._cockpit is not None else None,
            self._cockpit.goals if self._cockpit is not None else None,
        )
        self._simulator = Simulator(diagram)
        if monitor is not None:
            self._simulator.set_monitor(monitor)
        if truth_log is not None:
            self.truth = Truth(diagram.GetSubsystemByName("station"), truth_log)
        self._explorer = diagram.GetSubsystemByName("explorer")
        if self._timeline is not None:
            self._recorder = diagram.GetSubsystemByName("timeline_recorder")
        if self._cockpit is not None:
            self._cockpit.sends = diagram.HasSubsystemNamed("goal_requester")
        self.meter.attach(self._explorer)
        self._context = self._simulator.get_mutable_context()
        diagram.SetRandomContext(self._context, RandomGenerator(self._scenario.seed))

    def _begin_timeline(self, timeline: TimelineWriter, title: str) -> None:
        """What stays as it is: the true world, the robot, and what its sensors reach."""
        scenario, robot = self._scenario, self._scenario.robot
        told = {
            "title": title,
            "radius": robot.radius,
            "rule": scenario.explorer.goal,
            "simulated": not self.robot.real,
        }
        camera = {"range": scenario.tags.range, "field_of_view": scenario.tags.field_of_view}
        layer = scene.walls(self.world) if self.world is not None else {}
        timeline.write("world", 0.0, layer, **told, camera=camera)
        if self._X_WS is not None:
            timeline.write("frame", 0.0, {"pose": self._X_WS.astype(np.float32)})
        timeline.flush()

    def _spent(self, names: tuple[str, ...]) -> float:
        """CPU seconds that the explorer has spent on some of what it does."""
        return sum(self.meter.spent.get(name, 0.0) for name in names)

    def _ended(self, interrupted: threading.Event, max_time: float) -> bool:
        if self.status.phase == "done":
            self.outcome, self.reason = self.status.outcome, self.status.reason
        elif interrupted.is_set():
            self.outcome, self.reason = "interrupted", f"interrupted at {self.time:.0f} s"
        elif self.time >= max_time:
            self.outcome, self.reason = "time_limit", f"the time limit of {max_time:g} s was reached"
        elif self.time >= self.robot.end_time:
            self.outcome, self.reason = "time_limit", "the recording has ended"
        return bool(self.outcome)

    def _observe(self, write: Callable[[str], object]) -> None:
        """Take note of where the mission stands."""
        self.status = self._eval(self._explorer, "mission", MissionStatus)
        if self._cockpit is not None:
            self._cockpit.at_stage(self.status.stage)
        self.pose = self._eval(self._explorer, "pose", PoseEstimate)
        self.tfg, estimate = self._look("tfg", TfgMap), self._look("map", MapEstimate)
        self.grid = self._look("grid", GridMap)
        record = None
        if estimate is not None and estimate.stage > len(self.stages):
            record = self._stage_record(estimate)
            self.map = estimate
            # Copies: a view would keep the whole joint covariance of every stage.
            covariance = estimate.covariance[-3:, -3:].copy()
            self.departures.append(
                Departure(float(estimate.observation.stamps[0]), estimate.stamp, estimate.X_MD, covariance)
            )
        elif self.grid is not None and self.grid.stage > len(self.stages):
            record = dict.fromkeys(STAGE_FIELDS) | {"stage": self.grid.stage, "time_s": self.grid.stamp}
        if record is not None:
            self.stages.append(record)
            if self._visualizer is not None:
                self._visualizer.PlaceMap(self.X_WM)
            if self._timeline is not None:
                self._timeline.write("frame", self.time, {"pose": self.X_WM.astype(np.float32)})
            write(json.dumps(record) + "\n")
            _log.info("stage %d at %.1f s", record["stage"], record["time_s"])
        self._choice = self._look("goal", GoalChoice)
        if self.truth is not None:
            self.truth.look(self._context)
        # A stage is planned within a moment of its map, long before the next: what was charged since the last look
        # belongs to the stage that the mission is in now.
        new = self._spent(STAGE) - sum(self.stage_cpu.values())
        self.stage_cpu[self.status.stage] = self.stage_cpu.get(self.status.stage, 0.0) + new

    def _stage_record(self, estimate: MapEstimate) -> dict[str, Any]:
        """A line of stages.jsonl; gains and entropies in nats, the goal (where the turn began) in W.

        The realised gain compares the landmarks' entropy with what it was at the stage before, when those that are new
        had only the explorer's prior.
        """
        choice = self._choice
        # No prediction for the start, for a glance, nor where the robot looks round for it could not reach its goal.
        arrived = choice is not None and np.hypot(*(choice.p_MG - estimate.X_MA[-1, :2])) < AT_GOAL
        if choice is not None and (not arrived or choice.node not in choice.candidates):
            choice = None
        row = int(np.flatnonzero(choice.candidates == choice.node)[0]) if choice is not None else -1
        before = self.map
        known = len(before.ids) if before is not None else 0
        prior = (len(estimate.ids) - known) * math.log(2.0 * math.pi * math.e * self._scenario.explorer.prior_sigma**2)
        X_WA = compose(self.X_WM, estimate.X_MA[-1])
        fields = (
            estimate.stage,
            [float(value) for value in X_WA],
            float(choice.exploitation[row]) if choice is not None else None,
            float(choice.exploration[row]) if choice is not None else None,
            float(choice.pose_price[row]) if choice is not None else None,
            float(choice.gain[row]) if choice is not None else None,
            prior + (before.entropy if before is not None else 0.0) - estimate.entropy,
            estimate.stamp,
            estimate.entropy,
            len(estimate.ids),
        )
        return dict(zip(STAGE_FIELDS, fields, strict=True))

    def _progress(self, wall_time: float) -> Progress:
        error = math.nan
        if self.pose is not None and self.truth is not None:
            X_WB = compose(self.X_WM, pose_at(self.pose, self.time))
            error = float(np.linalg.norm(X_WB[:2] - self.truth.position(self._context)))
        landmarks = len(self.map.ids) if self.map is not None else 0
        if self.outcome or wall_time >= self._next_area:
            self._area, self._next_area = self._seen_area(), wall_time + AREA_INTERVAL
        status = self.status
        return Progress(
            self.time, wall_time, status.phase, status.stage, landmarks, self._area, error, self.outcome, self._word
        )

    def _seen_area(self) -> float:
        """How much of the floor is known to be free, m^2."""
        if self.tfg is not None:
            return covered_area(self.tfg.star_offsets, self.tfg.star_vertices, cell=0.25)
        if self.grid is not None:
            return float(np.count_nonzero(classify(self.grid) == FREE)) * self.grid.resolution**2
        return 0.0

    def _look(self, port: str, kind: type) -> Any:
        """The explorer's message, None where its method has no such port."""
        return self._eval(self._explorer, port, kind) if self._explorer.HasOutputPort(port) else None

    def _eval(self, system: System, port: str, kind: type) -> Any:
        value = system.GetOutputPort(port).Eval(system.GetMyContextFromRoot(self._context))
        if not isinstance(value, kind):
            raise TypeError(f"{system.get_name()}.{port} must hold {kind.__name__}, not {type(value).__name__}")
        return value
