"""CPU time of one more view on maps of 1000, 4000 and 10 000 landmarks.

    python benchmarks/map_size.py
    python benchmarks/map_size.py --landmarks 1000 10000 --goals 40

A robot goes to and fro over a plain of tags. Each view sees 35, a third of them new. A map of the size asked for is
laid out at once, solved, and then grown by --goals views, turning back where a row ends. A row a size: CPU milliseconds
a view, mean, median and most (a solve of the whole graph is among them where one is due), of a solve by itself, and
bytes a landmark of the graph in memory and in a map file.
"""

from __future__ import annotations

import argparse
import io
import math
import time

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from tfg_drake.config import OdometryConfig, TagSensorConfig
from tfg_drake.geometry import se2
from tfg_drake.mapfile.message_arrays import to_arrays
from tfg_drake.messages import FloatArray, MapEstimate, replace
from tfg_drake.slam.keyframe import Keyframe, of_places, way
from tfg_drake.slam.keyframe_graph import KeyframeGraph, empty_graph, fused, no_observation
from tfg_drake.slam.map_solver import solve
from tfg_drake.slam.map_update import finished, needs_solve, updated
from tfg_drake.slam.shared import by_data_sheet

PITCH = 5.0  # m between views
REACH = 10.0  # m a tag is seen
IN_VIEW = 35
NEW = 12  # landmarks a view
ODOMETRY = np.diag([0.1, 0.1, 0.02]) ** 2
X_AD = np.array([0.0, 0.0, 0.1])


class Synthetic:
    """Views X_WA (k, 3) and what a robot with noisy sensors observes there of landmarks p_WL (n, 2)."""

    def __init__(self, X_WA: FloatArray, p_WL: FloatArray, rng: np.random.Generator) -> None:
        self.X_WA, self.p_WL, self.rng = X_WA, p_WL, rng
        self.tree = cKDTree(p_WL)

    def view(self, k: int) -> Keyframe:
        """View k's: range and bearing of each tag for itself, and an error of heading that all share."""
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
        none = np.zeros_like(p_AL)
        return of_places(rows, p_AL + error[:-3].reshape(-1, 2), none, none, X_AD + error[-3:], root @ root.T)

    def way(self, k: int) -> Keyframe:
        """The way from view k - 1 to view k as odometry has it."""
        X_WD = se2.compose(self.X_WA[k - 1], X_AD)
        X_DA = se2.between(X_WD, self.X_WA[k]) + np.sqrt(np.diag(ODOMETRY)) * self.rng.standard_normal(3)
        return way(X_DA, ODOMETRY)


class Plain(Synthetic):
    """Views in rows, to and fro, and landmarks all over."""

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

    def map(self) -> tuple[KeyframeGraph, MapEstimate]:
        """The solved map of the first views, laid out at the truth: growing it view by view would take hours."""
        X_MW, seen, X_MN = se2.inverse(self.X_WA[0]), [], [np.zeros(3)]
        for k in range(self.before):
            X_MA = se2.compose(X_MW, self.X_WA[k])
            if k > 0:
                seen.append(self.way(k))
                X_MN.append(X_MA)
            seen.append(self.view(k))
            X_MN.append(se2.compose(X_MA, X_AD))
        ids = np.unique(np.concatenate([one.ids for one in seen]))
        graph = replace(
            empty_graph(by_data_sheet(OdometryConfig(), TagSensorConfig())),
            keyframes=tuple(seen),
            X_MN=np.array(X_MN),
            view_keyframe=np.arange(0, len(seen), 2),
            X_AV=np.zeros((self.before, 3)),
            ids=ids,
            p_ML=se2.transform(X_MW, self.p_WL[ids]),
            anchor=np.zeros((len(ids), 2)),
            reach=np.zeros((len(ids), 2)),
            landmark_covariance=np.tile(0.01 * np.eye(2), (len(ids), 1, 1)),
        )
        return solve(graph, 0.0, no_observation())


def grown(plain: Plain, graph: KeyframeGraph, estimate: MapEstimate, views: int) -> tuple[KeyframeGraph, FloatArray]:
    """The map with the views added, and CPU s of each (views,)."""
    spent, solved = np.zeros(views), graph
    for i in range(views):
        k = plain.before + i
        driven, view = plain.way(k), plain.view(k)
        begin = time.process_time()
        for one in (driven, view):
            graph, estimate, _ = updated(graph, estimate, one, is_view=one is view)
        if needs_solve(graph, solved, estimate):
            graph, estimate = solve(fused(replace(graph, p_ML=estimate.p_ML)), float(k), no_observation())
            solved = graph
        else:
            graph, estimate = finished(graph, estimate, float(k), no_observation())
        spent[i] = time.process_time() - begin
    return graph, spent


def bytes_in_memory(graph: KeyframeGraph) -> int:
    """Bytes of all its arrays."""
    total = sum(value.nbytes for value in vars(graph).values() if isinstance(value, np.ndarray))
    for one in graph.keyframes:
        total += sum(value.nbytes for value in vars(one).values() if isinstance(value, np.ndarray))
    return total


def bytes_in_file(graph: KeyframeGraph) -> int:
    """As a map file has it."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **to_arrays(graph))
    return len(buffer.getvalue())


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--landmarks", type=int, nargs="+", default=[1000, 4000, 10_000])
    parser.add_argument("--goals", type=int, default=30)
    options = parser.parse_args()
    heads = ("landmarks", "keyframes", "ms mean", "ms median", "ms most", "ms solve", "bytes", "in a file")
    print("".join(f"{head:>11}" for head in heads))
    solves = []
    with threadpool_limits(limits=1):
        grown(Plain(100, 3), *Plain(100, 3).map(), 3)  # Compiles what there is to compile.
        for landmarks in options.landmarks:
            plain = Plain(landmarks, options.goals)
            graph, spent = grown(plain, *plain.map(), options.goals)
            begin = time.process_time()
            solve(graph, 0.0, no_observation())
            solving = time.process_time() - begin
            n = len(graph.ids)
            row = [n, len(graph.keyframes), 1e3 * spent.mean(), 1e3 * np.median(spent), 1e3 * spent.max()]
            row += [1e3 * solving, bytes_in_memory(graph) / n, bytes_in_file(graph) / n]
            print("".join(f"{value:>11.0f}" for value in row), flush=True)
            solves.append(f"of {n} landmarks {solving:.2f}")
    print(f"\na solve takes {', '.join(solves)} s of CPU time")


if __name__ == "__main__":
    main()
