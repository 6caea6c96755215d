"""Graphs of a robot that goes round a ring of tags, with correlated errors, and a dense solution of them to compare."""

import numpy as np
import scipy.linalg

from tfg_drake.geometry import se2
from tfg_drake.slam.keyframe import Keyframe
from tfg_drake.slam.keyframe_graph import empty_graph, empty_map, extended, no_observation
from tfg_drake.slam.map_update import finished, updated
from tfg_drake.slam.shared import DISTANCE_SCALE, METRES, RANGE_SCALE, SHARED, exactly_known

# The way from one view to the next, of which odometry alone tells.
ODOMETRY = np.diag([0.05, 0.05, 0.02]) ** 2
NOTHING = no_observation()


def gaussian(ids, y_AL, y_AD, covariance, by_shared=None, on_error=None):
    """The keyframe y ~ ((y_AL row by row, y_AD) + by_shared s, covariance) given the parameters s, which says nothing
    of s by itself."""
    m = len(covariance)
    by_shared = np.zeros((m, SHARED)) if by_shared is None else by_shared
    J = np.hstack([np.eye(m), -by_shared])
    W = J.T @ np.linalg.solve(covariance, J)
    on_error = np.zeros((len(ids), 2, 2)) if on_error is None else on_error
    unit = RANGE_SCALE if len(ids) else DISTANCE_SCALE
    none = np.zeros((len(ids), 2))
    return Keyframe(ids, y_AL, none, none, y_AD, unit, 0.5 * (W + W.T), np.zeros(SHARED), on_error, none)


def observed(rng, p_ML, X_MA, X_AD, seen, noise=1.0, tag_errors=None, shared=None):
    """What a turn sees of the landmarks in rows seen (n,): errors that tags and the turn's end share, and those (t, 2)
    of range and bearing that each tag always has. shared: (13,) the true parameters; without them it tells nothing of
    any."""
    size = 2 * len(seen) + 3
    root = 0.001 * rng.normal(size=(size, size)) + 0.01 * np.eye(size)
    error = noise * root @ rng.normal(size=size)
    p_AL = se2.transform(se2.inverse(X_MA), p_ML[seen])
    ahead = p_AL / np.hypot(*p_AL.T)[:, None]
    on_error = np.stack([ahead, np.stack([-p_AL[:, 1], p_AL[:, 0]], axis=1)], axis=2)
    if tag_errors is not None:
        p_AL = p_AL + (on_error @ tag_errors[seen][:, :, None])[:, :, 0]
    return _with_errors(rng, seen + 100, p_AL, X_AD, root @ root.T, error, on_error, shared)


def way(rng, X_DA, covariance=ODOMETRY, noise=1.0, shared=None):
    """A piece of way without tags."""
    error = noise * np.linalg.cholesky(covariance) @ rng.normal(size=3)
    nothing = np.empty(0, dtype=np.int64)
    return _with_errors(rng, nothing, np.empty((0, 2)), X_DA, covariance, error, None, shared)


def _with_errors(rng, ids, p_AL, X_AD, covariance, error, on_error, shared):
    y, by_shared = np.append(p_AL.ravel(), X_AD), None
    if shared is not None:
        by_shared = rng.normal(size=(len(y), SHARED))
        y[:-1] *= 1.0 + shared[RANGE_SCALE if len(ids) else DISTANCE_SCALE]
        y -= by_shared @ shared
    y += error
    return gaussian(ids, y[:-3].reshape(-1, 2), y[-3:], covariance, by_shared, on_error)


def ring(seed, noise=1.0, views=24, radius=12.0, tags=120, reach=5.0, laps=1.0, tag_error=None, shared=None):
    """Keyframes in the order of the way, turns and the ways between them; landmarks (n, 2), poses (2k, 3) in M.

    tag_error: (2,) standard deviations of the errors of range and bearing that each tag always has. shared: (13,) the
    true parameters, where keyframes depend on them.
    """
    rng = np.random.default_rng(seed)
    angle, r = rng.uniform(0.0, 2.0 * np.pi, tags), radius + rng.uniform(-3.0, 3.0, tags)
    p_WL = r[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    a = 2.0 * np.pi * laps * np.arange(views) / views
    X_WA = np.column_stack([radius * np.cos(a), radius * np.sin(a), se2.wrap_angle(a + 1.0)])
    X_MW = se2.inverse(X_WA[0])
    p_ML, X_MA = se2.transform(X_MW, p_WL), se2.compose(X_MW, X_WA)
    keyframes, X_MN, X_AD = [], [np.zeros(3)], np.array([0.02, -0.01, 0.1])
    tag_errors = None if tag_error is None else tag_error * rng.normal(size=(tags, 2))
    for k, X in enumerate(X_MA):
        if k > 0:
            keyframes.append(way(rng, se2.between(X_MN[-1], X), noise=noise, shared=shared))
            X_MN.append(X)
        seen = np.flatnonzero(np.hypot(*(p_ML - X[:2]).T) < reach)
        keyframes.append(observed(rng, p_ML, X, X_AD, seen, noise, tag_errors, shared))
        X_MN.append(se2.compose(X, X_AD))
    return keyframes, p_ML, np.array(X_MN)


def with_ways(keyframes):
    """The turns, each with the way after it, so that they follow each other; of those that tell of no parameter."""
    joined = []
    for one, after in zip(keyframes[::2], keyframes[1::2], strict=False):
        covariance = one.conditional()[0]
        turn = scipy.linalg.block_diag(se2.rotation(float(one.y_AD[2])), 1.0)
        covariance[-3:, -3:] += turn @ after.conditional()[0] @ turn.T
        X_AD = se2.compose(one.y_AD, after.y_AD)
        joined.append(gaussian(one.ids, one.y_AL, X_AD, covariance, on_error=one.on_error))
    return joined


def built(keyframes, prior=None):
    """Graph and map of some keyframes, updated with one after the other and never solved."""
    graph, estimate = empty_graph(prior or exactly_known()), empty_map(prior or exactly_known())
    for number, one in enumerate(keyframes):
        graph, estimate, rejected = updated(graph, estimate, one, is_view=len(one.ids) > 0)
        assert len(rejected) == 0
        graph, estimate = finished(graph, estimate, float(number), NOTHING)
    return graph, estimate


def reckoned(keyframes, prior=None):
    """A graph with some keyframes, each put where the one before ends."""
    graph = empty_graph(prior or exactly_known())
    for one in keyframes:
        X_MD = se2.compose(graph.X_MN[-1], one.given(graph.shared.mean)[1])
        graph = extended(graph, one, X_MD, is_view=len(one.ids) > 0)
    return graph


def dense_solution(graph):
    """X_MN (k + 1, 3), p_ML (n, 2), shared (13,) of the least cost, and the covariance of (p_ML row by row, all poses
    but the origin, the tags' errors if they have any, shared): Gauss-Newton on the dense system, its Jacobian by
    complex steps."""
    n, k, has_errors = len(graph.ids), len(graph.keyframes), graph.tag_error.any()
    errors = np.zeros(2 * n if has_errors else 0)
    x = np.concatenate([graph.p_ML.ravel(), graph.X_MN[1:].ravel(), errors, graph.shared.mean])
    of_shared = len(x) - SHARED + np.arange(SHARED)
    of_errors = np.arange(2 * n + 3 * k, len(x) - SHARED)
    prior, roots, entries = np.linalg.inv(graph.prior.covariance), [], []
    for j, one in enumerate(graph.keyframes):
        whole = one.with_errors() if has_errors else one.without_errors
        value, direction = np.linalg.eigh(whole)
        roots.append(np.sqrt(np.maximum(value, 0.0))[:, None] * direction.T)
        own = (2 * np.searchsorted(graph.ids, one.ids)[:, None] + [0, 1]).ravel()
        poses = 2 * n + 3 * j + np.arange(-3 if j else 0, 3)
        entries.append(np.concatenate([own, poses, of_errors[own] if has_errors else own[:0], of_shared]))

    def error(j, values):
        one, values, shared = graph.keyframes[j], values[:-SHARED], values[-SHARED:]
        m, e = 2 * len(one.ids), values[:0]
        if has_errors:
            values, e = values[: len(values) - m], values[len(values) - m :]
        A, D = (values[m : m + 3], values[m + 3 :]) if j else (np.zeros(3), values[m:])
        points = np.vstack([values[:m].reshape(-1, 2), D[:2]]) - A[:2]
        c, s = np.cos(A[2]), np.sin(A[2])
        scale = 1.0 if one.unit == METRES else 1.0 + shared[one.unit]
        in_A = scale * (points @ np.array([[c, -s], [s, c]]))
        turn = D[2] - A[2] - one.y_AD[2]
        turn = turn - 2.0 * np.pi * np.round(turn.real / (2.0 * np.pi))
        off, w = in_A - np.vstack([one.y_AL, one.y_AD[:2]]), one.walls
        if w:
            anchor = graph.anchor[np.searchsorted(graph.ids, one.ids[:w])]
            angle, distance = values[: 2 * w].reshape(-1, 2).T
            apart = A[:2] + one.anchor[:w] @ np.array([[c, s], [-s, c]]) - anchor
            off[:w, 0] = angle - A[2] - one.y_AL[:w, 0]
            off[:w, 0] -= 2.0 * np.pi * np.round(off[:w, 0].real / (2.0 * np.pi))
            off[:w, 1] = distance - np.cos(angle) * apart[:, 0] - np.sin(angle) * apart[:, 1] - one.y_AL[:w, 1]
        return roots[j] @ np.concatenate([off.ravel(), [turn], shared, e])

    for _ in range(30):
        H, g = np.zeros((len(x), len(x))), np.zeros(len(x))
        for j, at in enumerate(entries):
            J = np.array([error(j, x[at] + 1e-30j * row).imag / 1e-30 for row in np.eye(len(at))]).T
            H[np.ix_(at, at)] += J.T @ J
            g[at] += J.T @ error(j, x[at].astype(complex)).real
            g[of_shared] += graph.keyframes[j].vector
            if has_errors and len(graph.keyframes[j].ids):
                own = 2 * len(graph.keyframes[j].ids)
                g[at[-SHARED - own : -SHARED]] += graph.keyframes[j].pull.ravel()
        H[np.ix_(of_shared, of_shared)] += prior
        g[of_shared] += prior @ (x[of_shared] - graph.prior.mean)
        if has_errors:
            information = np.tile(graph.tag_error**-2.0, n)
            H[of_errors, of_errors] += information
            g[of_errors] += x[of_errors] * information
        factor = scipy.linalg.cho_factor(H)
        step = scipy.linalg.cho_solve(factor, -g)
        x = x + step
        if np.abs(step).max() < 1e-11:
            break
    covariance = scipy.linalg.cho_solve(factor, np.eye(len(x)))
    X_MN = np.vstack([np.zeros(3), x[2 * n : 2 * n + 3 * k].reshape(k, 3)])
    return X_MN, x[: 2 * n].reshape(n, 2), x[of_shared], covariance
