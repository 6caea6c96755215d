"""Goes to the frontier that is farthest away: a method of one's own, in one file.

tfg-drake explore house --method examples/goal_selector.py
tfg-drake compare house --methods tfg,examples/goal_selector.py --seeds 5
"""

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import LeafSystem

import tfg_drake
from tfg_drake.diagrams.explorer import MakeTfgExplorer
from tfg_drake.messages import MissionStatus, Roadmap, TfgMap, replace
from tfg_drake.planning.goal_choice import empty_choice
from tfg_drake.systems.ports import declare_message_input, declare_message_output, eval_message


class FarthestFrontierSelector(LeafSystem):
    """Inputs tfg, roadmap, mission; output goal: a GoalChoice. The explorer connects them by name."""

    def __init__(self):
        super().__init__()
        self.tfg = declare_message_input(self, "tfg")
        self.roadmap = declare_message_input(self, "roadmap")
        self.mission = declare_message_input(self, "mission")
        self.goal = self.DeclareAbstractState(AbstractValue.Make(empty_choice()))
        declare_message_output(self, "goal", self.choice, {self.abstract_state_ticket(self.goal)})
        self.DeclarePeriodicUnrestrictedUpdateEvent(1 / 16, 0.0, self.update)

    def choice(self, context):
        return context.get_abstract_state(int(self.goal)).get_value()

    def update(self, context, state):
        mission = eval_message(self.mission, context, MissionStatus)
        tfg, roadmap = eval_message(self.tfg, context, TfgMap), eval_message(self.roadmap, context, Roadmap)
        before = self.choice(context)
        if mission.phase != "choose" or not before.stage < mission.stage == tfg.stage == roadmap.stage:
            return
        # The places within reach from which some frontier can be seen.
        rows = np.flatnonzero(roadmap.reachable & (np.diff(roadmap.frontier_offsets) > 0))
        choice = replace(empty_choice(), stage=mission.stage, verdict="complete", reason="No frontier is left.")
        if len(rows):
            # Asked at every glance, it keeps a goal (to 0.5 m) that sees a frontier, or the robot would turn round.
            apart = np.hypot(*(roadmap.points[rows] - before.p_MG).T)
            kept = before.node >= 0 and apart.min() < 0.5
            row = rows[np.argmin(apart) if kept else np.argmax(roadmap.travel_time[rows])]
            node, p_MG = int(roadmap.node_ids(row[None])[0]), roadmap.points[row]
            choice = replace(choice, verdict="goal", node=node, p_MG=p_MG, reason="The farthest frontier is next.")
        state.get_mutable_abstract_state(int(self.goal)).set_value(choice)


def MakeExplorer(scenario):
    """The TFG explorer with another goal selector."""
    return MakeTfgExplorer(scenario, goal_selector=lambda _scenario: FarthestFrontierSelector())


if __name__ == "__main__":
    for name, selector in {"as it is": None, "the farthest first": lambda _: FarthestFrontierSelector()}.items():
        print(f"{name}: {tfg_drake.explore('house', goal_selector=selector, until=300.0)}")
