"""Kernels compiled once, whichever arrays they are called with."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar, cast

import numpy as np

_P = ParamSpec("_P")
_R = TypeVar("_R")


def read_only_arguments(kernel: Callable[_P, _R]) -> Callable[_P, _R]:
    """The kernel called with contiguous, read-only views of its arrays, as messages hold them.

    numba compiles a kernel anew for arrays that are writable or lie otherwise in memory.
    """

    @functools.wraps(kernel)
    def call(*arguments: Any) -> Any:
        return cast(Callable[..., Any], kernel)(*map(_read_only, arguments))

    return cast(Callable[_P, _R], call)


def _read_only(argument: Any) -> Any:
    if not isinstance(argument, np.ndarray) or (argument.flags.c_contiguous and not argument.flags.writeable):
        return argument
    view = np.ascontiguousarray(argument).view()
    view.flags.writeable = False
    return view
