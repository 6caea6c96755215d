"""Where the CPU time of a run goes: a process-wide account, charged by the components themselves.

    with metered("estimator"):
        ...

A block inside another is charged to the inner name only, so that the accounts add up: Drake evaluates an output port
when somebody asks for it, often in the middle of another component's event.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

_totals: dict[str, float] = {}
_open: list[str] = []
_since = 0.0
_details = False


class metered:
    """Charge this thread's CPU time to `name`, less what blocks within it charge elsewhere; also a decorator."""

    def __init__(self, name: str) -> None:
        """name: of the account."""
        self._name = name

    def __enter__(self) -> None:
        """Open the block."""
        _charge()
        _open.append(self._name)

    def __exit__(self, *_: object) -> None:
        """Close the block."""
        _charge()
        _open.pop()

    def __call__(self, function: Callable[P, R]) -> Callable[P, R]:
        """The function, each of its calls a block."""

        @functools.wraps(function)
        def inner(*args: P.args, **kwargs: P.kwargs) -> R:
            _charge()
            _open.append(self._name)
            try:
                return function(*args, **kwargs)
            finally:
                _charge()
                _open.pop()

        return inner


class metered_in_detail(metered):
    """As `metered`, for frequent and cheap functions: they are charged only after `charge_details()`.

    Reading the clock takes longer than some of them do, and elsewhere they are simply the rest.
    """

    def __call__(self, function: Callable[P, R]) -> Callable[P, R]:
        """The function, each of its calls a block where details are charged."""
        charged = super().__call__(function)

        @functools.wraps(function)
        def inner(*args: P.args, **kwargs: P.kwargs) -> R:
            return charged(*args, **kwargs) if _details else function(*args, **kwargs)

        return inner


def charge_details() -> None:
    """From now on `metered_in_detail` charges too."""
    global _details
    _details = True


def cpu_totals() -> dict[str, float]:
    """CPU seconds charged so far in this process, by name, closed and open blocks alike."""
    _charge()
    return dict(_totals)


def _charge() -> None:
    """Charge the time since the last call to the innermost open block."""
    global _since
    now = time.thread_time()
    if _open:
        _totals[_open[-1]] = _totals.get(_open[-1], 0.0) + now - _since
    _since = now
