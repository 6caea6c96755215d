"""Goes to the frontier that is farthest away: a method of one's own, in one file.

tfg-drake explore house --method examples/goal_selector.py
tfg-drake compare house --methods tfg,examples/goal_selector.py --seeds 5
"""

import numpy as np
from pydrake.systems.framework import LeafSystem

import tfg_drake
from tfg_drake.diagrams.explorer import MakeTfgExplorer
from tfg_drake.messages import replace
from tfg_drake.planning.goal_choice import empty_choice
from tfg_drake.systems.ports import MessageInputs, MessageState


class FarthestFrontierSelector(LeafSystem):
    """Inputs tfg, roadmap, mission; output goal: a GoalChoice. The explorer connects them by name."""

    def __init__(self):
        super().__init__()
        self.inputs = MessageInputs(self, "tfg", "roadmap", "mission")
        goal = MessageState(self, empty_choice(), self.update)
        self.DeclareStateOutputPort("goal", goal.index)

    def update(self, context, before):
        """The choice now, after the one before; asked 16 times a second."""
        tfg, roadmap, mission = self.inputs.each(context)
        if mission.phase != "choose" or not before.stage < mission.stage == tfg.stage == roadmap.stage:
            return before
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
        return choice


def MakeExplorer(scenario):
    """The TFG explorer with another goal selector."""
    return MakeTfgExplorer(scenario, goal_selector=lambda _scenario: FarthestFrontierSelector())


if __name__ == "__main__":
    for name, selector in {"as it is": None, "the farthest first": lambda _: FarthestFrontierSelector()}.items():
        print(f"{name}: {tfg_drake.explore('house', goal_selector=selector, until=300.0)}")
