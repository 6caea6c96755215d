"""The explorer with the rules of the paper as printed."""

from __future__ import annotations

from functools import partial

from pydrake.systems.framework import Diagram

from tfg_drake.diagrams.explorer import MakeGoalSelector, MakePlanner, MakeTfgExplorer
from tfg_drake.diagrams.scenario import ApplySettings, Scenario
from tfg_drake.planning import paper_rules, roadmap
from tfg_drake.planning.paper_rules import PaperRules


def MakePaperExplorer(scenario: Scenario, rules: PaperRules | None = None) -> Diagram:
    """The explorer of MakeTfgExplorer for a scenario, with those of the paper's rules that hold, by default all."""
    rules = rules or PaperRules()
    frontiers = paper_rules.frontiers_between_landmarks if rules.frontiers else None
    cost = paper_rules.cost_of_edge if rules.path_cost else roadmap.cost_of_edge
    selector, planner = partial(MakeGoalSelector, frontiers=frontiers), partial(MakePlanner, cost=cost)
    return MakeTfgExplorer(ApplySettings(scenario, rules.settings()), selector, planner=planner)
