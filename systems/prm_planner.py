"""The PRM planner: extends the roadmap at each stage, plans the path to the chosen goal, and monitors it."""

from __future__ import annotations

import operator

from pydrake.systems.framework import Context, LeafSystem

from tfg_drake.messages import Roadmap
from tfg_drake.planning import planner
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.systems.blas_threads import keep_to_one_thread
from tfg_drake.systems.cpu_meter import measured
from tfg_drake.systems.ports import MessageInputs, MessageState, declare_message_output


class PrmPlanner(LeafSystem):
    """Runs `tfg_drake.planning.planner` at 16 Hz.

    .. pydrake_system::

        name: PrmPlanner
        input_ports:
        - map
        - tfg
        - pose
        - goal
        - scan
        - mission
        output_ports:
        - roadmap
        - local_roadmap
        - path
        - path_status

    map: MapEstimate, tfg: TfgMap, pose: PoseEstimate, goal: GoalChoice, mission: MissionStatus, roadmap: Roadmap,
    local_roadmap: Roadmap, path: Path, path_status: PathStatus, all in M. scan: LaserScan.

    local_roadmap is the part of roadmap that planning needs at a stage, with the same ids: on a large map the nodes
    near the newest view, see `tfg_drake.planning.local`. Then roadmap is computed only for display.
    Parameters, including the seed of the samples, and all inputs so far determine the roadmap.
    """

    def __init__(self, parameters: PlanningParameters) -> None:
        super().__init__()
        keep_to_one_thread()
        self._parameters = parameters
        self._inputs = MessageInputs(self, "map", "tfg", "pose", "goal", "scan", "mission")
        self._state = MessageState(self, planner.initial_state(), self._Update)
        whole = {self._inputs.ports[name].ticket() for name in ("map", "tfg")}
        declare_message_output(self, "roadmap", self._Roadmap, self._state.tickets | whole)
        local_roadmap, path_status = operator.attrgetter("roadmap"), operator.attrgetter("status")
        self._state.declare_outputs(self, "path", local_roadmap=local_roadmap, path_status=path_status)

    def _Roadmap(self, context: Context) -> Roadmap:
        state = self._state(context)
        if len(state.roadmap.points) == len(state.nodes.points):
            return state.roadmap
        estimate, tfg = self._inputs.each(context, "map", "tfg")
        met = planner.obstacles_in_map(state, estimate)
        return planner.make_roadmap(state.nodes, tfg, estimate, self._parameters, met, state.driven_before)

    def _Update(self, context: Context, before: planner.PlannerState) -> planner.PlannerState:
        now = planner.Now(*(*self._inputs.each(context), self._parameters))
        seen = after = planner.looked(before, now)
        # CPU time is metered only where work is due, as metering would take longer than the check.
        if now.tfg.stage > seen.nodes.stage:
            after = measured(self, "roadmap", planner.extended, seen, now)
        elif now.mission.phase == "plan":
            after = measured(self, "path", planner.planned, seen, now)
        if after is seen:
            after = measured(self, "prm_planner", planner.watched, seen, now)
        return after
