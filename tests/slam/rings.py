"""Graphs of a robot that goes round a ring of tags, with correlated errors, and a dense solution of them to compare."""

import numpy as np
import scipy.linalg

from tfg_drake.geometry import se2
from tfg_drake.messages import Observation, replace
from tfg_drake.slam.keyframe_graph import empty_graph, empty_map, extended
from tfg_drake.slam.map_update import finished, updated

# The way from one view to the next, of which odometry alone tells.
ODOMETRY = np.diag([0.05, 0.05, 0.02]) ** 2


def observed(rng, p_ML, X_MA, X_AD, seen, noise=1.0, tag_errors=None):
    """What a turn sees of the landmarks in rows seen (n,): errors that tags and the turn's end share, and those (t, 2)
    of range and bearing that each tag always has."""
    size = 2 * len(seen) + 3
    root = 0.001 * rng.normal(size=(size, size)) + 0.01 * np.eye(size)
    error = noise * root @ rng.normal(size=size)
    p_AL = se2.transform(se2.inverse(X_MA), p_ML[seen])
    ahead = p_AL / np.hypot(*p_AL.T)[:, None]
    on_error = -np.stack([ahead, np.stack([-p_AL[:, 1], p_AL[:, 0]], axis=1)], axis=2)
    if tag_errors is not None:
        p_AL = p_AL - (on_error @ tag_errors[seen][:, :, None])[:, :, 0]
    return Observation(
        ids=seen + 100,
        p_AL=p_AL + error[:-3].reshape(-1, 2),
        X_AD=X_AD + error[-3:],
        covariance=root @ root.T,
        stamps=np.empty(0),
        X_AB=np.empty((0, 3)),
        on_error=on_error,
    )


def way(rng, X_DA, covariance=ODOMETRY, noise=1.0):
    """A piece of way without tags."""
    error = noise * np.linalg.cholesky(covariance) @ rng.normal(size=3)
    nothing = np.empty(0, dtype=np.int64)
    return Observation(nothing, np.empty((0, 2)), X_DA + error, covariance, np.empty(0), np.empty((0, 3)))


def ring(seed, noise=1.0, views=24, radius=12.0, tags=120, reach=5.0, laps=1.0, tag_error=None):
    """Observations in the order of the way, turns and the ways between them; landmarks (n, 2), poses (2k, 3) in M.

    tag_error: (2,) standard deviations of the errors of range and bearing that each tag always has.
    """
    rng = np.random.default_rng(seed)
    angle, r = rng.uniform(0.0, 2.0 * np.pi, tags), radius + rng.uniform(-3.0, 3.0, tags)
    p_WL = r[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    a = 2.0 * np.pi * laps * np.arange(views) / views
    X_WA = np.column_stack([radius * np.cos(a), radius * np.sin(a), se2.wrap_angle(a + 1.0)])
    X_MW = se2.inverse(X_WA[0])
    p_ML, X_MA = se2.transform(X_MW, p_WL), se2.compose(X_MW, X_WA)
    observations, X_MN, X_AD = [], [np.zeros(3)], np.array([0.02, -0.01, 0.1])
    tag_errors = None if tag_error is None else tag_error * rng.normal(size=(tags, 2))
    for k, X in enumerate(X_MA):
        if k > 0:
            observations.append(way(rng, se2.between(X_MN[-1], X), noise=noise))
            X_MN.append(X)
        seen = np.flatnonzero(np.hypot(*(p_ML - X[:2]).T) < reach)
        observations.append(observed(rng, p_ML, X, X_AD, seen, noise, tag_errors))
        X_MN.append(se2.compose(X, X_AD))
    return observations, p_ML, np.array(X_MN)


def with_ways(observations):
    """The turns, each with the way after it, so that they follow each other."""
    joined = []
    for one, after in zip(observations[::2], observations[1::2], strict=False):
        covariance = one.covariance.copy()
        turn = scipy.linalg.block_diag(se2.rotation(float(one.X_AD[2])), 1.0)
        covariance[-3:, -3:] += turn @ after.covariance @ turn.T
        joined.append(replace(one, X_AD=se2.compose(one.X_AD, after.X_AD), covariance=covariance))
    return joined


def built(observations):
    """Graph and map of some observations, updated with one after the other and never solved."""
    graph, estimate = empty_graph(), empty_map()
    for number, observation in enumerate(observations):
        graph, estimate, rejected = updated(graph, estimate, observation, is_view=len(observation.ids) > 0)
        assert len(rejected) == 0
        graph, estimate = finished(graph, estimate, float(number), observation)
    return graph, estimate


def reckoned(observations, graph=None):
    """A graph, by default empty, with some observations, each put where the one before ends."""
    graph = graph or empty_graph()
    for observation in observations:
        X_MD = se2.compose(graph.X_MN[-1], observation.X_AD)
        graph = extended(graph, observation, X_MD, is_view=len(observation.ids) > 0)
    return graph


def dense_solution(graph):
    """X_MN (k + 1, 3), p_ML (n, 2) of the least squared error, the covariance of (p_ML row by row, all poses but the
    origin, the tags' errors if they have any, yaw), and the yaw: Gauss-Newton on the dense system, its Jacobian by
    complex steps."""
    n, k, has_errors = len(graph.ids), len(graph.keyframes), graph.tag_error.any()
    errors = np.zeros(2 * n if has_errors else 0)
    x = np.concatenate([graph.p_ML.ravel(), graph.X_MN[1:].ravel(), errors, graph.yaw[:1]])
    prior, sigma = graph.yaw_prior
    roots = [np.linalg.cholesky(one.information).T for one in graph.keyframes]
    entries = []
    for j, one in enumerate(graph.keyframes):
        own = (2 * np.searchsorted(graph.ids, one.ids)[:, None] + [0, 1]).ravel()
        poses = 2 * n + 3 * j + np.arange(-3 if j else 0, 3)
        of_errors = 2 * n + 3 * k + own if has_errors else own[:0]
        entries.append(np.concatenate([own, poses, of_errors, [len(x) - 1]]))

    def error(j, values):
        one, values, yaw = graph.keyframes[j], values[:-1], values[-1]
        m, change = 2 * len(one.ids), (yaw - one.yaw) * one.on_yaw
        if has_errors:
            values, e = values[: len(values) - m], values[len(values) - m :]
            change = change + one.on_error @ e
        A, D = (values[m : m + 3], values[m + 3 :]) if j else (np.zeros(3), values[m:])
        points = np.vstack([values[:m].reshape(-1, 2), D[:2]]) - A[:2]
        c, s = np.cos(A[2]), np.sin(A[2])
        in_A = points @ np.array([[c, -s], [s, c]])
        turn = D[2] - A[2] - one.X_AD[2] - change[-1]
        turn = turn - 2.0 * np.pi * np.round(turn.real / (2.0 * np.pi))
        seen = np.vstack([one.p_AL, one.X_AD[:2]]).ravel() + change[:-1]
        return roots[j] @ np.concatenate([in_A.ravel() - seen, [turn]])

    for _ in range(30):
        H, g = np.zeros((len(x), len(x))), np.zeros(len(x))
        for j, at in enumerate(entries):
            J = np.array([error(j, x[at] + 1e-30j * row).imag / 1e-30 for row in np.eye(len(at))]).T
            H[np.ix_(at, at)] += J.T @ J
            g[at] += J.T @ error(j, x[at].astype(complex)).real
        H[-1, -1] += sigma**-2
        g[-1] += (x[-1] - prior) / sigma**2
        if has_errors:
            of_errors = np.arange(2 * n + 3 * k, len(x) - 1)
            for one, at in zip(graph.keyframes, entries, strict=True):
                own = at[len(at) - 1 - 2 * len(one.ids) : -1]
                H[np.ix_(own, own)] += one.error_curvature
                g[own] += one.error_slope + one.error_curvature @ x[own]
            H[of_errors, of_errors] += np.tile(graph.tag_error**-2.0, n)
            g[of_errors] += x[of_errors] * np.tile(graph.tag_error**-2.0, n)
        factor = scipy.linalg.cho_factor(H)
        step = scipy.linalg.cho_solve(factor, -g)
        x = x + step
        if np.abs(step).max() < 1e-11:
            break
    covariance = scipy.linalg.cho_solve(factor, np.eye(len(x)))
    X_MN = np.vstack([np.zeros(3), x[2 * n : 2 * n + 3 * k].reshape(k, 3)])
    return X_MN, x[: 2 * n].reshape(n, 2), covariance, float(x[-1])
