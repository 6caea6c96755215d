"""What one more goal costs on maps of 1000, 10 000 and 100 000 landmarks, beside GTSAM's own ways.

    python benchmarks/map_size.py
    python benchmarks/map_size.py --landmarks 1000 10000 --goals 40

A robot goes to and fro over a plain of tags, 35 in view of a goal, a third of them new. A map of the size asked for is
laid out at once, solved, and then grown by --goals goals, turning back where a row ends. A row a size: median CPU
milliseconds a goal of the whole update and of the joint covariance in it that planning needs, the slowest goal
(a turn back closes a loop, and the whole graph may be solved), and bytes a landmark of the graph in memory and in a map
file; beside it, on the same factors, the median of gtsam.ISAM2.update and of gtsam.Marginals with the joint covariance
of the 50 landmarks nearest to the newest goal. What takes more than --patience seconds is not done: -.
"""

from __future__ import annotations

import argparse
import io
import math
import multiprocessing
import time
from collections.abc import Callable

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, D, L
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from tfg_drake.geometry import se2
from tfg_drake.messages import FloatArray, GoalObservation, MapEstimate
from tfg_drake.slam import map_solver
from tfg_drake.slam.goal_arrival import add_goal
from tfg_drake.slam.goal_factors import factor_graph, joint_factor, segment_factor, values_of
from tfg_drake.slam.goal_graph import GoalGraph, empty_graph, goal_factor

PITCH = 5.0  # m between goals
REACH = 10.0  # m a tag is seen
IN_VIEW = 35
NEW = 12  # landmarks a goal
SEGMENT = np.diag([0.1, 0.1, 0.02]) ** 2
X_AD = np.array([0.0, 0.0, 0.1])


class Synthetic:
    """Goals X_WA (k, 3) and what a robot with noisy sensors observes there of landmarks p_WL (n, 2)."""

    def __init__(self, X_WA: FloatArray, p_WL: FloatArray, rng: np.random.Generator) -> None:
        self.X_WA, self.p_WL, self.rng = X_WA, p_WL, rng
        self.tree = cKDTree(p_WL)

    def observation(self, k: int) -> GoalObservation:
        """Goal k's: range and bearing of each tag for itself, and an error of heading that all share."""
        X = self.X_WA[k]
        rows = np.array(self.tree.query_ball_point(X[:2], REACH), dtype=np.int64)
        distance = np.hypot(*(self.p_WL[rows] - X[:2]).T)
        rows = np.sort(rows[np.argsort(distance)[:IN_VIEW]])
        p_AL = se2.transform(se2.inverse(X), self.p_WL[rows])
        n, r = len(rows), np.hypot(*p_AL.T)
        u = p_AL / r[:, None]
        across = np.stack([-p_AL[:, 1], p_AL[:, 0]], axis=1)
        root = np.zeros((2 * n + 3, 2 * n + 4))
        for i in range(n):
            root[2 * i : 2 * i + 2, 2 * i] = (0.01 + 0.003 * r[i]) * u[i]
            root[2 * i : 2 * i + 2, 2 * i + 1] = 0.003 * across[i]
            root[2 * i : 2 * i + 2, -1] = 0.002 * across[i]
        root[-3:, -4:-1] = np.diag([0.002, 0.002, 0.001])
        error = root @ self.rng.standard_normal(2 * n + 4)
        return GoalObservation(
            ids=rows,
            p_AL=p_AL + error[:-3].reshape(-1, 2),
            X_AD=X_AD + error[-3:],
            covariance=root @ root.T,
            stamps=np.empty(0),
            X_AB=np.empty((0, 3)),
        )

    def segment(self, k: int) -> FloatArray:
        """X_DA (3,) from goal k - 1 to goal k as odometry has it."""
        X_WD = se2.compose(self.X_WA[k - 1], X_AD)
        return se2.between(X_WD, self.X_WA[k]) + np.sqrt(np.diag(SEGMENT)) * self.rng.standard_normal(3)


class Plain(Synthetic):
    """Goals in rows, to and fro, and landmarks all over."""

    def __init__(self, landmarks: int, extra: int) -> None:
        rng = np.random.default_rng(0)
        self.before = round(landmarks / NEW)
        across = max(4, round(math.sqrt(self.before)))
        rows = math.ceil((self.before + extra) / across) + 1
        number = np.arange(self.before + extra)
        row, column = np.divmod(number, across)
        column = np.where(row % 2 == 0, column, across - 1 - column)
        heading = rng.uniform(-np.pi, np.pi, len(number))
        X_WA = np.column_stack([PITCH * column, PITCH * row, heading])
        corner = PITCH * np.array([across, rows])
        super().__init__(X_WA, rng.uniform(-PITCH, corner, (NEW * across * rows, 2)), rng)

    def map(self) -> tuple[GoalGraph, MapEstimate]:
        """The solved map of the first goals, laid out at the truth: growing it goal by goal would take hours."""
        graph, estimate = empty_graph(), None
        k = self.before
        observations = tuple(self.observation(i) for i in range(k))
        for i, observation in enumerate(observations[:40]):
            graph, _ = add_goal(graph, estimate, observation, self.segment(i) if i else X_AD, SEGMENT)
            graph, estimate = map_solver.solve(graph, float(i), observation)
        X_MW = se2.inverse(self.X_WA[0])
        ids, sightings = np.unique(np.concatenate([one.ids for one in observations]), return_counts=True)
        X_MA = se2.compose(X_MW, self.X_WA[:k])
        X_MD = np.array([se2.compose(X, one.X_AD) for X, one in zip(X_MA, observations, strict=True)])
        graph = GoalGraph(
            observations=tuple(goal_factor(one) for one in observations),
            is_goal=np.ones(k, dtype=bool),
            X_DA=np.array([self.segment(i) for i in range(1, k)]),
            segment_covariance=np.tile(SEGMENT, (k - 1, 1, 1)),
            X_MA=X_MA,
            X_MD=X_MD,
            ids=ids,
            p_ML=se2.transform(X_MW, self.p_WL[ids]),
            sightings=sightings,
            travel_covariance=np.tile(graph.travel_covariance[-10:].mean(axis=0), (k - 1, 1, 1)),
            departure_covariance=np.tile(graph.departure_covariance[-1], (k, 1, 1)),
            landmark_covariance=np.tile(graph.landmark_covariance.mean(axis=0), (len(ids), 1, 1)),
            entropy=0.0,
        )
        graph = map_solver.settle(graph)
        return graph, map_solver.restored(graph, 0.0, observations[-1])


def ours(plain: Plain, graph: GoalGraph, estimate: MapEstimate, goals: int) -> tuple[GoalGraph, FloatArray]:
    """The map with the goals added, and CPU s of each: (goals, 2), the whole update and the covariance's part of it."""
    spent = np.zeros((goals, 2))
    joint = map_solver._joint

    def timed(*arguments, **named):
        begin = time.process_time()
        result = joint(*arguments, **named)
        spent[i, 1] += time.process_time() - begin
        return result

    map_solver._joint = timed
    for i in range(goals):
        k = plain.before + i
        observation, segment = plain.observation(k), plain.segment(k)
        begin = time.process_time()
        graph, _ = add_goal(graph, estimate, observation, segment, SEGMENT)
        graph, estimate = map_solver.solve(graph, float(k), observation)
        spent[i, 0] = time.process_time() - begin
    map_solver._joint = joint
    return graph, spent


def isam2(graph: GoalGraph, before: int) -> float:
    """Median CPU s of ISAM2's update for each goal from `before` on, all older ones given at once."""
    solver = gtsam.ISAM2(gtsam.ISAM2Params())
    known: set[int] = set()
    values, spent = values_of(graph), []
    for k in range(before - 1, len(graph.observations)):
        factors, new = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for j in range(before) if k == before - 1 else [k]:
            factor = joint_factor(graph, j)
            factors.add(factor)
            if j > 0:
                factors.add(segment_factor(j - 1, j, graph.X_DA[j - 1], graph.segment_covariance[j - 1]))
            else:
                factors.add(gtsam.PriorFactorPose2(A(0), gtsam.Pose2(), gtsam.noiseModel.Isotropic.Sigma(3, 1e-7)))
            for key in list(factor.keys()):
                if key not in known:
                    known.add(key)
                    if gtsam.Symbol(key).chr() == ord("l"):
                        new.insert(key, values.atPoint2(key))
                    else:
                        new.insert(key, values.atPose2(key))
        begin = time.process_time()
        solver.update(factors, new)
        solver.calculateEstimate()
        spent.append(time.process_time() - begin)
    return float(np.median(spent[1:]))


def marginals(graph: GoalGraph) -> float:
    """CPU s of gtsam.Marginals and the joint covariance of the 50 landmarks nearest to the newest goal."""
    nearest = np.argsort(np.hypot(*(graph.p_ML - graph.X_MD[-1, :2]).T))[:50]
    factors, values = factor_graph(graph), values_of(graph)
    begin = time.process_time()
    keys = [*(L(int(tag)) for tag in graph.ids[nearest]), D(len(graph.observations) - 1)]
    gtsam.Marginals(factors, values).jointMarginalCovariance(keys)
    return time.process_time() - begin


def patiently(patience: float, function: Callable[..., float], *arguments: object) -> float:
    """What a function returns in a process of its own, nan if that takes longer than patience (s) or it fails."""
    receiver, sender = multiprocessing.Pipe(duplex=False)
    process = multiprocessing.Process(target=lambda: sender.send(function(*arguments)))
    process.start()
    result = receiver.recv() if receiver.poll(patience) else math.nan
    process.kill()
    process.join()
    return float(result)


def bytes_in_memory(graph: GoalGraph) -> int:
    """Of all its arrays."""
    total = sum(value.nbytes for value in vars(graph).values() if isinstance(value, np.ndarray))
    for one in graph.observations:
        total += sum(value.nbytes for value in vars(one).values() if isinstance(value, np.ndarray))
    return total


def bytes_in_file(graph: GoalGraph) -> int:
    """As a map file has it."""
    from tfg_drake.mapfile.message_arrays import to_arrays
    from tfg_drake.mapfile.saved_map import REGISTRY

    buffer = io.BytesIO()
    np.savez_compressed(buffer, **to_arrays(graph, REGISTRY))
    return len(buffer.getvalue())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--landmarks", type=int, nargs="+", default=[1000, 10_000, 100_000])
    parser.add_argument("--goals", type=int, default=30)
    parser.add_argument("--patience", type=float, default=300.0)
    options = parser.parse_args()

    heads = (
        "landmarks",
        "goals",
        "update ms",
        "cov. ms",
        "slowest ms",
        "bytes each",
        "in file",
        "ISAM2 ms",
        "Marg. ms",
    )
    print("".join(f"{head:>12}" for head in heads))
    for landmarks in options.landmarks:
        plain = Plain(landmarks, options.goals)
        graph, estimate = plain.map()
        grown, spent = ours(plain, graph, estimate, options.goals)
        row = [
            len(graph.ids),
            len(graph.observations),
            1e3 * np.median(spent[:, 0]),
            1e3 * np.median(spent[:, 1]),
            1e3 * spent[:, 0].max(),
            bytes_in_memory(grown) / len(grown.ids),
            bytes_in_file(grown) / len(grown.ids),
            1e3 * patiently(options.patience, isam2, grown, plain.before),
            1e3 * patiently(options.patience, marginals, grown),
        ]
        cells = ["-" if math.isnan(value) else f"{value:.0f}" for value in row]
        print("".join(f"{cell:>12}" for cell in cells), flush=True)


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        main()
