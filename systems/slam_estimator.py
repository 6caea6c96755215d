"""The SLAM estimator as a Drake system, see tfg_drake/slam/estimator.py."""

from __future__ import annotations

import math
from pathlib import Path

from pydrake.systems.framework import Context, LeafSystem, State

from tfg_drake.config import ExplorerConfig, OdometryConfig, ScanConfig, TagSensorConfig
from tfg_drake.mapfile.known_map import begun_with
from tfg_drake.mapfile.saved_map import load_map
from tfg_drake.messages import PoseEstimate, replace
from tfg_drake.slam.estimator import (
    begin_turn,
    close_piece,
    end_turn,
    pose_estimate,
    process_detections,
    process_odometry,
    process_scan,
)
from tfg_drake.slam.estimator_state import EstimatorState, initial_state
from tfg_drake.slam.keyframe_graph import empty_map
from tfg_drake.slam.relocalizer import said_to_be
from tfg_drake.slam.shared import by_data_sheet
from tfg_drake.slam.walls import no_walls
from tfg_drake.systems.blas_threads import keep_to_one_thread
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import PERIOD, MessageInputs, MessageState

# A recording's odometry has ended if no message arrives for SILENCE, s.
SILENCE = 1.0


class SlamEstimator(LeafSystem):
    """Estimates the robot's pose at 16 Hz and the map at every view.

    .. pydrake_system::

        name: SlamEstimator
        input_ports:
        - odometry
        - detections
        - scan
        - mission
        - goal
        - said_pose
        output_ports:
        - pose
        - map
        - landmarks
        - hypotheses
        - estimator_state

    odometry: Odometry, detections: TagDetections, scan: LaserScan, mission: MissionStatus. goal: GoalChoice, optional:
    once it reports that all is explored, landmarks all over a large map become jointly known. said_pose: SaidPose,
    optional: the robot's pose in its known map as stated by a person, used while the session maps apart. pose:
    PoseEstimate at the newest odometry, with the number of places of a known map where the robot may be. map:
    MapEstimate of the tags after the newest view, of stage 0 and empty before the first. landmarks: MapEstimate of tags
    and walls, likewise. hypotheses: Hypotheses, the places of a known map where the robot may be, while there are
    several. estimator_state: EstimatorState, the whole state, for saving the map. A turn is open while the mission is
    in phase "observe" or "glance"; in phase "map" it is solved and the map's stage becomes the mission's stage plus
    one. Each message is processed once, by its stamp.
    """

    def __init__(
        self,
        odometry_config: OdometryConfig,
        sensor: TagSensorConfig,
        scanner: ScanConfig,
        explorer: ExplorerConfig,
        *,
        recorded: bool = False,
    ) -> None:
        """odometry_config, sensor, scanner: data sheets of odometry, camera and scanner. explorer: its
        path_keyframe_period, solver and landmarks, see `tfg_drake.slam.estimator_state.initial_state`, and known_map.
        recorded: the drive is recorded and has no turns: phase "map" maps the piece of the way since the last view.
        Raises MapFileError if known_map is not a map."""
        super().__init__()
        keep_to_one_thread()
        self.set_name("slam_estimator")
        self._inputs = MessageInputs(self, "odometry", "detections", "scan", "mission", "goal", "said_pose")
        prior = by_data_sheet(odometry_config, sensor, scanner)
        self._recorded = recorded
        state = initial_state(
            odometry_config,
            math.inf if recorded else explorer.path_keyframe_period,
            prior,
            explorer.solver,
            explorer.landmarks,
            no_walls(scanner.least_looks),
            sensor,
            may_be_moved=not recorded,
        )
        if explorer.known_map:
            state = begun_with(load_map(Path(explorer.known_map)), state, explorer.known_at)
        self._state = MessageState(self, state)
        self._detections_stamp = MessageState(self, -math.inf)
        self._said_stamp = MessageState(self, -math.inf)
        nothing = empty_map(prior)
        self._state.declare_outputs(
            self,
            pose=self._Pose,
            map=lambda now: nothing if now.map is None else now.map.of_tags,
            landmarks=lambda now: now.map or nothing,
            hypotheses=lambda now: now.hypotheses,
        )
        self.DeclareStateOutputPort("estimator_state", self._state.index)
        self.DeclarePeriodicUnrestrictedUpdateEvent(period_sec=PERIOD, offset_sec=0.0, update=self._Update)

    @metered("slam_estimator")
    def _Pose(self, now: EstimatorState) -> PoseEstimate:
        return pose_estimate(now)

    @metered("slam_estimator")
    def _Update(self, context: Context, state: State) -> None:
        estimator = self._state(context)
        detections_stamp = self._detections_stamp(context)
        odometry, detections, mission, scan = self._inputs.each(context, "odometry", "detections", "mission", "scan")

        estimator = process_scan(estimator, scan)
        estimator = process_odometry(estimator, odometry)
        if detections.stamp > detections_stamp:
            estimator = process_detections(estimator, detections)
            self._detections_stamp.set(state, detections.stamp)
        said = self._inputs.optional(context, "said_pose")
        if said is not None and said.stamp > self._said_stamp(context):
            estimator = said_to_be(estimator, said, pose_estimate(estimator).X_MB)
            self._said_stamp.set(state, said.stamp)
        stage = estimator.map.stage if estimator.map is not None else 0
        waits = estimator.turn is None and estimator.newest is not None
        if self._recorded:
            if mission.phase == "map" and waits and stage == mission.stage:
                at_last = context.get_time() >= odometry.stamp + SILENCE
                estimator = close_piece(estimator, odometry.stamp, at_last=at_last)
        elif mission.phase in ("observe", "glance") and waits and stage == mission.stage:
            estimator = begin_turn(estimator, odometry.stamp)
        elif mission.phase == "map" and estimator.turn is not None and stage == mission.stage:
            goal = self._inputs.optional(context, "goal")
            explored = goal is not None and goal.is_explored
            estimator = end_turn(estimator, odometry.stamp, explored=explored)
        if math.isfinite(estimator.placed) and estimator.placed != self._state(context).placed:
            # An older view may have located the robot: the poses published up to now are in another frame.
            estimator = replace(estimator, placed=odometry.stamp)
        self._state.set(state, estimator)
