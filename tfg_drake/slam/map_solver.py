"""Values and joint covariance of the whole keyframe graph: maximum a posteriori (the paper's sec. III), to rounding.

All keyframes are linearised in one compiled call. What is to be known jointly, the landmarks nearest to a place and one
pose, is kept; GTSAM eliminates everything else from the sparse rest of the system, and what is left is dense: its
solution gives the rest by back-substitution, its inverse is the joint covariance.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable

import gtsam
import numpy as np
import scipy.linalg

from tfg_drake.messages import FloatArray, IntArray, MapEstimate, Observation, replace
from tfg_drake.slam.keyframe_graph import KeyframeGraph, at_yaw, rows_of
from tfg_drake.slam.keyframe_kernels import YAW_STEP, assemble, assemble_tag_errors, batch_error, chain, tag_pulls
from tfg_drake.slam.tag_error import learnt, suspected

# Landmarks known jointly: those nearest to the robot.
JOINT = 400
# At the end of a mission those of the whole map are, if they are no more than this: their covariance has 200 MB then.
MOST_JOINT = 2500
# Steps of one solve, at most, and the largest component (m, rad) of a step after which no other is needed.
MOST_STEPS = 20
SMALL_STEP = 2e-5
# A step that fails to lower the error is halved, so many times at most.
MOST_HALVINGS = 10
# Where no step can be made, every unknown is held to its place by this information, and a hundred times as much each
# time. The first holds what hangs on nothing by 100 m, or rad.
LEAST_DAMPING = 1e-4
DAMPING_GROWTH = 100.0
MOST_DAMPING = 1e10
# Unknowns of a cell: what GTSAM handles as one variable.
CELL = 48


@dataclasses.dataclass(frozen=True)
class _Factors:
    """All keyframes in flat arrays, see `keyframe_kernels.assemble`. on_error: (2n + 3, 2n) of each,
    curvature, slope: what all say of the errors by themselves, see `keyframe_kernels.assemble_tag_errors`. tag_error:
    (2,) standard deviation of the errors."""

    offsets: IntArray
    rows: IntArray
    p_AL: FloatArray
    X_AD: FloatArray
    starts: IntArray
    information: FloatArray
    on_error: tuple[FloatArray, ...]
    curvature: FloatArray
    slope: FloatArray
    tag_error: FloatArray

    @property
    def arrays(self) -> tuple[IntArray, IntArray, FloatArray, FloatArray, IntArray, FloatArray]:
        """In the order in which the kernels take them."""
        return self.offsets, self.rows, self.p_AL, self.X_AD, self.starts, self.information

    @property
    def of_errors(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What the kernels take besides for the tags' errors."""
        return np.concatenate([one.ravel() for one in self.on_error]), self.curvature, self.slope


@dataclasses.dataclass(frozen=True)
class _Cells:
    """Where the unknowns are: landmarks and nodes near each other make a cell; the first `kept` cells are kept.

    Arrays as in `keyframe_kernels.assemble`, error_at as in `assemble_tag_errors`, -1 where tags have none. pairs: (p,
    2) cells that share a keyframe, bounds: (p + 1,) of their blocks. dense: unknowns kept.
    """

    landmark_at: IntArray
    node_at: IntArray
    error_at: IntArray
    cell: IntArray
    first: IntArray
    size: IntArray
    block_at: IntArray
    pairs: IntArray
    bounds: IntArray
    kept: int
    dense: int


@dataclasses.dataclass(frozen=True)
class _Values:
    """X_MN: (k + 1, 3), p_ML: (n, 2), errors: (n, 2) of the tags' range and bearing, m and rad."""

    X_MN: FloatArray
    p_ML: FloatArray
    errors: FloatArray


@dataclasses.dataclass(frozen=True)
class _Eliminated:
    """What is left when all but the kept unknowns are eliminated. information: (d, d), vector: (d,) of the kept.
    conditionals: those of the others given the kept, None without any. log_determinant: of the information on the
    others given the kept."""

    information: FloatArray
    vector: FloatArray
    conditionals: gtsam.GaussianBayesNet | None
    log_determinant: float


def solve(
    graph: KeyframeGraph,
    stamp: float,
    observation: Observation,
    *,
    place: FloatArray | None = None,
    node: int = -1,
    also: IntArray | None = None,
    joint: int = JOINT,
) -> tuple[KeyframeGraph, MapEstimate]:
    """The graph at its maximum a posteriori values, and the map with the joint Gaussian round a place.

    Args:
        graph: k keyframes, at least one.
        stamp: s, observation: the newest view's, with its trajectory; both go into the MapEstimate.
        place: (2,), m in M, where the nearest landmarks are known jointly; where the node is by default.
        node: whose pose X_MD is, from 1 to k; the newest by default.
        also: (r,) rows of landmarks that are to be among them however far away.
        joint: how many landmarks are known jointly.
    """
    factors = _factors(graph)
    node = len(graph.keyframes) if node < 0 else node
    if place is None:
        place = graph.X_MN[node, :2]
    local = np.sort(np.argsort(np.hypot(*(graph.p_ML - place).T), kind="stable")[:joint])
    local = local if also is None else np.union1d(local, also)
    cells = _cells(graph, factors, local, node)
    values = _Values(graph.X_MN.copy(), graph.p_ML.copy(), np.zeros(graph.p_ML.shape))
    for _ in range(MOST_STEPS):
        blocks, gradient, error, poses = _linearised(factors, cells, values)
        eliminated, root = _factorised(cells, blocks, gradient)
        step = _step(cells, eliminated, root)
        length = float(np.max(np.abs(step)))
        for _ in range(MOST_HALVINGS if length >= SMALL_STEP else 1):
            moved = _moved(cells, values, step)
            if _error(factors, moved) <= error + 1e-9 * (1.0 + abs(error)):
                break
            step = 0.5 * step
        values = moved
        if length < SMALL_STEP:
            break
    covariance, of_errors = _covariance(cells, root, local, node)
    tag_error = graph.tag_error
    if tag_error.any():
        tag_error = learnt(tag_error, values.errors[local], of_errors)
    else:
        tag_error = suspected(*tag_pulls(*factors.arrays, *factors.of_errors, values.X_MN, values.p_ML))
    yaw = graph.yaw
    if any(one.on_yaw.any() for one in graph.keyframes):
        yaw, on_yaw = _yaw(graph, factors, cells, values)
        values = _moved(cells, values, (yaw[0] - graph.yaw[0]) * on_yaw)
        at = _joint_at(cells, local, node)
        covariance += yaw[1] ** 2 * np.outer(on_yaw[at], on_yaw[at])
    X_MN, p_ML = values.X_MN.copy(), values.p_ML
    X_MN[:, 2] = np.arctan2(np.sin(X_MN[:, 2]), np.cos(X_MN[:, 2]))
    log_of_chain, pose_information = chain(np.full((3, 3), np.inf), poses)
    log_of_rest = log_of_chain + float(np.linalg.slogdet(pose_information)[1])
    if factors.tag_error.any():
        log_of_rest = _log_determinant_of_rest(cells, blocks)
    log_information = eliminated.log_determinant + 2.0 * float(np.sum(np.log(np.diag(root)))) - log_of_rest
    entropy = 0.5 * (2 * len(p_ML) * math.log(2.0 * math.pi * math.e) - log_information) if len(p_ML) else 0.0
    graph = replace(
        graph,
        X_MN=X_MN,
        p_ML=p_ML,
        landmark_covariance=with_local(graph.landmark_covariance, local, covariance),
        entropy=entropy,
        pose_information=pose_information,
        keyframes=tuple(at_yaw(one, float(yaw[0])) for one in graph.keyframes),
        yaw=yaw,
        tag_error=tag_error,
    )
    return graph, estimate_of(graph, stamp, observation, p_ML, X_MN[node], local, covariance)


def _moved(cells: _Cells, values: _Values, step: FloatArray) -> _Values:
    """Values moved by a step (u,) of the unknowns."""
    X_MN, errors = values.X_MN.copy(), values.errors
    X_MN[1:] += step[cells.node_at[1:, None] + [0, 1, 2]]
    if np.any(cells.error_at >= 0):
        errors = errors + step[cells.error_at[:, None] + [0, 1]]
    return _Values(X_MN, values.p_ML + step[cells.landmark_at[:, None] + [0, 1]], errors)


def _yaw(graph: KeyframeGraph, factors: _Factors, cells: _Cells, values: _Values) -> tuple[FloatArray, FloatArray]:
    """The camera's yaw and its deviation (2,), rad, by all keyframes, at the values that are the best given the yaw of
    the graph; and the derivative (u,) of the unknowns on it.

    The error is a parabola in the yaw, for what was seen is linear in it.
    """

    def error(change: float) -> float:
        return _error(_at_other_yaw(graph, factors, change), values)

    before, here, after = error(-YAW_STEP), error(0.0), error(YAW_STEP)
    slope, curvature = (after - before) / (4.0 * YAW_STEP), (before - 2.0 * here + after) / (2.0 * YAW_STEP**2)
    blocks, gradient, _, _ = _linearised(factors, cells, values)
    shifted = _linearised(_at_other_yaw(graph, factors, YAW_STEP), cells, values)[1]
    by_yaw = (shifted - gradient) / YAW_STEP
    on_yaw = _step(cells, *_factorised(cells, blocks, by_yaw))
    prior, sigma = graph.yaw_prior
    information = curvature + float(by_yaw @ on_yaw) + sigma**-2
    yaw = graph.yaw[0] - (slope + (graph.yaw[0] - prior) / sigma**2) / information
    return np.array([yaw, information**-0.5]), on_yaw


def _at_other_yaw(graph: KeyframeGraph, factors: _Factors, change: float) -> _Factors:
    """The factors with the camera's yaw changed, rad."""
    of_tags = np.concatenate([one.on_yaw[:-3].reshape(-1, 2) for one in graph.keyframes])
    of_way = np.array([one.on_yaw[-3:] for one in graph.keyframes])
    return dataclasses.replace(factors, p_AL=factors.p_AL + change * of_tags, X_AD=factors.X_AD + change * of_way)


def _at_errors(factors: _Factors, errors: FloatArray) -> _Factors:
    """The factors with the tags' errors (n, 2) taken out of what was seen."""
    if not factors.tag_error.any():
        return factors
    p_AL, X_AD = factors.p_AL.copy(), factors.X_AD.copy()
    for j, on_error in enumerate(factors.on_error):
        some = slice(factors.offsets[j], factors.offsets[j + 1])
        change = on_error @ errors[factors.rows[some]].ravel()
        p_AL[some] += change[:-3].reshape(-1, 2)
        X_AD[j] += change[-3:]
    return dataclasses.replace(factors, p_AL=p_AL, X_AD=X_AD)


def _error(factors: _Factors, values: _Values) -> float:
    """The weighted squared error."""
    error = batch_error(*_at_errors(factors, values.errors).arrays, values.X_MN, values.p_ML)
    return error + _error_of_errors(factors, values.errors)


def _error_of_errors(factors: _Factors, errors: FloatArray) -> float:
    """What the tags' errors (n, 2) cost by themselves."""
    if not factors.tag_error.any():
        return 0.0
    each, begin = errors[factors.rows].ravel(), 0
    total = float(np.sum((errors / factors.tag_error) ** 2)) + 2.0 * float(factors.slope @ each)
    for some in np.split(each, 2 * factors.offsets[1:-1]):
        curvature = factors.curvature[begin : begin + len(some) ** 2].reshape(len(some), len(some))
        total, begin = total + float(some @ curvature @ some), begin + len(some) ** 2
    return total


def known_jointly(graph: KeyframeGraph) -> int:
    """How many landmarks are known jointly at the end of a mission."""
    return len(graph.ids) if len(graph.ids) <= MOST_JOINT else JOINT


def with_local(landmark_covariance: FloatArray, local: IntArray, covariance: FloatArray) -> FloatArray:
    """The covariance of each landmark (n, 2, 2), with those in rows local (m,) as their joint covariance has them."""
    each, m = landmark_covariance.copy(), np.arange(len(local))
    each[local] = covariance[:-3, :-3].reshape(len(m), 2, len(m), 2)[m, :, m, :]
    return each


def estimate_of(
    graph: KeyframeGraph,
    stamp: float,
    observation: Observation,
    p_ML: FloatArray,
    X_MD: FloatArray,
    local: IntArray,
    covariance: FloatArray,
) -> MapEstimate:
    """The message of a graph, at some values of its landmarks and newest pose, and their joint covariance."""
    return MapEstimate(
        stage=len(graph.view_keyframe),
        stamp=stamp,
        ids=graph.ids,
        p_ML=p_ML,
        X_MD=X_MD,
        local=local,
        covariance=covariance,
        landmark_covariance=graph.landmark_covariance,
        X_MA=graph.X_MA,
        observation=observation,
        entropy=graph.entropy,
        tag_error=graph.tag_error,
    )


def _factors(graph: KeyframeGraph) -> _Factors:
    counts = np.array([len(one.ids) for one in graph.keyframes])
    ids = np.concatenate([one.ids for one in graph.keyframes])
    return _Factors(
        offsets=np.append(0, np.cumsum(counts)),
        rows=rows_of(ids, graph.ids)[0],
        p_AL=np.concatenate([one.p_AL for one in graph.keyframes]),
        X_AD=np.array([one.X_AD for one in graph.keyframes]),
        starts=np.append(0, np.cumsum((2 * counts + 3) ** 2)),
        information=np.concatenate([one.information.ravel() for one in graph.keyframes]),
        on_error=tuple(one.on_error for one in graph.keyframes),
        curvature=np.concatenate([one.error_curvature.ravel() for one in graph.keyframes]),
        slope=np.concatenate([one.error_slope for one in graph.keyframes]),
        tag_error=graph.tag_error,
    )


def _bisected(points: FloatArray, index: IntArray, most: int) -> Iterable[IntArray]:
    """Some of the points (n, 2), by their index (i,), in groups of at most so many that lie together."""
    if len(index) <= most:
        return [index] if len(index) else []
    some = points[index]
    order = index[np.argsort(some[:, np.argmax(np.ptp(some, axis=0))], kind="stable")]
    half = len(order) // 2
    return [*_bisected(points, order[:half], most), *_bisected(points, order[half:], most)]


def _cells(graph: KeyframeGraph, factors: _Factors, local: IntArray, node: int) -> _Cells:
    n, k = len(graph.ids), len(graph.keyframes)
    is_local = np.zeros(n, dtype=bool)
    is_local[local] = True
    inner = np.delete(np.arange(1, k + 1), node - 1)
    has_errors = bool(factors.tag_error.any())
    near = list(_bisected(graph.p_ML, local, CELL // 2))
    far = list(_bisected(graph.p_ML, np.flatnonzero(~is_local), CELL // 2))
    poses = list(_bisected(graph.X_MN[:, :2], inner, CELL // 3))
    landmark_at, error_at, node_at = np.full(n, -1), np.full(n, -1), np.full(k + 1, -1)
    landmark_cell, error_cell, node_cell = np.full(n, -1), np.full(n, -1), np.full(k + 1, -1)
    landmark, error, pose = (landmark_at, landmark_cell, 2), (error_at, error_cell, 2), (node_at, node_cell, 3)
    groups = [(group, landmark) for group in near] + [(np.array([node]), pose)]
    groups += [(group, error) for group in near if has_errors]
    kept = len(groups)
    groups += [(group, landmark) for group in far] + [(group, error) for group in far if has_errors]
    groups += [(group, pose) for group in poses]

    size = np.array([width * len(group) for group, (_, _, width) in groups])
    first = np.cumsum(size) - size
    for number, (group, (at, of, width)) in enumerate(groups):
        at[group] = first[number] + width * np.arange(len(group))
        of[group] = number
    together = np.zeros((k, len(groups)), dtype=bool)
    keyframe = np.repeat(np.arange(k), np.diff(factors.offsets))
    together[keyframe, landmark_cell[factors.rows]] = True
    if has_errors:
        together[keyframe, error_cell[factors.rows]] = True
    together[np.arange(k), node_cell[1:]] = True
    together[np.arange(1, k), node_cell[1:k]] = True
    shared = together.T.astype(np.float32) @ together.astype(np.float32)
    pairs = np.argwhere(np.triu(shared > 0.0))
    bounds = np.append(0, np.cumsum(size[pairs[:, 0]] * size[pairs[:, 1]]))
    block_at = np.full((len(groups), len(groups)), -1)
    block_at[pairs[:, 0], pairs[:, 1]] = bounds[:-1]
    return _Cells(
        landmark_at=landmark_at,
        node_at=node_at,
        error_at=error_at,
        cell=np.repeat(np.arange(len(groups)), size),
        first=first,
        size=size,
        block_at=block_at,
        pairs=pairs,
        bounds=bounds,
        kept=kept,
        dense=int(size[:kept].sum()),
    )


def _linearised(factors: _Factors, cells: _Cells, values: _Values) -> tuple[FloatArray, FloatArray, float, FloatArray]:
    """Blocks and gradient (u,) at some values, the weighted squared error there, and the blocks of the poses."""
    blocks, gradient = np.zeros(cells.bounds[-1]), np.zeros(len(cells.cell))
    seen, of_cells = _at_errors(factors, values.errors).arrays, (cells.cell, cells.first, cells.size, cells.block_at)
    at = cells.landmark_at, cells.node_at
    error, poses = assemble(*seen, values.X_MN, values.p_ML, *at, *of_cells, blocks, gradient)
    if factors.tag_error.any():
        at_errors = *at, cells.error_at
        where = values.X_MN, values.p_ML, values.errors
        assemble_tag_errors(*seen, *factors.of_errors, *where, *at_errors, *of_cells, blocks, gradient)
        own, prior = cells.error_at[:, None] + [0, 1], factors.tag_error**-2
        cell = cells.cell[own]
        entry = own - cells.first[cell]
        blocks[cells.block_at[cell, cell] + entry * (cells.size[cell] + 1)] += prior
        gradient[own] += prior * values.errors
        error += _error_of_errors(factors, values.errors)
    return blocks, gradient, error, poses


def _factorised(cells: _Cells, blocks: FloatArray, gradient: FloatArray) -> tuple[_Eliminated, FloatArray]:
    """The system with all but the kept eliminated, and the lower Cholesky factor of what is left.

    Where some part of the map hangs on nothing that a double can tell, all is held by as little as it takes.
    """
    damping = 0.0
    while True:
        try:
            eliminated = _eliminated(cells, blocks, gradient, damping)
            return eliminated, scipy.linalg.cholesky(eliminated.information, lower=True, check_finite=False)
        except (RuntimeError, scipy.linalg.LinAlgError):
            if damping > MOST_DAMPING:
                raise
            damping = max(DAMPING_GROWTH * damping, LEAST_DAMPING)


def _eliminated(cells: _Cells, blocks: FloatArray, gradient: FloatArray, damping: float) -> _Eliminated:
    first, size, kept = cells.first.tolist(), cells.size.tolist(), cells.kept
    information, vector = damping * np.eye(cells.dense), -gradient[: cells.dense]
    sparse, touched = gtsam.GaussianFactorGraph(), set()
    zero = {one: (np.zeros((one, one)), np.zeros(one)) for one in set(size)}
    for (i, j), start, end in zip(cells.pairs.tolist(), cells.bounds[:-1], cells.bounds[1:], strict=True):
        block = blocks[start:end].reshape(size[i], size[j])
        if j < kept:
            information[first[i] : first[i] + size[i], first[j] : first[j] + size[j]] += block
            if i != j:
                information[first[j] : first[j] + size[j], first[i] : first[i] + size[i]] += block.T
        elif i == j:
            held = block + damping * np.eye(size[i]) if damping else block
            sparse.push_back(gtsam.HessianFactor(i, held, -gradient[first[i] : first[i] + size[i]], 0.0))
        else:
            (G_i, g_i), (G_j, g_j) = zero[size[i]], zero[size[j]]
            sparse.push_back(gtsam.HessianFactor(i, j, G_i, block, g_i, G_j, g_j, 0.0))
            if i < kept:
                touched.add(i)
    if len(size) == kept:
        return _Eliminated(information, vector, None, 0.0)
    last = sorted(touched)
    everything = gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(sparse, last, False)
    before, after = gtsam.Ordering(), gtsam.Ordering()
    for place in range(len(size) - kept):
        before.push_back(everything.at(place))
    for i in last:
        after.push_back(i)
    conditionals, left = sparse.eliminatePartialSequential(before)
    if last:
        of_last, vector_of_last = left.hessian(after)
        at = np.concatenate([np.arange(first[i], first[i] + size[i]) for i in last])
        information[np.ix_(at, at)] += of_last
        vector[at] += vector_of_last
    roots = (conditionals.at(place).R() for place in range(conditionals.size()))
    log_determinant = 2.0 * sum(float(np.sum(np.log(np.abs(np.diag(root))))) for root in roots)
    return _Eliminated(information, vector, conditionals, log_determinant)


def _step(cells: _Cells, eliminated: _Eliminated, root: FloatArray) -> FloatArray:
    """(u,) the step of Gauss and Newton."""
    step = np.empty(len(cells.cell))
    step[: cells.dense] = scipy.linalg.cho_solve((root, True), eliminated.vector, check_finite=False)
    if eliminated.conditionals is not None:
        known = gtsam.VectorValues()
        for i, size in enumerate(cells.size[: cells.kept].tolist()):
            known.insert(i, step[cells.first[i] : cells.first[i] + size])
        found = eliminated.conditionals.optimize(known)
        for i in range(cells.kept, len(cells.size)):
            step[cells.first[i] : cells.first[i] + cells.size[i]] = found.at(i)
    return step


def _joint_at(cells: _Cells, local: IntArray, node: int) -> IntArray:
    """(2m + 3,) where landmarks in rows local (m,) and a node's pose are among the unknowns."""
    return np.append((cells.landmark_at[local][:, None] + [0, 1]).ravel(), cells.node_at[node] + np.arange(3))


def _covariance(cells: _Cells, root: FloatArray, local: IntArray, node: int) -> tuple[FloatArray, FloatArray]:
    """(2m + 3, 2m + 3) covariance of the landmarks in rows local (m,) and of a node's pose, and (m, 2) the variances of
    the errors of those, zero where they have none."""
    lower, _ = scipy.linalg.lapack.dpotri(root, lower=1)
    at = _joint_at(cells, local, node)
    whole = np.tril(lower) + np.tril(lower, -1).T
    of_errors = np.zeros((len(local), 2))
    if np.any(cells.error_at >= 0):
        of_errors = np.diag(lower)[cells.error_at[local][:, None] + [0, 1]]
    return np.asarray(whole[np.ix_(at, at)]), of_errors


def _log_determinant_of_rest(cells: _Cells, blocks: FloatArray) -> float:
    """Of the information on all unknowns but the landmarks, given these."""
    landmarks = np.unique(cells.cell[cells.landmark_at])
    size, system = cells.size.tolist(), gtsam.GaussianFactorGraph()
    for (i, j), start, end in zip(cells.pairs.tolist(), cells.bounds[:-1], cells.bounds[1:], strict=True):
        if i in landmarks or j in landmarks:
            continue
        block, g_i, g_j = blocks[start:end].reshape(size[i], size[j]), np.zeros(size[i]), np.zeros(size[j])
        if i == j:
            system.push_back(gtsam.HessianFactor(i, block, g_i, 0.0))
        else:
            own = np.zeros((size[i], size[i])), np.zeros((size[j], size[j]))
            system.push_back(gtsam.HessianFactor(i, j, own[0], block, g_i, own[1], g_j, 0.0))
    conditionals = system.eliminateSequential()
    roots = (conditionals.at(place).R() for place in range(conditionals.size()))
    return 2.0 * sum(float(np.sum(np.log(np.abs(np.diag(root))))) for root in roots)
