"""The operator's buttons in Meshcat.

Drake's Meshcat asks nobody who presses them: any web page that the operator has open may. So none of them can start
the wheels. Enabling and resuming are on the terminal, and on the robot itself.
"""

from __future__ import annotations

from pydrake.geometry import Meshcat

from tfg_drake.mission.operation import Request
from tfg_drake.systems.picture import Picture, picture_of

# Name, the request and the key that does the same.
BUTTONS: tuple[tuple[str, Request, str], ...] = (
    ("STOP", "stop", "Space"),
    ("Pause", "hold", "KeyP"),
    ("End", "end", ""),
)


class MeshcatButtons:
    """Buttons for what an operator may ask for; used by the thread that made the picture."""

    def __init__(self, meshcat: Meshcat | Picture) -> None:
        """meshcat: where they are, also where it is lost and comes back."""
        self._picture = picture_of(meshcat)
        self._picture.advice = ", STOP is on the terminal (space)"
        self._opened = 0  # which Meshcat has them
        self._clicks: dict[str, int] = {}
        self._picture.attempt(self._read, list[Request]())

    def requests(self) -> list[Request]:
        """What was asked for since the last call; nothing while the picture is lost."""
        return self._picture.attempt(self._read, list[Request]())

    def _read(self) -> list[Request]:
        meshcat = self._picture.meshcat
        if self._opened != self._picture.opened:
            for name, _, key in BUTTONS:
                meshcat.AddButton(name, key)
                self._clicks[name] = 0
            self._opened = self._picture.opened
        requests: list[Request] = []
        for name, request, _ in BUTTONS:
            clicks = meshcat.GetButtonClicks(name)
            requests += [request] * (clicks - self._clicks[name])
            self._clicks[name] = clicks
        return requests
