"""The page of a mission, served while it goes on."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

from tfg_drake import kernels
from tfg_drake.bad_input import BadInput
from tfg_drake.cockpit.page import RECORDED, viewer_script
from tfg_drake.cockpit.server import Cockpit
from tfg_drake.diagrams.screen import say

MOST_PORT = 65535


@contextlib.contextmanager
def open_page(title: str, host: str, port: int | None, *, preview: bool = False, **given: Any) -> Iterator[Cockpit]:
    """The page of a mission, its address printed; see `Cockpit`, for what is given, too. preview: while kernels are
    compiled it plays a recorded mission.

    Raises BadInput where it cannot be served.
    """
    if port is not None and not 1 <= port <= MOST_PORT:
        raise BadInput(f"port {port}: must be between 1 and {MOST_PORT}")
    recorded = RECORDED if preview and not kernels.are_compiled() else None
    try:
        cockpit = Cockpit(viewer_script(), title, host=host, port=port, recorded=recorded, **given)
    except OSError as error:
        where = host if port is None else f"{host}, port {port}"
        raise BadInput(
            f"{where}: the page cannot be served there: {(error.strerror or str(error)).lower()}; name another"
        ) from None
    say(f"page: {cockpit.address}")
    with cockpit:
        yield cockpit
