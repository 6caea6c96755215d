"""The keyframe graph's factors in flat arrays, as the kernels take them, and values of its unknowns."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from tfg_drake.messages import FloatArray, IntArray
from tfg_drake.slam.keyframe_graph import KeyframeGraph, rows_of
from tfg_drake.slam.keyframe_kernels import Keyframes, OnErrors, batch_error


@dataclasses.dataclass(frozen=True)
class Factors:
    """All keyframes in flat arrays, as the kernels take them, and what they say of the tags' errors. tag_error: (2,)
    standard deviation of these."""

    keyframes: Keyframes
    on_errors: OnErrors
    tag_error: FloatArray


@dataclasses.dataclass(frozen=True)
class Values:
    """X_MN: (k + 1, 3), p_ML: (n, 2), errors: (n, 2) of the tags' range and bearing, m and rad."""

    X_MN: FloatArray
    p_ML: FloatArray
    errors: FloatArray


class Solved(NamedTuple):
    """The step (u,) of Gauss and Newton, the joint covariance (c, c) of unknowns (c,), those that are kept of a small
    system, and log det of the information on all."""

    step: FloatArray
    covariance: Callable[[IntArray], FloatArray]
    log_determinant: float


@dataclasses.dataclass(frozen=True)
class Linear:
    """A linear system at some values, with its gradient (u,), the weighted squared error there, and the blocks of the
    poses (k, 6, 6). solved: the system with a gradient. log_determinant_of_rest: of the information on all unknowns but
    the landmarks, given these."""

    solved: Callable[[FloatArray], Solved]
    gradient: FloatArray
    error: float
    poses: FloatArray
    log_determinant_of_rest: Callable[[], float]


def factors_of(graph: KeyframeGraph) -> Factors:
    """The factors of a graph of one keyframe or more."""
    counts = np.array([len(one.ids) for one in graph.keyframes])
    ids = np.concatenate([one.ids for one in graph.keyframes])
    keyframes = Keyframes(
        offsets=np.append(0, np.cumsum(counts)),
        rows=rows_of(ids, graph.ids)[0],
        p_AL=np.concatenate([one.p_AL for one in graph.keyframes]),
        X_AD=np.array([one.X_AD for one in graph.keyframes]),
        starts=np.append(0, np.cumsum((2 * counts + 3) ** 2)),
        information=np.concatenate([one.information.ravel() for one in graph.keyframes]),
    )
    return Factors(
        keyframes=keyframes,
        on_errors=OnErrors(
            on_error=np.concatenate([one.on_error.ravel() for one in graph.keyframes]),
            curvature=np.concatenate([one.error_curvature.ravel() for one in graph.keyframes]),
            slope=np.concatenate([one.error_slope for one in graph.keyframes]),
        ),
        tag_error=graph.tag_error,
    )


def at_other_yaw(graph: KeyframeGraph, factors: Factors, change: float) -> Factors:
    """The factors with the camera's yaw changed, rad."""
    of_tags = np.concatenate([one.on_yaw[:-3].reshape(-1, 2) for one in graph.keyframes])
    of_way = np.array([one.on_yaw[-3:] for one in graph.keyframes])
    seen = factors.keyframes
    at_yaw = seen._replace(p_AL=seen.p_AL + change * of_tags, X_AD=seen.X_AD + change * of_way)
    return dataclasses.replace(factors, keyframes=at_yaw)


def at_errors(factors: Factors, errors: FloatArray) -> Factors:
    """The factors with the tags' errors (n, 2) taken out of what was seen."""
    if not factors.tag_error.any():
        return factors
    p_AL, X_AD, begin = factors.keyframes.p_AL.copy(), factors.keyframes.X_AD.copy(), 0
    for j in range(len(X_AD)):
        some = slice(factors.keyframes.offsets[j], factors.keyframes.offsets[j + 1])
        each = errors[factors.keyframes.rows[some]].ravel()
        end = begin + (len(each) + 3) * len(each)
        change = factors.on_errors.on_error[begin:end].reshape(len(each) + 3, len(each)) @ each
        p_AL[some] += change[:-3].reshape(-1, 2)
        X_AD[j] += change[-3:]
        begin = end
    return dataclasses.replace(factors, keyframes=factors.keyframes._replace(p_AL=p_AL, X_AD=X_AD))


def squared_error(factors: Factors, values: Values) -> float:
    """The weighted squared error."""
    error = batch_error(at_errors(factors, values.errors).keyframes, values.X_MN, values.p_ML)
    return error + error_of_errors(factors, values.errors)


def error_of_errors(factors: Factors, errors: FloatArray) -> float:
    """What the tags' errors (n, 2) cost by themselves."""
    if not factors.tag_error.any():
        return 0.0
    each, begin = errors[factors.keyframes.rows].ravel(), 0
    total = float(np.sum((errors / factors.tag_error) ** 2)) + 2.0 * float(factors.on_errors.slope @ each)
    for some in np.split(each, 2 * factors.keyframes.offsets[1:-1]):
        curvature = factors.on_errors.curvature[begin : begin + len(some) ** 2].reshape(len(some), len(some))
        total, begin = total + float(some @ curvature @ some), begin + len(some) ** 2
    return total
