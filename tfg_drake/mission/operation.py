"""Operator's requests to a robot: nothing moves before it is enabled, and a stop holds until it is enabled anew."""

from __future__ import annotations

import enum
from typing import Literal

from tfg_drake.messages import Hazards, SaidPose, message, replace

# What base and mission are told. enable: let the base move, also after a stop. stop: the emergency stop. pause: pause
# the mission, or resume it. hold: pause it. resume: go on with it. recall: explore no more, and come home where the
# mission is to end there. end: end the mission.
Command = Literal["enable", "stop", "pause", "hold", "resume", "recall", "end"]
# What an operator may ask for. push: push the robot, a simulated one. (x, y): drive to that place, m in M. SaidPose: it
# is said to be there in its map.
Request = Command | Literal["push"] | tuple[float, float] | SaidPose


@message
class Operation:
    """The operator's requests.

    enabling: 0: the base must stand; n > 0: it may move, by the n-th time it was enabled: a base that stops by itself
    does not count that one any more. enablings: times so far. paused, recalled, ended: the mission's.
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
    """Why a base must stand until it is enabled anew, also when the hazard is over: whoever puts it down again must not
    be surprised by it (ISO 13482, unexpected start-up). None where it may move."""
    if hazards.wheel_drop:
        return "a wheel hangs: put the robot on its wheels, then enable it"
    return "a cliff: carry the robot away from it, then enable it" if hazards.cliff else None


def requested(operation: Operation, request: Command) -> Operation:
    """Applies a request. An end stops the base too; nothing undoes it, nor a recall."""
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
