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

# A goal this near to the one before, m, is the same.
SAME = 0.5


class FarthestFrontierSelector(LeafSystem):
    """Inputs tfg, roadmap, mission; output goal: a GoalChoice. The explorer connects them by name."""

    def __init__(self):
        super().__init__()
        self.tfg = declare_message_input(self, "tfg")
        self.roadmap = declare_message_input(self, "roadmap")
        self.mission = declare_message_input(self, "mission")
        self.goal = self.DeclareAbstractState(AbstractValue.Make(empty_choice()))
        ticket = {self.abstract_state_ticket(self.goal)}
        declare_message_output(self, "goal", lambda context: self.choice(context), ticket)
        self.DeclarePeriodicUnrestrictedUpdateEvent(1 / 16, 0.0, self.update)

    def choice(self, context):
        return context.get_abstract_state(int(self.goal)).get_value()

    def update(self, context, state):
        mission = eval_message(self.mission, context, MissionStatus)
        tfg, roadmap = eval_message(self.tfg, context, TfgMap), eval_message(self.roadmap, context, Roadmap)
        asked = mission.phase == "choose" and mission.stage > self.choice(context).stage
        if not asked or not mission.stage == tfg.stage == roadmap.stage:
            return
        # The places within reach from which some frontier can be seen.
        rows = np.flatnonzero(roadmap.reachable & (np.diff(roadmap.frontier_offsets) > 0))
        choice = replace(empty_choice(), stage=mission.stage)
        if len(rows):
            # It is asked at every glance, too: a goal is kept while it sees a frontier, or the robot would turn round.
            apart = np.hypot(*(roadmap.points[rows] - self.choice(context).p_MG).T)
            kept = self.choice(context).node >= 0 and apart.min() < SAME
            row = rows[np.argmin(apart) if kept else np.argmax(roadmap.travel_time[rows])]
            node, reason = int(roadmap.node_ids(row[None])[0]), "The farthest frontier is next."
            choice = replace(choice, node=node, p_MG=roadmap.points[row], reason=reason)
        else:
            choice = replace(choice, verdict="complete", reason="No frontier is left within reach.")
        state.get_mutable_abstract_state(int(self.goal)).set_value(choice)


def MakeExplorer(scenario):
    """The TFG explorer with another goal selector."""
    return MakeTfgExplorer(scenario, goal_selector=lambda _scenario: FarthestFrontierSelector())


if __name__ == "__main__":
    for name, goal_selector in (("as it is", None), ("the farthest first", lambda _: FarthestFrontierSelector())):
        mission = tfg_drake.explore("house", goal_selector=goal_selector, until=300.0)
        print(f"{name}: {mission}")
