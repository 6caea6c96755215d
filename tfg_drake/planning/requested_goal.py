"""Requested goals: the operator sends the robot to a place; it drives there, looks around, and continues exploring."""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Sequence

import numpy as np

from tfg_drake.messages import FloatArray, GoalChoice, MissionStatus, Roadmap, message, replace
from tfg_drake.planning.budget import THERE

# The request is dropped after this many failed attempts in a row.
MOST_FAILURES = 3
REASON = "Somebody has sent the robot there."

_log = logging.getLogger("tfg_drake.operator")


@message
class RequestedGoal:
    """The last requested place. count: number of requests so far; p_MG: (2,) m in M."""

    count: int = 0
    p_MG: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(2))


def goal_asked_for(before: RequestedGoal, places: Sequence[tuple[float, float]], time: float) -> RequestedGoal:
    """Return the request after further places (x, y), m in M, at a time, s; the last place counts."""
    x, y = places[-1]
    _log.info("%.2f s: sent to (%.2f, %.2f) in M", time, x, y)
    return RequestedGoal(before.count + len(places), np.array([x, y]))


@message
class Sent:
    """The requested goal in progress. count: of the request; node: its id in the roadmap, -1 without a request or after
    the robot has been there."""

    count: int = 0
    node: int = -1


def where_sent(
    before: Sent, requested: RequestedGoal, roadmap: Roadmap, mission: MissionStatus, p_MA: FloatArray
) -> Sent:
    """Return the requested goal; called whenever the robot chooses a goal.

    A new request selects the reachable node nearest to its place, however far that is. It holds until the robot has
    looked around there, can no longer reach it, or has failed MOST_FAILURES times.

    Args:
        before: the result of the previous call.
        requested: the newest request.
        roadmap: with its reachable nodes.
        mission: its status.
        p_MA: (2,) m in M, place of the newest view.
    """
    if requested.count != before.count:
        reachable = np.flatnonzero(roadmap.reachable)
        if not len(reachable):
            return Sent(requested.count)
        next_to_it = np.hypot(*(roadmap.points[reachable] - requested.p_MG).T).argmin()
        return Sent(requested.count, int(roadmap.node_ids(reachable[[next_to_it]])[0]))
    if before.node < 0:
        return before
    row = int(roadmap.nodes(np.array([before.node]))[0])
    over = row < 0 or not roadmap.reachable[row] or mission.failures >= MOST_FAILURES
    if over or (not mission.moving and np.hypot(*(roadmap.points[row] - p_MA)) < THERE):
        return Sent(before.count)
    return before


def goal_there(choice: GoalChoice, node: int, roadmap: Roadmap, reason: str = REASON) -> GoalChoice:
    """Return a stage's choice with another goal: a node of the roadmap, by id, where the robot looks all around."""
    return replace(
        choice,
        node=node,
        p_MG=roadmap.points[int(roadmap.nodes(np.array([node]))[0])],
        verdict="goal",
        reason=reason,
        spent=False,
        look=np.zeros(0),
        tour=np.zeros(0, dtype=np.int64),
    )
