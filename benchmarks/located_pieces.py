"""Pieces of one half of a laser log, looked for in the map of the other half.

    python benchmarks/located_pieces.py DATA RUNS --logs intel,fr079

DATA as of `relations.py`. RUNS has a run of the whole log and of either half, made if absent. Pieces are 20 m of way,
from places all along the half, mapped by themselves. A piece is right where its newest view lies within 0.3 m and 0.1
rad of where the map of the whole log has it, seen from the other half; many lie where the other half has never been.
Printed are how many are claimed, how many of these rightly, and the share that was wrong by stated probability.
"""

from __future__ import annotations

import argparse
import bz2
import itertools
import math
from pathlib import Path

import numpy as np
from relation_regions import run_of

from tfg_drake.geometry import se2
from tfg_drake.geometry.alignment import align
from tfg_drake.mapfile.placement import seen_in
from tfg_drake.mapfile.saved_map import SavedMap, load_map
from tfg_drake.slam.place_search import Places, Seen, find_places, nothing_seen
from tfg_drake.slam.surface_fit import surface_points
from tfg_drake.storage.trajectory import read_tum

WAY, RIGHT, BINS = 20.0, (0.3, 0.1), (0.0, 0.01, 0.1, 0.5, 1.0)


def halves(data: Path, runs: Path, name: str) -> None:
    """Writes either half of a log, cut at half of its scans."""
    lines = bz2.decompress((data / f"{name}.clf.bz2").read_bytes()).splitlines(keepends=True)
    for part, some in (("a", lines[: len(lines) // 2]), ("b", lines[len(lines) // 2 :])):
        path = runs / f"{name}-{part}.clf.bz2"
        if not path.exists():
            path.write_bytes(bz2.compress(b"".join(some)))


def placed(saved: SavedMap, first: int, last: int, known: Seen) -> Places:
    """The places that some views of a map may have in what another one's have seen."""
    graph, seen = saved.graph, nothing_seen()
    for k in np.unique(graph.view_keyframe[first:last]):
        points = surface_points(graph.keyframes[k], graph.shared.mean)
        seen = seen.with_look(points, graph.X_MN[k])
    return find_places(known, seen)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("runs", type=Path)
    parser.add_argument("--logs", default="intel,fr079")
    parser.add_argument("--pieces", type=int, default=100)
    options = parser.parse_args()
    options.runs.mkdir(parents=True, exist_ok=True)
    claims = []
    for name in options.logs.split(","):
        halves(options.data, options.runs, name)
        _, whole = read_tum(run_of(options.data, options.runs, name) / "trajectory.tum")
        parts = [run_of(options.runs, options.runs, f"{name}-{part}") for part in "ab"]
        maps = [load_map(part / "map.npz") for part in parts]
        ways = [read_tum(part / "trajectory.tum")[1] for part in parts]
        # A pause of the robot is no time in the whole log's trajectory, which therefore goes by its rows.
        if len(whole) != sum(map(len, ways)):
            raise SystemExit(f"{name}: the halves have {[*map(len, ways)]} poses, the whole log {len(whole)}")
        truth = np.split(whole, [len(ways[0])])
        rows = []
        for old, new in ((0, 1), (1, 0)):
            saved, known, X = maps[new], seen_in(maps[old]), ways[new]
            X_MA = saved.graph.X_MA
            way = np.append(0.0, np.cumsum(np.hypot(*np.diff(X_MA[:, :2], axis=0).T)))
            # The old half's frame in that of the whole log.
            X_CK = align(truth[old][:, :2], ways[old][:, :2])
            for end in np.linspace(np.searchsorted(way, WAY), len(way) - 1, options.pieces).astype(int):
                first = int(np.searchsorted(way, way[end] - WAY))
                places = placed(saved, first, end + 1, known)
                apart = X - X_MA[end]
                nearest = np.argmin(np.hypot(apart[:, 0], apart[:, 1]) + np.abs(se2.wrap_angle(apart[:, 2])))
                true = se2.compose(
                    se2.between(X_CK, truth[new][nearest]), se2.inverse(se2.between(X_MA[end], X[nearest]))
                )
                if not len(places.X):
                    rows.append((0.0, False, False))
                    continue
                off = se2.between(true, se2.compose(places.X[0], X_MA[end]))
                right = math.hypot(off[0], off[1]) < RIGHT[0] and abs(off[2]) < RIGHT[1]
                rows.append((places.probability[0], right, places.found() is not None))
        probability, right, claimed = np.array(rows, dtype=float).T
        claimed, right = claimed.astype(bool), right.astype(bool)
        wrong, told = 1.0 - probability, []
        for low, high in itertools.pairwise(BINS):
            some = (wrong >= low) & (wrong < high) & (probability > 0.0)
            if some.any():
                told.append(f"{low:g} to {high:g}: {1.0 - right[some].mean():.3f} of {some.sum()}")
        claims.append(f"of {name} {claimed.sum()} of {len(rows)}, {np.sum(claimed & right)} rightly")
        print(f"{claims[-1]}; wrong where stated {', '.join(told)}", flush=True)
    print(f"\nclaimed {'; '.join(claims)}")


if __name__ == "__main__":
    main()
