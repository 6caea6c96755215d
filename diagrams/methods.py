"""The methods that explore, by name: each makes an explorer with the ports of MakeTfgExplorer for a scenario.

A method of one's own is a Python file with a function MakeExplorer(scenario) -> Diagram. It is named by its path
wherever a method is named; so is the keys.csv that a run with the method manual leaves, whose keys are pressed once
more. SETTINGS in such a Python file are the settings that the method fixes, such as ["explorer.goal=random"].
"""

from __future__ import annotations

import dataclasses
import runpy
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from pydrake.systems.framework import Diagram

from tfg_drake.bad_input import BadInput
from tfg_drake.diagrams.driven_explorers import MakeManualExplorer, MakeScriptedExplorer
from tfg_drake.diagrams.explorer import MakeGoalSelector, MakePlanner, MakeTfgExplorer
from tfg_drake.diagrams.grid_explorer import MakeGridExplorer
from tfg_drake.diagrams.parts import PartsOf
from tfg_drake.diagrams.scenario import ApplySettings, MakeKeepOut, Scenario, ScenarioError
from tfg_drake.mission.manual_drive import DriveError, read_drive
from tfg_drake.planning import paper_rules, parameters
from tfg_drake.planning.paper_rules import PaperRules


class MethodError(ValueError):
    """A method that cannot be used; the message is one line: what is wrong and how to mend it."""


@dataclasses.dataclass(frozen=True)
class Method:
    """name; MakeExplorer: the diagram for a scenario, of whose world it reads nothing. needs_drive: the scenario must
    have a drive. keeps_budget: it minds explorer.budget_* and explorer.return_home. has_candidates: its goal_selector
    is an InfoGainGoalSelector, whose choice can be changed (`fork`). needs_keys: somebody must press keys meanwhile.
    needs_tags: it maps nothing else.
    knows_map: it can begin with one (explorer.known_map). source: the path of its file, if there is one. settings:
    those of the scenario that it fixes, as for `--set`.

    The diagram's inputs are base.odometry, base.hazards, tags.detections, scan.ranges (messages), base.enabled, pause,
    stop and recall (vectors of size 1) and requested_goal (a RequestedGoal), as many of them as it wants: without
    recall it is ended where its robot's battery is low. Its outputs are base.velocity_commanded, pose (PoseEstimate)
    and mission (MissionStatus), and, where it has them, map, tfg, roadmap, goal, path and grid.
    """

    name: str
    MakeExplorer: Callable[[Scenario], Diagram]
    needs_drive: bool = False
    keeps_budget: bool = True
    has_candidates: bool = False
    needs_keys: bool = False
    needs_tags: bool = False
    source: str = ""
    knows_map: bool = True
    settings: tuple[str, ...] = ()

    def __reduce__(self) -> tuple[Callable[[str], Method], tuple[str]]:
        """Pickle the method as its name or file, by which another process finds it."""
        return FindMethod, (self.source or self.name,)

    @property
    def takes_parts(self) -> bool:
        """True if the method reads explorer.parts; a user's own method is assumed to."""
        return self.has_candidates or self.source.endswith(".py") or self.name == "own"

    def Fixed(self, scenario: Scenario) -> Scenario:
        """Return the scenario with the method's fixed settings, for its explorer."""
        return ApplySettings(scenario, self.settings) if self.settings else scenario

    def Check(self, scenario: Scenario, settings: Sequence[str] | str = ()) -> None:
        """Raises MethodError where the scenario lacks what the method needs, or where a user's `settings` of it are not
        those that the method fixes; ScenarioError where the robot must not be where it starts, or where the gain counts
        tags and the world has none."""
        if refused := self.Refused(scenario, [settings] if isinstance(settings, str) else settings):
            raise MethodError(refused)
        if self.needs_drive and not scenario.drive:
            raise MethodError(f"{self.name}: the scenario has no drive; give it one, a list of [x, y] under `drive:`")
        if self.needs_tags and scenario.world.walls and not scenario.world.tags:
            raise MethodError(f"{self.name}: maps tags alone, and the world has none; --tag-spacing 1 places some")
        limits = [key for key in ("budget_time", "budget_distance", "return_home") if getattr(scenario.explorer, key)]
        if limits and not self.keeps_budget:
            key = limits[0]
            raise MethodError(f"{self.name}: does not mind explorer.{key}; leave it out, or take another method: tfg")
        if scenario.explorer.known_map and not self.knows_map:
            raise MethodError(f"{self.name}: cannot begin with a map; leave --map out, or take another method: tfg")
        if (parts := PartsOf(scenario)) and not self.takes_parts:
            raise MethodError(f"{self.name}: takes no explorer.parts.{next(iter(parts))}; take another method: tfg")
        explorer = self.Fixed(scenario).explorer
        without = "the world has none; --tag-spacing 1 places some" if not scenario.world.tags else ""
        if explorer.landmarks == "walls":
            without = "explorer.landmarks=walls maps none"
        if explorer.gain != "exact" and scenario.world.walls and without:
            raise ScenarioError(f"explorer.gain={explorer.gain}: counts tags alone, and {without}, or take exact")
        MakeKeepOut(scenario)

    def Refused(self, scenario: Scenario, settings: Sequence[str]) -> str:
        """Return why a user's settings contradict those that the method fixes, "" if they do not."""
        fixed = self.Fixed(scenario)
        for own in self.settings:
            key = own.partition("=")[0]
            given = [setting for setting in settings if setting.partition("=")[0] == key]
            if given and ApplySettings(fixed, given) != fixed:
                return f"{self.name}: fixes {own}; leave {given[-1]} out, or take another method: tfg"
        return ""


def MakePaperExplorer(scenario: Scenario, rules: PaperRules | None = None) -> Diagram:
    """The explorer of MakeTfgExplorer for a scenario, with those of the paper's rules that hold, by default all; it has
    the settings of these, whatever the scenario says."""
    rules = rules or PaperRules()
    frontiers = paper_rules.frontiers_between_landmarks if rules.frontiers else None
    cost = paper_rules.cost_of_edge if rules.path_cost else parameters.cost_of_edge
    selector, planner = partial(MakeGoalSelector, frontiers=frontiers), partial(MakePlanner, cost=cost)
    return MakeTfgExplorer(ApplySettings(scenario, rules.settings()), selector, planner=planner)


# Sections of the scenario that a method may fix; the others belong to the world and are the same for all methods.
_OWN_SECTIONS = ("explorer.", "planner.", "grid.")
# The first look determines the heading of a map of tags; scan matching gains nothing from it.
_GRID_SETTINGS = ("explorer.first_look=0", "explorer.first_turns=1")

METHODS = {
    method.name: method
    for method in (
        # The scenario's own rule on the TFG, by default a tour of what is open.
        Method("tfg", MakeTfgExplorer, has_candidates=True),
        # The goal of most information gain, as in the paper, on the TFG; nothing is mapped on the way there.
        Method(
            "tfg-argmax",
            MakeTfgExplorer,
            has_candidates=True,
            settings=("explorer.goal=argmax", "explorer.glance_period=0", "explorer.path_keyframe_period=0"),
        ),
        # The paper's rules as printed: goals, gain, frontiers, path cost; tags are mapped at goals only.
        Method(
            "paper", MakePaperExplorer, has_candidates=True, needs_tags=True, settings=tuple(PaperRules().settings())
        ),
        # The nearest frontier on the TFG.
        Method("tfg-nearest", MakeTfgExplorer, has_candidates=True, settings=("explorer.goal=nearest_frontier",)),
        # The paper's baseline: GMapping and the nearest frontier.
        Method("grid-nearest", MakeGridExplorer, keeps_budget=False, knows_map=False, settings=_GRID_SETTINGS),
        # The weighted sum of grid entropy and pose uncertainty (the paper's eq. 1) on GMapping's map.
        Method(
            "weighted",
            partial(MakeGridExplorer, weighted=True),
            keeps_budget=False,
            knows_map=False,
            settings=_GRID_SETTINGS,
        ),
        # A random reachable place, on the TFG.
        Method("random", MakeTfgExplorer, has_candidates=True, settings=("explorer.goal=random",)),
        # The scenario's drive, as of a human operator, on the TFG.
        Method("scripted", MakeScriptedExplorer, needs_drive=True, keeps_budget=False),
        # A person at the keys, on the TFG.
        Method("manual", MakeManualExplorer, keeps_budget=False, needs_keys=True),
    )
}


def NamedMethod(option: str, name_or_path: str, scenario: Scenario, settings: Sequence[str] = ()) -> Method:
    """The method that an option of the command line names, for a scenario with a user's settings. Raises BadInput."""
    try:
        method = FindMethod(name_or_path)
        method.Check(scenario, settings)
    except MethodError as error:
        raise BadInput(f"{option} {error}") from None
    return method


def FindMethod(name_or_path: str) -> Method:
    """A method by its name or the path of its file; raises MethodError if there is neither."""
    if name_or_path in METHODS:
        return METHODS[name_or_path]
    path = Path(name_or_path)
    if path.suffix == ".csv":
        try:
            drive = read_drive(path)
        except DriveError as error:
            raise MethodError(str(error)) from None
        driven = partial(MakeManualExplorer, drive=drive)
        return dataclasses.replace(METHODS["manual"], MakeExplorer=driven, needs_keys=False, source=str(path.resolve()))
    if path.suffix != ".py" or not path.is_file():
        what = "file" if path.suffix == ".py" else "method"
        raise MethodError(f"{name_or_path}: no such {what}; name a .py file or one of {', '.join(METHODS)}")
    try:
        names = runpy.run_path(name_or_path, run_name=path.stem)
    except (Exception, SystemExit) as error:
        raise MethodError(f"{name_or_path}: cannot be imported: {type(error).__name__}: {error}") from error
    make, settings = names.get("MakeExplorer"), names.get("SETTINGS", ())
    if not callable(make):
        raise MethodError(
            f"{name_or_path}: has no MakeExplorer(scenario) that returns the explorer's diagram; define it"
        )
    if not isinstance(settings, list | tuple) or not all(str(one).startswith(_OWN_SECTIONS) for one in settings):
        sections = ", ".join(_OWN_SECTIONS)
        raise MethodError(f'{name_or_path}: SETTINGS must be a list such as ["explorer.goal=random"], of {sections}')
    try:
        ApplySettings(Scenario(), settings)
    except ScenarioError as error:
        raise MethodError(f"{name_or_path}: SETTINGS: {str(error).removeprefix('--set ')}") from None
    return Method(path.stem, make, source=str(path.resolve()), settings=tuple(settings))
