"""Makes an estimator from a given pose: maps what the sensors see from there."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydrake.systems.framework import Context, LeafSystem
from scipy.linalg import block_diag

from tfg_drake.geometry import se2
from tfg_drake.messages import (
    FloatArray,
    IntArray,
    MapEstimate,
    Observation,
    PoseEstimate,
    TagDetections,
    message,
    replace,
)
from tfg_drake.slam.keyframe_graph import empty_map
from tfg_drake.systems.ports import PERIOD, MessageInputs, MessageState, declare_message_output


@message
class _Seen:
    """The map; the poses X_MB (t, 4: stamp, x, y, theta) of the current observation; for each tag seen, by ids (n,)
    ascending, its information (n,), 1/m^2, and information times position in M (n, 2), m; stamp of the newest
    detections, s."""

    estimate: MapEstimate
    way: FloatArray
    ids: IntArray
    information: FloatArray
    weighted: FloatArray
    stamp: float


class PoseMapper(LeafSystem):
    """Maps tags by a given pose, each at its weighted mean position, and states the pose's deviations.

    .. pydrake_system::

        name: PoseMapper
        input_ports:
        - X_MB
        - odometry
        - detections
        - mission
        output_ports:
        - pose
        - map

    X_MB: a vector of size 3, x and y in m, theta in rad, in the map frame M, the robot's start pose. odometry:
    Odometry, for its speeds. detections: TagDetections. mission: MissionStatus. pose: PoseEstimate. map: MapEstimate
    after the newest view; a view collects the phases "observe" and "glance", and joins the map in phase "map".
    """

    def __init__(self, sigma: Sequence[float] = (0.05, 0.05, 0.02)) -> None:
        """sigma: standard deviations of X_MB to state, m, m, rad."""
        super().__init__()
        self.set_name("pose_mapper")
        self._covariance = np.diag(np.square(np.asarray(sigma, dtype=float)))
        self._X_MB = self.DeclareVectorInputPort("X_MB", 3)
        self._inputs = MessageInputs(self, "odometry", "detections", "mission")
        nothing = np.zeros(0)
        self._state = MessageState(
            self,
            _Seen(empty_map(), np.zeros((0, 4)), nothing.astype(np.int64), nothing, np.zeros((0, 2)), -np.inf),
            self._Update,
        )
        tickets = {*self._state.tickets, self._X_MB.ticket(), self._inputs.ports["odometry"].ticket()}
        declare_message_output(self, "pose", self._CalcPose, {*tickets, self.time_ticket()})
        self._state.declare_outputs(self, map=lambda now: now.estimate)

    def _CalcPose(self, context: Context) -> PoseEstimate:
        odometry, stage = self._inputs(context, "odometry"), self._state(context).estimate.stage
        X_MB, nothing = self._X_MB.Eval(context), (np.zeros(0, dtype=np.int64), np.zeros((0, 2)))
        return PoseEstimate(context.get_time(), X_MB, self._covariance, odometry.V_B, stage, *nothing)

    def _Update(self, context: Context, seen: _Seen) -> _Seen:
        X_MB = self._X_MB.Eval(context)
        if not np.all(np.isfinite(X_MB)):
            raise ValueError(f"{self._X_MB.GetFullDescription()} must be finite, not {X_MB}, at {context.get_time()} s")
        detections, mission = self._inputs.each(context, "detections", "mission")
        if detections.stamp > max(seen.stamp, context.get_time() - PERIOD):
            seen = _with_detections(seen, X_MB, detections, self._covariance)
        if mission.stage == seen.estimate.stage:
            if mission.phase in ("observe", "glance"):
                seen = replace(seen, way=np.vstack([seen.way, [context.get_time(), *X_MB]]))
            elif mission.phase == "map" and len(seen.way):
                seen = replace(seen, estimate=_mapped(seen, X_MB, self._covariance), way=np.zeros((0, 4)))
        return seen


def _with_detections(seen: _Seen, X_MB: FloatArray, detections: TagDetections, covariance: FloatArray) -> _Seen:
    """Return the state with the tags of one frame added, seen from X_MB (3,)."""
    r, angle = detections.range, X_MB[2] + detections.bearing
    p_ML = X_MB[:2] + r[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    variance = detections.sigma_range**2 + (r * detections.sigma_bearing) ** 2 + r**2 * covariance[2, 2]
    ids, row = np.unique(np.append(seen.ids, detections.ids), return_inverse=True)
    information, weighted = np.zeros(len(ids)), np.zeros((len(ids), 2))
    np.add.at(information, row, np.append(seen.information, 1.0 / variance))
    np.add.at(weighted, row, np.vstack([seen.weighted, p_ML / variance[:, None]]))
    return replace(seen, ids=ids, information=information, weighted=weighted, stamp=detections.stamp)


def _mapped(seen: _Seen, X_MD: FloatArray, covariance: FloatArray) -> MapEstimate:
    """Return the map with the current observation as a new view."""
    n, X_MA, no_wall = len(seen.ids), seen.way[0, 1:], np.zeros((len(seen.ids), 2))
    # The covariance of the pose's position adds to every landmark's alike.
    each = 1.0 / seen.information[:, None, None] * np.eye(2) + covariance[:2, :2]
    return replace(
        seen.estimate,
        stage=seen.estimate.stage + 1,
        stamp=float(seen.way[-1, 0]),
        ids=seen.ids,
        p_ML=seen.weighted / seen.information[:, None],
        anchor=no_wall,
        reach=no_wall,
        X_MD=X_MD,
        local=np.arange(n),
        covariance=block_diag(*each, covariance),
        landmark_covariance=each,
        X_MA=np.vstack([seen.estimate.X_MA, X_MA]),
        observation=Observation(seen.ids, seen.way[:, 0], se2.between(X_MA, seen.way[:, 1:])),
        entropy=0.5 * float(np.linalg.slogdet(2.0 * np.pi * np.e * each)[1].sum()),
        shared=np.zeros(0),
        with_shared=np.zeros((0, 0)),
    )
