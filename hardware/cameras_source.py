"""Tags of several cameras as those of one, message by message: what looks at them takes one at a time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from tfg_drake.hardware.sensor import Source
from tfg_drake.messages import TagDetections


class CamerasSource:
    """A source of what several others say, in order, one message a call. Where they say more than is taken the oldest
    are missed, of each camera alike."""

    def __init__(self, cameras: Sequence[Source]) -> None:
        self._cameras = cameras
        self._waiting: list[TagDetections] = []
        self._given = -math.inf

    def take(self, kind: type[Any], until: float) -> list[Any]:
        """The oldest message stamped `until` (s) or before that was not taken yet, if there is one."""
        arrived = [one for camera in self._cameras for one in camera.take(TagDetections, until)]
        # One that was longer on its way than another camera's next is of no use any more.
        waiting = [one for one in (*self._waiting, *arrived) if one.stamp > self._given]
        waiting.sort(key=lambda one: one.stamp)
        self._waiting = waiting[-len(self._cameras) :]
        if not self._waiting:
            return []
        oldest = self._waiting.pop(0)
        self._given = oldest.stamp
        return [oldest]

    def take_remarks(self) -> list[str]:
        """Lines for the operator since the last call."""
        return [line for camera in self._cameras for line in camera.take_remarks()]

    def close(self) -> None:
        """Lets go of the cameras."""
        for camera in self._cameras:
            camera.close()
