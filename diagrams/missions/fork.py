"""Forks a simulated mission: back to one of its stages, to go on from there, perhaps to another goal.

A run is driven anew from its seed, which gives the same bits; the goal of one stage is then another, and stays so until
the robot has looked round there.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, EventStatus

from tfg_drake.bad_input import BadInput
from tfg_drake.diagrams.methods import METHODS
from tfg_drake.diagrams.missions.mission import Mission, MissionRequest
from tfg_drake.diagrams.scenario import LoadScenario
from tfg_drake.geometry.se2 import transform
from tfg_drake.messages import FloatArray, GoalChoice, MapEstimate, MissionStatus, Roadmap
from tfg_drake.planning.requested_goal import goal_there
from tfg_drake.storage.run import Run, load_run
from tfg_drake.systems.info_gain_goal_selector import InfoGainGoalSelector

# The nearest reachable node, at most NEXT_TO_GOAL, m, away, replaces a requested goal; the robot has reached a goal
# that is nearer than that.
NEXT_TO_GOAL = 0.5
# Fields of a run's summary that a fork needs.
_NEEDED = ("method", "contacts", "outcome", "sim_time_s", "scenario", "world", "version")


class ForkError(BadInput, ValueError):
    """A run or a stage that cannot be forked; the message is one line: what, where and how to mend it."""


@dataclasses.dataclass(frozen=True)
class Candidate:
    """One of the places that a stage's goal was chosen from. node: its id in the roadmap. p_WG: (2,) m. gain,
    exploitation, exploration, pose_price: nats. time: s to get there. chosen: it was."""

    node: int
    p_WG: FloatArray
    gain: float
    exploitation: float
    exploration: float
    pose_price: float
    time: float
    chosen: bool


class Fork:
    """Changes a mission's goals from a stage on, by the choice in its Context.

    candidates: those of the stage, the most gain first, once it has been reached. failure: what ended the mission
    there, None where nothing did.
    """

    def __init__(self, stage: int, goal: Sequence[float] | None = None, candidate: int | None = None) -> None:
        """stage: whose choice is changed. goal: (2,) in W, m, where to go instead; candidate: or the number of one of
        its candidates, 1 for that with the most gain; without either nothing is changed."""
        self.stage = stage
        self.candidates: list[Candidate] = []
        self.failure: ForkError | None = None
        self._goal, self._candidate = goal, candidate
        self._node, self._seen, self._over = -1, 0, False

    @property
    def reached(self) -> bool:
        """True once the mission is at the stage, and what is asked for has become its goal."""
        return self._seen >= self.stage

    def monitor(self, mission: Mission, *, stops: bool = False) -> Callable[[Context], EventStatus]:
        """Monitor for a mission's Simulator, called after every step: replaces a goal before anybody has read the one
        that was chosen. stops: it ends the advance when the stage has been reached."""

        def after_step(root: Context) -> EventStatus:
            before = self.reached
            self.apply(mission, root)
            if stops and self.reached and not before:
                return EventStatus.ReachedTermination(mission.simulator.get_system(), f"stage {self.stage}")
            return EventStatus.DidNothing()

        return after_step

    def apply(self, mission: Mission, root: Context) -> None:
        """Changes the newest choice, if it is one to be changed; called whenever the mission's state may have changed.

        Raises:
            ForkError: the stage has no such goal.
        """
        choice = mission.look("goal", GoalChoice)
        if self._over or choice.stage < self.stage or choice.stage <= self._seen:
            return
        first, self._seen = not self.reached, choice.stage
        roadmap = mission.look("roadmap", Roadmap)
        if first:
            self.candidates = _candidates(choice, roadmap, mission.X_WM)
            try:
                self._node = self._asked(roadmap, mission.X_WM)
            except ForkError as error:
                self.failure = error
                raise
        estimate = mission.look("map", MapEstimate)
        status = mission.look("mission", MissionStatus)
        row = int(roadmap.nodes(np.array([self._node]))[0])
        # Until the robot has looked round there, or can no longer get there.
        off = np.hypot(*(roadmap.points[row] - estimate.X_MA[-1, :2]))
        arrived = not first and not status.moving and off < NEXT_TO_GOAL
        if self._node < 0 or row < 0 or arrived or not roadmap.reachable[row]:
            self._over = True
            return
        held = goal_there(choice, self._node, roadmap, f"It was asked for at stage {self.stage}.")
        selector = next(one for one in mission.explorer.GetSystems() if isinstance(one, InfoGainGoalSelector))
        selector.Choose(selector.GetMyMutableContextFromRoot(root), held)

    def _asked(self, roadmap: Roadmap, X_WM: FloatArray) -> int:
        if self._candidate is not None:
            if not 1 <= self._candidate <= len(self.candidates):
                raise ForkError(f"candidate {self._candidate}: stage {self.stage} has 1 to {len(self.candidates)}")
            return self.candidates[self._candidate - 1].node
        if self._goal is None:
            return -1
        reachable = np.flatnonzero(roadmap.reachable)
        places = transform(X_WM, roadmap.points[reachable])
        distance = np.hypot(*(places - np.array(self._goal, dtype=float)).T)
        if not len(distance) or distance.min() > NEXT_TO_GOAL:
            near = (
                f"; the nearest is ({', '.join(f'{v:.2f}' for v in places[distance.argmin()])})" if len(places) else ""
            )
            x, y = self._goal
            place = f"no place within {NEXT_TO_GOAL:g} m that is known to be reachable at stage {self.stage}"
            raise ForkError(f"goal {x:g},{y:g}: {place}{near}")
        return int(roadmap.node_ids(reachable[[distance.argmin()]])[0])


def _candidates(choice: GoalChoice, roadmap: Roadmap, X_WM: FloatArray) -> list[Candidate]:
    rows = roadmap.nodes(choice.candidates)
    found = [
        Candidate(
            node=int(choice.candidates[i]),
            p_WG=transform(X_WM, roadmap.points[[row]])[0],
            **{name: float(getattr(choice, name)[i]) for name in ("gain", "exploitation", "exploration", "pose_price")},
            time=float(roadmap.travel_time[row]),
            chosen=bool(choice.candidates[i] == choice.node),
        )
        for i, row in enumerate(rows.tolist())
        if row >= 0 and roadmap.reachable[row]
    ]
    return sorted(found, key=lambda one: (-one.gain, one.node))


def forkable(run: Run | str | Path, stage: int) -> tuple[Run, MissionRequest]:
    """A run, and what asks for it once more, if the run can be forked at a stage.

    Raises:
        ForkError: it was no simulated run of a method with a goal selector, or it has no such stage.
        FileError, ScenarioError: the folder holds no run, or a file in it is damaged.
    """
    run = run if isinstance(run, Run) else load_run(run)
    if missing := [key for key in _NEEDED if key not in run.summary]:
        raise ForkError(f"{run.folder / 'summary.json'}: has no {missing[0]}; name the folder of a mission")
    method = run.summary["method"]
    if run.summary["contacts"] is None:
        raise ForkError(f"{run.folder}: is no simulated run; nobody knows what its world would have done")
    if method == "own":
        raise ForkError(f"{run.folder}: had parts of your own, which no file holds; clone its Context instead")
    if method not in METHODS or not METHODS[method].has_candidates:
        names = ", ".join(name for name, one in METHODS.items() if one.has_candidates)
        raise ForkError(f"{run.folder}: its method {method} chooses from no candidates; fork a run of {names}")
    scenario = LoadScenario(run.folder / "scenario.yaml")
    if own := scenario.explorer.parts.goal_selector:
        raise ForkError(f"{run.folder}: its goal selector is {own}, which is not known to choose from candidates")
    last = len(run.stages)
    if not 1 <= stage <= last:
        raise ForkError(f"stage {stage}: {run.folder} has the stages 1 to {last}")
    # A run ended by its operator or its time limit ends at the same time again.
    limited = run.summary["outcome"] in ("time_limit", "interrupted")
    request = MissionRequest(
        scenario,
        METHODS[method],
        name=f"{run.summary['scenario']}-fork",
        world_name=run.summary["world"],
        max_time=run.summary["sim_time_s"] if limited else MissionRequest.max_time,
    )
    return run, request


def check_same(run: Run, stages: Sequence[dict[str, Any]], stage: int) -> None:
    """Raises ForkError where a mission that was driven anew has not come to a stage as the run did."""
    for before, now in zip(run.stages[:stage], stages, strict=False):
        if before != now:
            version = run.summary["version"]
            raise ForkError(
                f"{run.folder}: its stage {before['stage']} comes out otherwise now: it was made by another version"
                f" ({version}); explore its scenario.yaml anew and fork that"
            )
