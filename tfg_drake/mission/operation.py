"""An operator's requests: the base moves only once it is enabled, and a stop holds until it is enabled again."""

from __future__ import annotations

import enum
from typing import Literal

from tfg_drake.messages import Hazards, SaidPose, message, replace

# Commands to base and mission. enable: let the base move, also after a stop. stop: the emergency stop. pause: pause the
# mission, or resume it if it is paused. hold: pause it. resume: resume it. recall: end the exploration, and return home
# if explorer.return_home. end: end the mission.
Command = Literal["enable", "stop", "pause", "hold", "resume", "recall", "end"]
# Requests of an operator. push: push the simulated robot. (x, y): drive to that place, m in M. SaidPose: its pose in
# the map, as stated by a person.
Request = Command | Literal["push"] | tuple[float, float] | SaidPose


@message
class Operation:
    """The operator's requests.

    enabling: 0 if the base must stand, n > 0 if it may move since it was enabled for the n-th time; a base that has
    stopped by itself ignores that number from then on. enablings: number of times it was enabled. paused, recalled,
    ended: the mission's state.
    """

    enabling: int = 0
    enablings: int = 0
    paused: bool = False
    recalled: bool = False
    ended: bool = False


class Side(enum.IntFlag):
    """Bits of Hazards."""

    RIGHT = 1
    CENTRE = 2
    LEFT = 4


def stopped_by(hazards: Hazards) -> str | None:
    """Return why a base must stand until it is enabled again, None if it may move. It stands even when the hazard is
    over, so as not to surprise the person who puts it down (ISO 13482, unexpected start-up)."""
    if hazards.wheel_drop:
        return "a wheel hangs: put the robot on its wheels, then enable it"
    return "a cliff: carry the robot away from it, then enable it" if hazards.cliff else None


def requested(operation: Operation, request: Command) -> Operation:
    """Return the requests with one more. An end also stops the base; neither an end nor a recall can be undone."""
    if operation.ended:
        return operation
    if request == "enable":
        again = operation.enablings + 1
        return replace(operation, enabling=again, enablings=again)
    if request == "stop":
        return replace(operation, enabling=0)
    if request == "pause":
        return replace(operation, paused=not operation.paused)
    if request in ("hold", "resume"):
        return replace(operation, paused=request == "hold")
    if request == "recall":
        return replace(operation, recalled=True)
    return replace(operation, enabling=0, ended=True)
