"""Kernels compiled once, whatever arrays they are called with."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np


def read_only_arguments(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """The kernel called with contiguous, read-only views of its arrays, as messages hold them.

    numba compiles a kernel anew for arrays that are writable or lie otherwise in memory.
    """

    @functools.wraps(kernel)
    def call(*arguments: Any) -> Any:
        return kernel(*[_read_only(one) if isinstance(one, np.ndarray) else one for one in arguments])

    return call


def _read_only(array: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    view = np.ascontiguousarray(array).view()
    view.flags.writeable = False
    return view
