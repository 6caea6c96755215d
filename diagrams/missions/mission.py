"""One mission under way: its diagram, and what is observed of it from outside; `MissionRunner` runs it to its end."""

from __future__ import annotations

import dataclasses
import json
import logging
import math
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from pydrake.common import RandomGenerator
from pydrake.systems.analysis import Simulator, SimulatorStatus
from pydrake.systems.framework import Context, EventStatus, System
from pydrake.systems.primitives import VectorLog, VectorLogSink

from tfg_drake.bad_input import EstimateLost
from tfg_drake.diagrams.explorer import MapOfExplorer, StateOfExplorer
from tfg_drake.diagrams.methods import METHODS, Method
from tfg_drake.diagrams.mission_diagram import MakeMissionDiagram
from tfg_drake.diagrams.missions.context_state import restore_state, state_of
from tfg_drake.diagrams.missions.truth import Truth
from tfg_drake.diagrams.parts import OUTPUTS
from tfg_drake.diagrams.robots import RECORDED, SIMULATED, Robot
from tfg_drake.diagrams.scenario import MakeWorld, MapFrame, Scenario
from tfg_drake.geometry.se2 import between, compose, pose_at, transform
from tfg_drake.mapfile.message_arrays import to_arrays
from tfg_drake.mapfile.saved_map import SavedMap, whole_map
from tfg_drake.messages import (
    FloatArray,
    GoalChoice,
    GridMap,
    MapEstimate,
    MissionStatus,
    PoseEstimate,
    Roadmap,
    TfgMap,
    is_tag,
)
from tfg_drake.mission.manual_drive import Pressed
from tfg_drake.notes import Note
from tfg_drake.pictures import scene
from tfg_drake.planning.mission_end import IN_VAIN, REASONS, UNSEEN, hindrances
from tfg_drake.slam.estimator import carried, finished_map
from tfg_drake.slam.estimator_state import EstimatorState
from tfg_drake.slam.noise import LearntNoise, noise_by_data_sheet
from tfg_drake.slam.odometry_model import random_walks
from tfg_drake.slam.shared import Shared, exactly_known
from tfg_drake.storage.checkpoint import CheckpointError
from tfg_drake.storage.port_recording import GOAL, PortWriter
from tfg_drake.storage.serialization import Packed
from tfg_drake.storage.timeline import TimelineWriter
from tfg_drake.systems.blas_threads import keep_to_one_thread
from tfg_drake.systems.cpu_meter import CpuMeter
from tfg_drake.systems.ports import PERIOD as ODOMETRY_PERIOD
from tfg_drake.world.changing import world_at
from tfg_drake.world.world import World

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

    from tfg_drake.cockpit.server import Cockpit
    from tfg_drake.diagrams.missions.mission_runner import Progress
    from tfg_drake.systems.visualizer import TfgVisualizer

# Names of systems whose CPU time counts as the estimator's, as a stage's planning, and as all planning.
ESTIMATOR = ("slam_estimator", "grid_mapper")
STAGE = ("tfg", "roadmap", "goal", "path")
PLANNER = (*STAGE, "prm_planner", "goal_selector", "grid_planner", "follower")

# The fields of a line of stages.jsonl, null if the map does not provide them.
STAGE_FIELDS: tuple[str, ...] = ("stage", "goal", "exploitation", "exploration", "pose_price", "predicted_gain")
STAGE_FIELDS += ("realised_gain", "time_s", "entropy_nats", "landmarks")
# Period of the checks of the mission, simulated s, a fraction of a stage. A mission more than STEP behind the wall
# clock misses real time.
STEP = 1.0
# The robot has reached its goal if the turn began less than AT_GOAL, m, from it.
AT_GOAL = 0.3
# Greatest deviation of a simulated robot's first pose from the world's start, m and rad.
AT_START = 0.01

T = TypeVar("T")

_log = logging.getLogger("tfg_drake.run")
_pace_log = logging.getLogger("tfg_drake.pace")


def stage_lines(stages: Sequence[Mapping[str, Any]]) -> str:
    """Stages as lines of stages.jsonl."""
    return "".join(json.dumps(record) + "\n" for record in stages)


def _looking_round(systems: Mapping[str, tuple[Any, ...]], time: float) -> dict[str, tuple[Any, ...]]:
    """The state of an explorer whose robot looks for itself in the map from a time on, s; empty where there is none."""
    parts = [part for system in systems.values() for part in system]
    known = next((part.map for part in parts if isinstance(part, EstimatorState)), None)
    if known is None:
        return {}

    def changed(part: Any) -> Any:
        if isinstance(part, MissionStatus):
            return MissionStatus(phase="observe", stage=known.stage, since=time, path_id=part.path_id)
        return carried(part) if isinstance(part, EstimatorState) else part

    return {path: tuple(map(changed, system)) for path, system in systems.items()}


@dataclasses.dataclass(frozen=True)
class Departure:
    """The pose at the end of one turn or glance as it was estimated then.

    since: s, when it began. stamp: s. X_MD: (3,). covariance: (3, 3).
    """

    since: float
    stamp: float
    X_MD: FloatArray
    covariance: FloatArray


# State of a mission besides its Context, with annotations for the checkpoint.
STATE: Mapping[str, Any] = {
    "stages": list[dict[str, int | float | list[float] | None]],
    "departures": list[Departure],
    "map": MapEstimate | None,
    "stage_cpu": dict[int, float],
    "resumed": list[float],
    "_choice": GoalChoice | None,
    "notes": list[Note],
    "cpu_time": float,
    "wall_time": float,
}
_LOGS = list[tuple[FloatArray, FloatArray]]


@dataclasses.dataclass(frozen=True)
class MissionRequest:
    """A mission as it is asked for, by the command line, Python, a comparison or a fork.

    scenario: everything that defines the run, the seed included; it gets the settings that the method fixes. method:
    what explores. robot: what it drives. name: what the run is called in titles and the folder's name; world_name: the
    world's, "" for the same. out_dir: the run's folder, made if missing; runs/<time>-<name>-<seed> by default.

    meshcat: where to draw it; None for no picture in Meshcat. cockpit: the page that shows what is recorded, and asks
    for something; None for none. realtime_rate: simulated s per second at most; 0 for as fast as possible. max_time:
    simulated s after which the outcome is time_limit, as it is when the robot's station ends. interrupted: ends the
    mission when set, for a caller that looks after signals itself. on_progress: called about once a simulated second,
    and once more before the files of the run are written.

    record: what the station's ports carry goes to ports.mcap, to be played again, and the map to the disk while it
    grows; not for what a seed gives again. monitor: makes what is called with the diagram's Context after every step of
    the simulator. notes: what was not believed before it began, of a recording. before: the `state` in which the
    mission that is in out_dir was cut short, to go on with it.
    """

    scenario: Scenario
    method: Method = METHODS["tfg"]
    robot: Robot = SIMULATED
    name: str = "scenario"
    world_name: str = ""
    out_dir: Path | None = None
    meshcat: Meshcat | None = None
    cockpit: Cockpit | None = None
    realtime_rate: float = 0.0
    max_time: float = 3600.0
    interrupted: threading.Event | None = None
    on_progress: Callable[[Progress], None] | None = None
    record: bool = True
    monitor: Callable[[Mission], Callable[[Context], EventStatus]] | None = None
    notes: Sequence[Note] = ()
    before: Packed | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "scenario", self.method.Fixed(self.scenario))

    @property
    def world(self) -> str:
        """Its world's name, where that is known."""
        return (self.world_name or self.name) if self.robot.world_known else "unknown"

    @property
    def title(self) -> str:
        """Of its page and pictures."""
        called = self.name if self.method.name == "tfg" else f"{self.name}, {self.method.name}"
        return f"{called}, seed {self.scenario.seed}"


class Mission:
    """One mission and what is observed of it from outside.

    world: as the mission found it, None where it is not known. truth: what only a simulation knows, None for any
    other robot and until the diagram is built. meter: the CPU time of the explorer's components. simulator: of the
    diagram, and explorer: what explores, once it is built. terminated: the diagram has ended it, so that all is done
    that was due at its last instant. failure: what ended it, of the outcome fault. notes: what was not believed
    meanwhile. resumed: when it was gone on with, s. wall_start: when it began by the host's monotonic clock, less what
    it had taken when it was gone on with, s.
    """

    def __init__(
        self, request: MissionRequest, writer: PortWriter | None = None, timeline: TimelineWriter | None = None
    ) -> None:
        """writer: where the station's ports are recorded, timeline: where the picture is."""
        keep_to_one_thread()
        scenario, robot = request.scenario, request.robot
        self.wall_start, self._cpu_start, self.meter = time.monotonic(), time.process_time(), CpuMeter()
        self.world: World | None = MakeWorld(scenario.world) if robot.world_known else None
        self._context: Context | None = None  # until the diagram is built
        self._final: EstimatorState | None = None  # the estimator's state with the final map
        self._X_WS = self.world.start if self.world is not None else np.zeros(3)
        self._X_WM = MapFrame(scenario, self._X_WS)
        self.request, self.scenario, self.method, self.robot = request, scenario, request.method, robot
        self.truth: Truth | None = None
        self._writer, self._timeline, self._cockpit = writer, timeline, request.cockpit
        self._before, self._under = request.before, "/explorer" if robot.real else ""
        if timeline is not None and request.before is None:
            self._begin_timeline(timeline)
        self._visualizer: TfgVisualizer | None = None
        self._recorder: System | None = None  # of the timeline

        self.status = MissionStatus(phase="observe", stage=0, since=0.0)
        self.pose: PoseEstimate | None = None
        self.tfg: TfgMap | None = None
        self.map: MapEstimate | None = None
        self.grid: GridMap | None = None
        self.departures: list[Departure] = []  # one a stage
        self.stages: list[dict[str, Any]] = []
        self.resumed: list[float] = []
        self.notes: list[Note] = []
        self.outcome, self.reason, self.terminated = "", "", False
        self.failure: BaseException | None = None
        self.stage_cpu: dict[int, float] = {}
        self.wall_time = self.cpu_time = self.estimator_cpu = self.planner_cpu = 0.0
        self._choice: GoalChoice | None = None
        self._since, self._late = 0.0, False
        self._shown_at = self.X_WM  # where the map was last shown

    def begin(self, write: Callable[[str], object] = lambda _line: None) -> None:
        """Build the diagram, to be advanced from then on. write: takes a line a stage. Raises CheckpointError where it
        does not fit the state of the mission before."""
        self._write = write
        self._build()
        try:
            if self._before is not None:
                self._go_on(self._before)
            self.simulator.Initialize()
            self._since = self.time
            for ports in OUTPUTS.values():
                for name, kind in ports.items():
                    if not isinstance(kind, int):
                        self.look_for(name, kind)
            if self._before is None:
                self._check_start()
            self.observe()
        except (Exception, SystemExit) as error:
            if self._before is None or isinstance(error, CheckpointError):
                raise
            # Damaged values may raise any exception.
            raise self._before.complaint(error) from error

    def _check_start(self) -> None:
        """Raises ValueError where a simulated robot does not begin at the world's start, by which poses in W go."""
        if self.truth is None or self.world is None:
            return
        begins, start = self.truth.pose(self._context), self.world.start
        if np.abs(between(start, begins)).max() > AT_START:
            at, told = (", ".join(f"{value:g}" for value in pose) for pose in (begins, start))
            raise ValueError(
                f"truth.pose begins at ({at}), not at world.start ({told}), m and rad: let one be the other"
            )

    def state(self) -> dict[str, tuple[Any, Any]]:
        """All that a mission needs to go on from here, between two instants: annotation and value of each part."""
        assert self._context is not None
        self.account()
        logs = [(log.sample_times(), log.data()) for log in self._find_logs(self._context)]
        return {
            "time": (float, self.time),
            **state_of(self.simulator.get_system(), self._context, self._under),
            "logs": (_LOGS, [(times[times < self.time], data[:, times < self.time]) for times, data in logs]),
            "spent": (dict[str, float], self.meter.spent),
            **{name: (hint, getattr(self, name)) for name, hint in STATE.items()},
        }

    def _go_on(self, before: Packed) -> None:
        """Puts everything back; of a real robot, which may be elsewhere now, what explores, and it looks round.

        Raises ValueError or what Drake raises where something is not what it should be.
        """
        assert self._context is not None
        time, logs = before.take("time", float), before.take("logs", _LOGS)
        if not 0.0 <= time <= ODOMETRY_PERIOD * len(logs[-2][0]):
            raise ValueError("time does not fit the logs")
        first = state_of(self.simulator.get_system(), self._context, self._under)
        systems = {path: before.take(path, kind) for path, (kind, _) in first.items() if path in before.names}
        if self.robot.real:
            systems = _looking_round(systems, time)
        restore_state(self.simulator.get_system(), self._context, systems, time, self._under)
        for log, (times, data) in zip(self._find_logs(self._context), logs, strict=True):
            for stamp, column in zip(times, data.T, strict=True):
                log.AddData(stamp, column)
        self.meter.spent.update(before.take("spent", dict[str, float]))
        told = {name: before.take(name, hint) for name, hint in STATE.items()}
        self.notes[:0] = told["notes"]
        vars(self).update(told | {"notes": self.notes})
        self.wall_start -= self.wall_time
        self._cpu_start -= self.cpu_time
        if (known := self.newest_map()) is not None:
            whole_map(to_arrays(known))
        self.resumed = [*self.resumed, self.time]
        _log.info("goes on from %.2f s", self.time)

    def _find_logs(self, context: Context) -> list[VectorLog]:
        return [log.FindMutableLog(context) for log in self._logs if log is not None]

    def advance(self, until: float, stop: Callable[[], float] = lambda: math.inf) -> bool:
        """Simulate up to a time, s, or the mission's end, observed every STEP; returns False if a monitor ended it.

        stop: returns the time, s, up to which to simulate before it is called again; a past time ends the call.
        """
        while self.time < until and self.status.phase != "done" and (next_stop := stop()) > self.time:
            boundary = min(STEP * (math.floor(self.time / STEP) + 1.0), until)
            status = self.simulator.AdvanceTo(min(boundary, next_stop))
            ended = self.terminated = status.reason() == SimulatorStatus.ReturnReason.kReachedTerminationCondition
            if ended and status.system() is self.simulator.get_system():
                return False
            if ended or self.time >= boundary:
                self.observe()
            if ended and self.status.phase != "done":
                return False
        return True

    def forgive_delay(self) -> None:
        """Restart the pacing by real time now: earlier delays are not made up for."""
        self.simulator.ResetStatistics()
        self._since = self.time

    def record_now(self) -> None:
        """Write the current state to the timeline."""
        self._publish(self._recorder)

    def account(self) -> None:
        """Record wall and CPU time spent so far."""
        self.wall_time, self.cpu_time = time.monotonic() - self.wall_start, time.process_time() - self._cpu_start
        self.estimator_cpu, self.planner_cpu = self._spent(ESTIMATOR), self._spent(PLANNER)

    def say(self, word: str) -> None:
        """Show on the page what is being done, "" for nothing."""
        if self._cockpit is not None:
            self._cockpit.word = word

    def show(self) -> None:
        """Draw the current state in all pictures."""
        if self.outcome == "fault":
            return
        for picture in (self._recorder, self._visualizer):
            self._publish(picture)

    def _publish(self, picture: System | None) -> None:
        if picture is not None and self._context is not None:
            picture.ForcedPublish(picture.GetMyContextFromRoot(self._context))

    @property
    def built(self) -> bool:
        """True if a diagram exists."""
        return self._context is not None

    def stage_now(self) -> int:
        """Return the mission's stage at this instant, which may be later than at the last check."""
        return self.look("mission", MissionStatus).stage

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
        """Time since which nothing is left to explore, s; nan if something is."""
        if self._choice is not None and self._choice.explored <= self.end_time:
            return self._choice.explored
        return self.end_time if self.outcome == "complete" else math.nan

    @property
    def shared(self) -> Shared:
        """The estimate of the shared parameters; all zero for a method without an estimator."""
        state = self.estimator_state()
        return exactly_known() if state is None else state.graph.shared

    @property
    def noise(self) -> LearntNoise:
        """The estimate of the noise; that of the data sheet for a method without an estimator."""
        state = self.estimator_state()
        return noise_by_data_sheet(random_walks(self.scenario.odometry)) if state is None else state.noise

    @property
    def placed_since(self) -> float:
        """Time since which the robot is located in the map that it began with, s; -inf without such a map, nan while it
        is not located."""
        state = self.estimator_state()
        if state is None:
            return -math.inf
        return math.nan if self.apart else state.placed

    @property
    def adrift(self) -> bool:
        """True if the robot was carried and is not located in its own earlier map."""
        state = self.estimator_state()
        return state is not None and state.map is not None and state.map.is_adrift

    @property
    def apart(self) -> bool:
        """Whether the robot does not know where it is in the map that it began with, and maps apart from that."""
        if self._context is None and self._final is None:
            return bool(self.scenario.explorer.known_map)
        state = self.estimator_state()
        return state is not None and state.known is not None and state.at is None

    @property
    def places(self) -> int:
        """In how many places of the map that it began with the robot may be, 0 for none or any."""
        state = self.estimator_state()
        if not self.apart:
            return 1
        return 0 if state is None else state.hypotheses.likely

    def open_edges(self) -> list[dict[str, Any]] | None:
        """Each edge of free space that is no surface: its place in W, its length, and why it is open; None for a method
        without a TFG."""
        tfg = self.tfg
        roadmap = None if tfg is None else self.look_for("roadmap", Roadmap)
        if tfg is None or roadmap is None:
            return None
        reasons = (REASONS[0] if self.outcome == "complete" else UNSEEN, *REASONS[1:])
        why = [reasons[i] for i in hindrances(tfg, roadmap, self.scenario.view, self.scenario.robot.radius)]
        places = transform(self.X_WM, np.vstack([tfg.frontiers, tfg.given_up])).round(3).tolist()
        lengths = np.append(tfg.frontier_length, tfg.given_up_length).round(3).tolist()
        why += [IN_VAIN] * len(tfg.given_up)
        return [
            {"p_WF": p_WF, "length_m": length, "why": reason}
            for p_WF, length, reason in zip(places, lengths, why, strict=True)
        ]

    @property
    def X_WM(self) -> FloatArray:
        """(3,) pose of the map frame in the world, see `MapFrame`; of a map apart that is where the robot began."""
        return self._X_WS if self.apart else self._X_WM

    def estimator_state(self) -> EstimatorState | None:
        """The estimator's state, in the end with the final map; None for a method without one."""
        if self._final is not None or self._context is None or not self.explorer.HasOutputPort("map"):
            return self._final
        return StateOfExplorer(self.explorer, self._explorer_context)

    @property
    def landmarks(self) -> MapEstimate | None:
        """The newest map with the walls that are landmarks, in the end the final one; None of a method without one."""
        state = self.estimator_state()
        return state.map if state is not None else None

    @property
    def walls(self) -> int:
        """How many walls are landmarks of the newest map."""
        landmarks = self.landmarks
        return 0 if landmarks is None else int(np.count_nonzero(~is_tag(landmarks.ids)))

    @property
    def world_then(self) -> World | None:
        """The world as the mission left it, None where it is not known."""
        if self.world is None or not self.scenario.reality.changes:
            return self.world
        now = self.truth.world(self._context) if self.truth is not None else None
        # In a recording it is unknown whether a change had to wait for the robot.
        return now if now is not None else world_at(self.world, self.scenario.reality.changes, self.end_time)

    def true_poses(self) -> tuple[FloatArray, FloatArray] | None:
        """Stamps (n,) in s and true poses X_WB (n, 3), one an odometry period, to the end; None where not known."""
        return self.truth.poses(self._context, self.end_time) if self.truth is not None else None

    def estimated_poses(self, *, lost: bool = False) -> tuple[FloatArray, FloatArray]:
        """Stamps (n,) in s and estimates X_WB (n, 3) as they were at the time, one an odometry period, to the end.
        lost: also those before the robot found itself, as if in W."""
        if self._context is None:
            return np.zeros(0), np.zeros((0, 3))
        stamps, X_MB = self._logged(self._pose_log, lost=lost)
        return stamps, compose(self.X_WM, X_MB) if len(X_MB) else X_MB

    def published_poses(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Stamps (n,) in s, poses X_MB (n, 3) and covariances (n, 3, 3) as they were published, once a second to the
        end; none by a method without an estimator."""
        if self.estimator_state() is None:
            return np.zeros(0), np.zeros((0, 3)), np.zeros((0, 3, 3))
        stamps, values = self._logged(self._covariance_log)
        return stamps, values[:, :3], values[:, 3:].reshape(-1, 3, 3)

    def _logged(self, log: VectorLogSink, *, lost: bool = False) -> tuple[FloatArray, FloatArray]:
        """Stamps (n,), s, each once, and values (n, w) of a log of vectors (stamp, values), up to the mission's end.

        While the robot looks for itself in a map it does not claim to be anywhere: without `lost` that is left out.
        """
        data = log.FindLog(self._context).data()
        stamps, first = np.unique(data[0], return_index=True)
        lived = stamps <= self.end_time
        lost_since = self.resumed[-1] if self.resumed and self.robot.real else -math.inf
        if not lost and (math.isfinite(self.placed_since) or math.isfinite(lost_since)):
            lived &= (stamps < lost_since) | (stamps > self.placed_since)
        return stamps[lived], data[1:, first[lived]].T

    def final_map(self) -> tuple[SavedMap | None, MapEstimate, TfgMap] | None:
        """The map as it is now, to be kept, its estimate and TFG; None before the first view."""
        if not self._maps:
            return None
        # The map of an estimator without further outputs is final.
        self._final = state = StateOfExplorer(self.explorer, self._explorer_context)
        try:
            self._final = finished_map(state) if self.explorer.HasOutputPort("estimator_state") else state
        except EstimateLost as error:
            self.outcome, self.reason, self.failure = "fault", str(error), error
        return MapOfExplorer(self.explorer, self._explorer_context, self.X_WM, self._final, self.scenario)

    def pressed(self) -> tuple[Pressed, ...] | None:
        """The keys that somebody has driven by, None where nobody has."""
        return None if self._context is None else self.look_for("pressed", tuple)

    @property
    def _maps(self) -> bool:
        """True if there are landmarks and surfaces; there may be a map without surfaces."""
        return self._context is not None and all(map(self.explorer.HasOutputPort, ("map", "tfg")))

    @property
    def _explorer_context(self) -> Context:
        return self.explorer.GetMyContextFromRoot(self._context)

    def newest_map(self) -> SavedMap | None:
        """The map as it is while the mission runs, to be kept; None before the first view, and of a grid."""
        found = MapOfExplorer(self.explorer, self._explorer_context, self.X_WM) if self._maps else None
        return found[0] if found is not None else None

    def _build(self) -> None:
        diagram, *self._logs = MakeMissionDiagram(
            self.scenario,
            self.world,
            self.request.meshcat,
            self.method.MakeExplorer,
            self.robot,
            self._writer,
            self._timeline,
            (self._cockpit.requests,) if self._cockpit is not None else (),
        )
        truth_log, self._pose_log, self._covariance_log = self._logs
        self.simulator = Simulator(diagram)
        if self.request.monitor is not None:
            self.simulator.set_monitor(self.request.monitor(self))
        if truth_log is not None:
            self.truth = Truth(diagram.GetSubsystemByName("station"), truth_log)
        self.explorer = diagram.GetSubsystemByName("explorer")
        if self.request.meshcat is not None:
            self._visualizer = diagram.GetSubsystemByName("visualizer")
        if self._timeline is not None:
            self._recorder = diagram.GetSubsystemByName("timeline_recorder")
        if self._cockpit is not None:
            recorded = diagram.GetSubsystemByName("station").HasOutputPort(GOAL)
            self._cockpit.sends = self.explorer.HasInputPort("requested_goal") and not recorded
            self._cockpit.tells = self.explorer.HasInputPort("said_pose") and not recorded
        self.meter.attach(self.explorer)
        self._context = self.simulator.get_mutable_context()
        diagram.SetRandomContext(self._context, RandomGenerator(self.scenario.seed))

    def _begin_timeline(self, timeline: TimelineWriter) -> None:
        """Writes what is fixed: the true world, the robot, and its sensors' reach."""
        scenario, robot = self.scenario, self.scenario.robot
        told = {
            "title": self.request.title,
            "radius": robot.radius,
            "rule": scenario.explorer.goal,
            "simulated": not self.robot.real,
            "pushes": [dataclasses.asdict(one) for one in scenario.disturbances if not self.robot.real],
        }
        camera: dict[str, float] | None = {"range": scenario.tags.range, "field_of_view": scenario.tags.field_of_view}
        if math.isfinite(self.robot.end_time):  # Nobody drives a recording.
            told["wheels"] = False
        if (
            self.robot.name == RECORDED or scenario.explorer.landmarks == "walls"
        ):  # Only its scans are used, not a camera.
            camera = None
        layer = scene.walls(self.world) if self.world is not None else {}
        timeline.write("world", 0.0, layer, **told, camera=camera)
        timeline.write("frame", 0.0, {"pose": self.X_WM.astype(np.float32)})
        timeline.flush()

    def _spent(self, names: tuple[str, ...]) -> float:
        """Return the explorer's CPU time for some components, s."""
        return sum(self.meter.spent.get(name, 0.0) for name in names)

    def observe(self) -> None:
        """Update the record of the mission's state, and check that it keeps real time."""
        if self._cockpit is None or self.robot.real:  # The page can hold the clock, and shows its rate.
            self._notice_delay()
        self.status = self.look("mission", MissionStatus)
        if self._cockpit is not None:
            self._cockpit.at_stage(self.status.stage)
        self.pose = self.look("pose", PoseEstimate)
        self.tfg, estimate = self.look_for("tfg", TfgMap), self.look_for("map", MapEstimate)
        self.grid = self.look_for("grid", GridMap)
        record: dict[str, Any] | None = None
        newest = self.stages[-1]["stage"] if self.stages else 0  # more than there are where the Context was set
        if estimate is not None and estimate.stage > newest:
            record = self._stage_record(estimate)
            self.map = estimate
            # Copies: a view would keep the whole joint covariance of every stage.
            covariance = estimate.covariance[-3:, -3:].copy()
            self.departures.append(
                Departure(float(estimate.observation.stamps[0]), estimate.stamp, estimate.X_MD, covariance)
            )
        elif self.grid is not None and self.grid.stage > newest:
            record = dict.fromkeys(STAGE_FIELDS) | {"stage": self.grid.stage, "time_s": self.grid.stamp}
        if record is not None or self._shown_at is not self.X_WM:
            self._shown_at = self.X_WM
            if self._visualizer is not None:
                self._visualizer.PlaceMap(self.X_WM, self.time)
            if self._timeline is not None:
                self._timeline.write("frame", self.time, {"pose": self.X_WM.astype(np.float32)})
        if record is not None:
            self.stages.append(record)
            self._write(stage_lines([record]))
            _log.info("stage %d at %.1f s", record["stage"], record["time_s"])
        self._choice = self.look_for("goal", GoalChoice)
        if self.truth is not None:
            self.truth.look(self._context)
        # A stage is planned shortly after its map, long before the next one, so the CPU time charged since the last
        # check belongs to the current stage.
        new = self._spent(STAGE) - sum(self.stage_cpu.values())
        self.stage_cpu[self.status.stage] = self.stage_cpu.get(self.status.stage, 0.0) + new

    def _notice_delay(self) -> None:
        """Log once that the mission is behind the wall clock."""
        rate, now = self.simulator.get_target_realtime_rate(), self.simulator.get_actual_realtime_rate()
        late = (self.time - self._since) * (1.0 / now - 1.0 / rate) if rate and now else 0.0
        if late > STEP and not self._late:
            self._late = True
            _pace_log.warning("%.0f s: real time is missed, by %.1f s: this machine is too slow", self.time, late)

    def _stage_record(self, estimate: MapEstimate) -> dict[str, Any]:
        """Return a line of stages.jsonl; gains and entropies in nats, the goal (start of the turn) in W.

        The realised gain is the decrease of the landmarks' entropy, tags and walls, since the previous stage, where the
        new ones had the explorer's prior.
        """
        choice = self._choice
        # There is no prediction for the start, for a glance, or for a turn at a place short of an unreachable goal.
        arrived = choice is not None and np.hypot(*(choice.p_MG - estimate.X_MA[-1, :2])) < AT_GOAL
        if choice is not None and (not arrived or choice.node not in choice.candidates):
            choice = None
        record: dict[str, Any] = dict.fromkeys(STAGE_FIELDS)
        if choice is not None:
            row = int(np.flatnonzero(choice.candidates == choice.node)[0])
            record |= {
                name: float(getattr(choice, name)[row]) for name in ("exploitation", "exploration", "pose_price")
            }
            record["predicted_gain"] = float(choice.gain[row])
        before = self.map
        landmarks = len((self.look_for("landmarks", MapEstimate) or estimate).ids)
        known = self.stages[-1]["landmarks"] if before is not None else 0
        prior = (landmarks - known) * math.log(2.0 * math.pi * math.e * self.scenario.explorer.prior_sigma**2)
        return record | {
            "stage": estimate.stage,
            "goal": [float(value) for value in compose(self.X_WM, estimate.X_MA[-1])],
            "realised_gain": prior + (before.entropy if before is not None else 0.0) - estimate.entropy,
            "time_s": estimate.stamp,
            "entropy_nats": estimate.entropy,
            "landmarks": landmarks,
        }

    def position_error(self) -> float:
        """Error of the estimated position now, m; nan where the truth is not known."""
        if self.pose is None or self.truth is None:
            return math.nan
        X_WB = compose(self.X_WM, pose_at(self.pose, self.time))
        return float(np.linalg.norm(X_WB[:2] - self.truth.pose(self._context)[:2]))

    def look(self, port: str, kind: type[T]) -> T:
        """The message at an output of the explorer now. Raises TypeError where it is of another kind."""
        value = self.explorer.GetOutputPort(port).Eval(self._explorer_context)
        if not isinstance(value, kind):
            part = next((one for one in self.explorer.GetSystems() if one.HasOutputPort(port)), self.explorer)
            raise TypeError(f"{part.get_name()}.{port} must hold {kind.__name__}, not {type(value).__name__}")
        return value

    def look_for(self, port: str, kind: type[T]) -> T | None:
        """The same, None where the method has no such port."""
        return self.look(port, kind) if self.explorer.HasOutputPort(port) else None
