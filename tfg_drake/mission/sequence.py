"""The mission's sequence: observe, map, choose, plan, follow, and again, until there is a reason to end.

One pure step function over an immutable status (the paper's Sec. III-B: a goal point at each stage).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from tfg_drake.messages import FollowerStatus, GoalChoice, MissionStatus, Path, PathStatus, replace

# A follower status from within this time after the phase began, s, may be of the phase before.
STATUS_LATENCY = 0.125
# Number of new paths in one stage after which the robot observes where it stands.
MAX_REPLANS = 5
# Number of stages in a row without reaching the goal after which the mission is stuck.
MAX_FAILURES = 6
# Duration of a glance, s, in which a tag is seen in several frames.
GLANCE_TIME = 0.75
# Remaining way at the last glance, m, so that the next goal is known before the robot brakes.
LAST_GLANCE = 1.0
# After MAX_CHANGES changes of the goal on one way by more than OTHER_GOAL, m, the robot drives to the way's end first,
# as two goals could send it back and forth forever.
MAX_CHANGES = 12
OTHER_GOAL = 0.5
# Duration of the base's own reflex, s, before a bumper that still reports contact is a new event.
BUMPER_PATIENCE = 2.0
# A path that takes this many times its time at full speed, plus a minute, is planned again.
PATIENCE = 4.0
# Verdicts of a goal choice: go there, look around here, or end the mission with this outcome.
VERDICTS = ("goal", "look", "complete", "stuck", "budget")
PAUSED = "paused by the operator"
NOT_ENABLED = "the base is not enabled: whoever operates it enables it"


@dataclasses.dataclass(frozen=True)
class MissionInputs:
    """Inputs of the sequencer at one instant.

    time: s. follower, goal, path, path_status: each asks for the newest message. mapped_stage: asks for the number of
    views in the map and in all that is made of it. max_speed: the robot's, m/s. glance_period: s, as
    explorer.glance_period. bumper: the base reports contact. pause, enable, stop: the operator's inputs.

    Asking may have the message computed: a phase asks only for what it is interested in.
    """

    time: float
    follower: Callable[[], FollowerStatus]
    goal: Callable[[], GoalChoice]
    path: Callable[[], Path]
    path_status: Callable[[], PathStatus]
    mapped_stage: Callable[[], int]
    max_speed: float = 0.5
    glance_period: float = 0.0
    bumper: bool = False
    pause: bool = False
    enable: bool = True
    stop: bool = False


def initial_status() -> MissionStatus:
    """The mission begins with a look round."""
    return MissionStatus(phase="observe", stage=0, since=0.0)


def step(status: MissionStatus, inputs: MissionInputs) -> MissionStatus:
    """The status at inputs.time; the same object where nothing changed."""
    if status.phase == "done":
        return status
    if inputs.stop:
        return _end(status, inputs, "interrupted", "told to end")
    held = PAUSED if inputs.pause else "" if inputs.enable else NOT_ENABLED
    if status.phase == "paused":
        if held:
            return status if held == status.reason else replace(status, reason=held)
        # A path may have gone stale while the robot stood (or was kidnapped): plan it anew.
        resume = "plan" if status.resume_phase == "follow" else status.resume_phase
        since = status.since if resume == "observe" else inputs.time
        # The robot no longer drives where the glance was to look: it stands until there is a new path.
        resume = "map" if resume == "glance" else resume
        replans = status.replans + (status.resume_phase == "follow")
        return replace(status, phase=resume, resume_phase="", since=since, replans=replans, moving=False, reason="")
    if held:
        return replace(status, phase="paused", resume_phase=status.phase, reason=held)
    return _PHASES[status.phase](status, inputs)


def _begin(status: MissionStatus, inputs: MissionInputs, phase: str, **changes: int) -> MissionStatus:
    moving = status.moving and phase in ("map", "choose", "plan")
    return replace(status, **{"phase": phase, "since": inputs.time, "moving": moving, **changes})  # type: ignore[arg-type]


def _end(status: MissionStatus, inputs: MissionInputs, outcome: str, reason: str) -> MissionStatus:
    return replace(status, phase="done", since=inputs.time, outcome=outcome, reason=reason)


def _observe(status: MissionStatus, inputs: MissionInputs) -> MissionStatus:
    follower = inputs.follower()
    fresh = follower.stamp > status.since + STATUS_LATENCY
    return _begin(status, inputs, "map", changes=0) if fresh and follower.turn_done else status


def _glance(status: MissionStatus, inputs: MissionInputs) -> MissionStatus:
    if _stalled(status, inputs):
        # Obstacles out of sight from here keep it from moving.
        return _give_up_goal(status, inputs)
    in_the_way = _seen_or_felt(status, inputs)
    if not in_the_way and inputs.time < status.since + GLANCE_TIME:
        return status
    return _begin(status, inputs, "map", moving=not in_the_way)


def _map(status: MissionStatus, inputs: MissionInputs) -> MissionStatus:
    stage = status.stage + 1
    if inputs.mapped_stage() != stage:
        return status
    return _begin(status, inputs, "choose", stage=stage, replans=status.replans if status.moving else 0)


def _choose(status: MissionStatus, inputs: MissionInputs) -> MissionStatus:
    goal = inputs.goal()
    if goal.stage != status.stage:
        return status
    if goal.verdict not in VERDICTS:
        raise ValueError(f"goal of stage {goal.stage}: {goal.verdict!r} is none of the verdicts {', '.join(VERDICTS)}")
    if goal.verdict == "goal" and goal.node < 0:
        raise ValueError(f"goal of stage {goal.stage}: the verdict is 'goal', but there is no node to go to")
    if goal.verdict == "look":
        return _begin(status, inputs, "observe")
    if goal.node >= 0:
        points = inputs.path().points
        other = status.moving and len(points) and np.hypot(*(goal.p_MG - points[-1])) > OTHER_GOAL
        return _begin(status, inputs, "plan", changes=status.changes + bool(other))
    return _end(status, inputs, goal.verdict, goal.reason)


def _plan(status: MissionStatus, inputs: MissionInputs) -> MissionStatus:
    path = inputs.path()
    if inputs.goal().spent:
        return _begin(status, inputs, "map")
    if path.stage != status.stage or path.id <= status.path_id:
        return status
    if len(path.points):
        return _begin(status, inputs, "follow", path_id=path.id)
    return _give_up_goal(replace(status, path_id=path.id), inputs)


def _follow(status: MissionStatus, inputs: MissionInputs) -> MissionStatus:
    follower, goal = inputs.follower(), inputs.goal()
    if follower.path_id == status.path_id and follower.arrived:
        if goal.verdict != "goal":
            return _end(status, inputs, goal.verdict, f"{goal.reason} The robot is where it began.")
        return _begin(status, inputs, "observe", failures=0)
    if inputs.time > goal.latest_arrival:
        return _begin(status, inputs, "observe")
    if goal.spent:
        return _begin(status, inputs, "map", failures=0)
    late = inputs.time - status.since > 60.0 and _overdue(status, inputs)
    if not (late or _held_up(status, inputs)):
        return _begin(status, inputs, "glance", moving=True) if _glance_due(status, inputs) else status
    # Where nothing is in the way, but the base does not move, it has not seen its way, and a look round shows it.
    may_replan = status.replans < MAX_REPLANS if _seen_or_felt(status, inputs) else status.replans == 0
    if may_replan:
        return _begin(status, inputs, "plan", replans=status.replans + 1)
    return _give_up_goal(status, inputs)


def _held_up(status: MissionStatus, inputs: MissionInputs) -> bool:
    """True if something is in the way, or the base does not move for any reason."""
    return _seen_or_felt(status, inputs) or _stalled(status, inputs)


def _stalled(status: MissionStatus, inputs: MissionInputs) -> bool:
    follower = inputs.follower()
    return follower.path_id == status.path_id and follower.stalled


def _seen_or_felt(status: MissionStatus, inputs: MissionInputs) -> bool:
    path_status = inputs.path_status()
    blocked = path_status.path_id == status.path_id and not path_status.free
    return blocked or (inputs.bumper and inputs.time > status.since + BUMPER_PATIENCE)


def _glance_due(status: MissionStatus, inputs: MissionInputs) -> bool:
    follower = inputs.follower()
    # A glance begins the bumper's patience anew: a robot that pushes against something would glance and push for ever.
    if inputs.bumper or status.changes >= MAX_CHANGES:
        return False
    if not inputs.glance_period or follower.path_id != status.path_id:
        return False
    if follower.left > LAST_GLANCE:
        return inputs.time - status.since >= inputs.glance_period
    # Once a way: a path that began nearer than this was planned after that glance.
    return _length(inputs.path()) > LAST_GLANCE


def _length(path: Path) -> float:
    return float(np.hypot(*np.diff(path.points, axis=0).T).sum())


def _overdue(status: MissionStatus, inputs: MissionInputs) -> bool:
    return inputs.time - status.since > 60.0 + PATIENCE * _length(inputs.path()) / inputs.max_speed


def _give_up_goal(status: MissionStatus, inputs: MissionInputs) -> MissionStatus:
    """Look round where the robot stands: the new view shows what is in the way."""
    if status.failures + 1 >= MAX_FAILURES:
        return _end(status, inputs, "stuck", f"{MAX_FAILURES} goals in a row could not be reached.")
    return _begin(status, inputs, "observe", failures=status.failures + 1)


_PHASES = {"observe": _observe, "glance": _glance, "map": _map, "choose": _choose, "plan": _plan, "follow": _follow}
