"""How far the walls of a run's map are off the true ones, and how many are of no true wall.

python benchmarks/wall_errors.py RUN [RUN ...]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from tfg_drake.diagrams.scenario import LoadScenario
from tfg_drake.geometry import se2
from tfg_drake.mapfile.saved_map import load_map
from tfg_drake.slam.walls import known_walls

# A wall of the map is assigned to a true one if both points lie within OFF, m, of its line, the cosine between them is
# above ALIKE, and they overlap up to a gap of BEYOND, m, at the ends.
OFF, ALIKE, BEYOND = 0.15, 0.9, 0.3


def wall_errors(run: Path) -> np.ndarray:
    """(w,) m, how far each wall of a run's map is off the nearest true one, inf where there is none."""
    saved, walls = load_map(run / "map.npz"), np.array(LoadScenario(run / "scenario.yaml").world.walls)
    p_WL = se2.transform(saved.X_WM, known_walls(saved.graph)[1].reshape(-1, 2)).reshape(-1, 2, 2)
    along = walls[:, 2:] - walls[:, :2]
    length = np.hypot(*along.T)
    along = along / length[:, None]
    off = np.full(len(p_WL), np.inf)
    for k, points in enumerate(p_WL):
        apart = points[None] - walls[:, None, :2]
        s = np.einsum("wpi,wi->wp", apart, along)
        e = np.abs(apart[:, :, 0] * along[:, None, 1] - apart[:, :, 1] * along[:, None, 0])
        own = (points[1] - points[0]) / np.hypot(*(points[1] - points[0]))
        same = (np.abs(along @ own) > ALIKE) & (s.max(axis=1) > -BEYOND) & (s.min(axis=1) < length + BEYOND)
        off[k] = e.max(axis=1)[same].min(initial=np.inf)
    return off


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path)
    for run in parser.parse_args().runs:
        off = wall_errors(run)
        told = f"off {np.median(off):.4f} m median, {off.max():.4f} m worst" if len(off) else ""
        print(f"{run}: {len(off)} walls, {np.count_nonzero(off > OFF)} of no true one; {told}")


if __name__ == "__main__":
    main()
