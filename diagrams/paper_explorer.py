"""The explorer with the rules of the paper as printed."""

from __future__ import annotations

from pydrake.systems.framework import Diagram

from tfg_drake.diagrams.explorer import MakeTfgExplorer
from tfg_drake.diagrams.scenario import ApplySettings, Scenario
from tfg_drake.planning import paper_rules, roadmap
from tfg_drake.planning.paper_rules import PaperRules
from tfg_drake.systems.info_gain_goal_selector import InfoGainGoalSelector
from tfg_drake.systems.prm_planner import PrmPlanner


def MakePaperExplorer(scenario: Scenario, rules: PaperRules | None = None) -> Diagram:
    """The explorer of MakeTfgExplorer for a scenario, with those of the paper's rules that hold, by default all."""
    rules = rules or PaperRules()
    frontiers = paper_rules.frontiers_between_landmarks if rules.frontiers else None
    cost = paper_rules.cost_of_edge if rules.path_cost else roadmap.cost_of_edge

    def selector(of: Scenario) -> InfoGainGoalSelector:
        return InfoGainGoalSelector(
            of.robot, of.odometry, of.tags, of.explorer, of.seed, of.scan.range, frontiers=frontiers
        )

    def planner(of: Scenario) -> PrmPlanner:
        return PrmPlanner(
            of.robot, of.odometry, of.tags, of.explorer, of.planner, of.seed, of.scan.least_range, cost=cost
        )

    return MakeTfgExplorer(ApplySettings(scenario, rules.settings()), selector, planner=planner)
