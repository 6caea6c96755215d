"""Where the CPU time of a run goes: a process-wide account, charged by the components themselves.

    with metered("estimator"):
        ...

A block inside another is charged to the inner name only, so that the accounts add up: Drake evaluates an output port
when somebody asks for it, often in the middle of another component's event.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager

_totals: dict[str, float] = {}
_open: list[str] = []
_since = 0.0


@contextmanager
def metered(name: str) -> Iterator[None]:
    """Charge this thread's CPU time inside the block to `name`, less what blocks within it charge elsewhere."""
    _charge()
    _open.append(name)
    try:
        yield
    finally:
        _charge()
        _open.pop()


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
