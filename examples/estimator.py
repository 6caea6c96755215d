"""Puts another estimator into the explorer: one that knows the true pose, a bound for what any other can do.

It has the ports of SlamEstimator that others listen to, pose and map; its input truth.pose is connected to the
station's port of that name. It keeps no graph, and the rest does without.
"""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import LeafSystem

import tfg_drake
from tfg_drake.geometry.se2 import between, compose, inverse, transform
from tfg_drake.messages import MapEstimate, MissionStatus, Observation, PoseEstimate, TagDetections, message, replace
from tfg_drake.slam.keyframe_graph import empty_map
from tfg_drake.systems.ports import declare_message_input, declare_message_output, eval_message

EXACT = 1e-3  # m, what is stated


@message
class _Known:
    """The map, the poses X_MB (t, 4: stamp, x, y, theta) of the running turn, and where each tag was seen."""

    estimate: MapEstimate
    turn: np.ndarray
    tags: tuple


class TruthEstimator(LeafSystem):
    """Knows the pose, and each tag from its first sighting; keeps no graph."""

    def __init__(self, scenario):
        super().__init__()
        self.X_MW = inverse(np.array(scenario.world.start))
        self.truth = self.DeclareVectorInputPort("truth.pose", 5)
        self.detections = declare_message_input(self, "detections")
        self.mission = declare_message_input(self, "mission")
        self.known = self.DeclareAbstractState(AbstractValue.Make(_Known(empty_map(), np.zeros((0, 4)), ())))
        state = self.abstract_state_ticket(self.known)
        declare_message_output(self, "pose", self.calc_pose, {state, self.truth.ticket(), self.time_ticket()})
        declare_message_output(self, "map", lambda context: self.state(context).estimate, {state})
        self.DeclarePeriodicUnrestrictedUpdateEvent(1 / 16, 0.0, self.update)

    def state(self, context):
        return context.get_abstract_state(int(self.known)).get_value()

    def X_MB(self, context):
        return compose(self.X_MW, self.truth.Eval(context)[:3])

    def calc_pose(self, context):
        nothing = np.zeros(0, dtype=np.int64), np.zeros((0, 2))
        speed = self.truth.Eval(context)[3:]
        stage = self.state(context).estimate.stage
        return PoseEstimate(context.get_time(), self.X_MB(context), np.zeros((3, 3)), speed, stage, *nothing)

    def update(self, context, state):
        known, mission = self.state(context), eval_message(self.mission, context, MissionStatus)
        seen = eval_message(self.detections, context, TagDetections)
        X_MB = self.X_MB(context)
        places = np.stack([seen.range * np.cos(seen.bearing), seen.range * np.sin(seen.bearing)], axis=1)
        if context.get_time() - seen.stamp < 1 / 16:  # seen from here, or nearly
            found = dict(zip(seen.ids.tolist(), map(tuple, transform(X_MB, places)), strict=True)) | dict(known.tags)
            known = replace(known, tags=tuple(sorted(found.items())))
        if mission.phase in ("observe", "glance") and mission.stage == known.estimate.stage:
            known = replace(known, turn=np.vstack([known.turn, [context.get_time(), *X_MB]]))
        elif mission.phase == "map" and mission.stage == known.estimate.stage and len(known.turn):
            known = replace(known, estimate=self.mapped(known, X_MB), turn=np.zeros((0, 4)))
        state.get_mutable_abstract_state(int(self.known)).set_value(known)

    def mapped(self, known, X_MD):
        ids = np.array([tag for tag, _ in known.tags], dtype=np.int64)
        p_ML = np.array([place for _, place in known.tags]).reshape(-1, 2)
        X_MA, n = known.turn[0, 1:], len(ids)
        covariance = EXACT**2 * np.eye(2 * n + 3)
        observation = Observation(ids, stamps=known.turn[:, 0], X_AB=between(X_MA, known.turn[:, 1:]))
        return MapEstimate(
            stage=known.estimate.stage + 1,
            stamp=known.turn[-1, 0],
            ids=ids,
            p_ML=p_ML,
            X_MD=X_MD,
            local=np.arange(n),
            covariance=covariance,
            landmark_covariance=np.tile(EXACT**2 * np.eye(2), (n, 1, 1)),
            X_MA=np.vstack([known.estimate.X_MA, X_MA]),
            observation=observation,
            entropy=n * np.log(2 * np.pi * np.e * EXACT**2),
        )


if __name__ == "__main__":
    for name, estimator in (("as it is", None), ("the truth", TruthEstimator)):
        mission = tfg_drake.explore("house", estimator=estimator, until=600.0)
        print(f"{name}: {mission}")
