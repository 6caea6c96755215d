"""Stops the estimator as soon as its estimate is no longer finite."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numpy as np

from tfg_drake.bad_input import EstimateLost
from tfg_drake.messages import FloatArray
from tfg_drake.slam.estimator_state import EstimatorState

Step = TypeVar("Step", bound=Callable[..., EstimatorState])


def kept_finite(step: Step) -> Step:
    """Wrap a step of the estimator so that it raises EstimateLost if its result is missing or not finite."""

    @functools.wraps(step)
    def checked(state: EstimatorState, /, *args: Any, **kwargs: Any) -> EstimatorState:
        try:
            after = step(state, *args, **kwargs)
        except np.linalg.LinAlgError as error:
            raise EstimateLost(_line(state, str(error))) from error
        if after.localizer is not state.localizer:
            _check(after, "pose", after.localizer.mean, after.localizer.covariance)
        if after.map is not None and after.map is not state.map:
            _check(after, "map", after.map.p_ML, after.map.X_MD, after.map.covariance, after.map.shared)
        return after

    return cast(Step, checked)


def _check(state: EstimatorState, what: str, *values: FloatArray) -> None:
    if not all(np.isfinite(value).all() for value in values):
        raise EstimateLost(_line(state, f"its {what} is not"))


def _line(state: EstimatorState, why: str) -> str:
    stage = 0 if state.map is None else state.map.stage
    return (
        f"the estimate is no longer finite at {state.stamp:.2f} s ({why}); the map is kept as it was at stage {stage}; "
        "look at odometry and scans about then"
    )
