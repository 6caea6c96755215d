"""The operator's buttons in Meshcat."""

from __future__ import annotations

from pydrake.geometry import Meshcat

from tfg_drake.operation import Request

# Name, the request and the key that does the same.
_BUTTONS: tuple[tuple[str, Request, str], ...] = (
    ("STOP", "stop", "Space"),
    ("Enable", "enable", "KeyE"),
    ("Pause / resume", "pause", "KeyP"),
    ("End", "end", ""),
)


class MeshcatButtons:
    """Buttons for what an operator may ask for; used by the thread that made the meshcat."""

    def __init__(self, meshcat: Meshcat) -> None:
        self._meshcat = meshcat
        self._clicks = dict.fromkeys((name for name, _, _ in _BUTTONS), 0)
        for name, _, key in _BUTTONS:
            meshcat.AddButton(name, key)

    def requests(self) -> list[Request]:
        """What was asked for since the last call."""
        requests: list[Request] = []
        for name, request, _ in _BUTTONS:
            clicks = self._meshcat.GetButtonClicks(name)
            requests += [request] * (clicks - self._clicks[name])
            self._clicks[name] = clicks
        return requests
