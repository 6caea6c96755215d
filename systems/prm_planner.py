"""The PRM planner: the roadmap of each stage, the path to the goal chosen, and a watch on that path."""

from __future__ import annotations

import functools

import numpy as np
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from tfg_drake.config import ExplorerConfig, OdometryConfig, PlannerConfig, RobotConfig, TagSensorConfig
from tfg_drake.messages import (
    GoalChoice,
    LaserScan,
    MapEstimate,
    MissionStatus,
    PoseEstimate,
    Roadmap,
    TfgMap,
    WorkingMap,
)
from tfg_drake.planning.planner import PlannerState, initial_state, make_roadmap, obstacles_in_map, step
from tfg_drake.planning.roadmap import RoadmapParameters, RoadmapState
from tfg_drake.planning.roadmap_parts import whole_roadmap
from tfg_drake.systems.blas_threads import keep_to_one_thread
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import MessageState, declare_message_input, declare_message_output, eval_message
from tfg_drake.tfg.submaps import Submaps

PERIOD = 1 / 16


class PrmPlanner(LeafSystem):
    """Runs `tfg_drake.planning.planner.step` at 16 Hz.

    .. pydrake_system::

        name: PrmPlanner
        input_ports:
        - map
        - tfg
        - working_map
        - pose
        - goal
        - scan
        - mission
        output_ports:
        - roadmap
        - working_roadmap
        - path
        - path_status

    map: MapEstimate, tfg: TfgMap, working_map: WorkingMap, pose: PoseEstimate, goal: GoalChoice, mission:
    MissionStatus, roadmap: Roadmap, working_roadmap: Roadmap, path: Path, path_status: PathStatus, all in M. scan:
    LaserScan.

    working_roadmap is that of the working map. The whole of a large map, and with it roadmap, which is made for whoever
    looks at it, is made use of where a goal lies outside of that, or only a way longer than that reaches leads to it.
    seed: of the roadmap's samples; with it and the inputs the roadmap is determined. least_range: m, nearer the scanner
    sees nothing.
    """

    def __init__(
        self,
        robot: RobotConfig,
        odometry: OdometryConfig,
        sensor: TagSensorConfig,
        explorer: ExplorerConfig,
        planner: PlannerConfig,
        seed: int,
        least_range: float = 0.0,
    ):
        super().__init__()
        keep_to_one_thread()
        self._parameters = RoadmapParameters(robot, sensor, odometry, explorer, planner, seed, least_range)
        self._map = declare_message_input(self, "map")
        self._tfg = declare_message_input(self, "tfg")
        self._working_map = declare_message_input(self, "working_map")
        self._pose = declare_message_input(self, "pose")
        self._goal = declare_message_input(self, "goal")
        self._scan = declare_message_input(self, "scan")
        self._mission = declare_message_input(self, "mission")
        self._state = MessageState(self, initial_state())
        # Who looks at all of a large map's roadmap does so again and again: once a stage is enough.
        self._RoadmapOfAll = functools.lru_cache(maxsize=1)(self._MakeRoadmapOfAll)
        whole = {self.input_port_ticket(port.get_index()) for port in (self._map, self._tfg)}
        declare_message_output(self, "roadmap", self._Roadmap, self._state.tickets | whole)
        self._state.declare_output(self, "working_roadmap", lambda now: now.roadmap)
        self._state.declare_output(self, "path", lambda now: now.path)
        self._state.declare_output(self, "path_status", lambda now: now.status)
        self.DeclarePeriodicUnrestrictedUpdateEvent(PERIOD, 0.0, self._Update)

    def _Whole(self, context: Context) -> tuple[MapEstimate, TfgMap]:
        return eval_message(self._map, context, MapEstimate), eval_message(self._tfg, context, TfgMap)

    def _Roadmap(self, context: Context) -> Roadmap:
        now = self._state(context)
        if not now.parts.inactive:
            return now.roadmap
        estimate, tfg = self._Whole(context)
        return self._RoadmapOfAll(
            now.parts, estimate, tfg, obstacles_in_map(now, estimate).tobytes(), now.driven_before
        )

    def _MakeRoadmapOfAll(
        self, parts: Submaps[RoadmapState], estimate: MapEstimate, tfg: TfgMap, obstacles: bytes, driven: float
    ) -> Roadmap:
        segments = np.frombuffer(obstacles).reshape(-1, 4)
        return make_roadmap(whole_roadmap(parts, estimate.X_MA), tfg, estimate, self._parameters, segments, driven)

    def _Update(self, context: Context, state: State) -> EventStatus:
        now = self._state(context)
        working = eval_message(self._working_map, context, WorkingMap)
        mission = eval_message(self._mission, context, MissionStatus)
        scan = eval_message(self._scan, context, LaserScan)
        if working.stage > now.nodes.stage:
            take = self._Extend
        elif mission.phase == "plan":
            take = self._Plan
        elif mission.drives and scan.stamp > now.scan_stamp:
            take = self._Watch
        else:
            take = self._Step
        updated = take(context, now, working, scan, mission)
        if updated is now:
            return EventStatus.DidNothing()
        self._state.set(state, updated)
        return EventStatus.Succeeded()

    def _Step(
        self, context: Context, now: PlannerState, working: WorkingMap, scan: LaserScan, mission: MissionStatus
    ) -> PlannerState:
        return step(
            now,
            working,
            lambda: self._Whole(context),
            eval_message(self._pose, context, PoseEstimate),
            eval_message(self._goal, context, GoalChoice),
            scan,
            mission,
            self._parameters,
        )

    # A step's time is charged to what is due.
    _Extend, _Plan, _Watch = metered("roadmap")(_Step), metered("path")(_Step), metered("prm_planner")(_Step)
