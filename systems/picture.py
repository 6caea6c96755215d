"""The picture in Meshcat as what it is to a mission: something that may fail, and be opened again."""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable
from typing import TypeVar

import pydrake.common
from pydrake.geometry import Meshcat, MeshcatParams

T = TypeVar("T")

# A lost picture is opened again after so long, s of wall time: a page that ends it again and again costs no more than a
# drawing of the whole scene then.
PAUSE = 2.0

_log = logging.getLogger("tfg_drake.picture")


def _keep_log_from_python() -> None:
    """Drake's server logs when it ends. By way of Python it would wait for Python's lock, which its destructor holds
    while it waits for the server. Level ERROR: not its address, nor that a picture was replaced before it was asked
    for."""
    logging.getLogger("drake").setLevel(logging.ERROR)
    with contextlib.suppress(RuntimeError):  # Somebody has set up Drake's log already.
        pydrake.common.use_native_cpp_logging()


def open_meshcat(port: int | None = None) -> Meshcat:
    """A Meshcat for this machine only, at a port or the first that is free. Raises RuntimeError where it is not."""
    _keep_log_from_python()
    return Meshcat(MeshcatParams(host="localhost", port=port, show_stats_plot=False))


class Picture:
    """A Meshcat that may be lost: one malformed message from anywhere ends Drake's server, and all that is called then
    raises.

    Whoever draws in it does so within `attempt`. It is for the thread that made it.
    """

    def __init__(self, meshcat: Meshcat) -> None:
        """meshcat: the first; those after it are at its port, for this machine only."""
        _keep_log_from_python()
        self._meshcat: Meshcat | None = meshcat
        self._port = meshcat.port()
        self._again = 0.0  # when to open it again where it is lost, s of time.monotonic()
        self.opened = 1

    @property
    def meshcat(self) -> Meshcat:
        """The Meshcat there is now, the `opened`-th. Raises RuntimeError where there is none; not within `attempt`."""
        if self._meshcat is None:
            raise RuntimeError("the picture is lost")
        return self._meshcat

    def attempt(self, use: Callable[[], T], otherwise: T) -> T:
        """What `use` returns; `otherwise` where there is no Meshcat, or where `use` raises: then it is lost, which is
        told in the log, and another one is opened at a later call."""
        try:
            if self._meshcat is None:
                if time.monotonic() < self._again:
                    return otherwise
                self._meshcat = open_meshcat(self._port)
                self.opened += 1
                _log.warning("the picture is back at %s", self._meshcat.web_url())
            return use()
        except (Exception, SystemExit) as error:  # Drake's failed assertions come as SystemExit.
            self._lose(error)
            return otherwise

    def _lose(self, error: BaseException) -> None:
        if self._meshcat is not None:
            reason = " ".join(str(error).split()) or type(error).__name__
            _log.warning("the picture is lost: %s; the mission goes on", reason)
        self._meshcat = None
        self._again = time.monotonic() + PAUSE


def picture_of(meshcat: Meshcat | Picture) -> Picture:
    """The picture that a Meshcat is, or is in already."""
    return meshcat if isinstance(meshcat, Picture) else Picture(meshcat)
