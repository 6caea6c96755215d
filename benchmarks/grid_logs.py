"""GMapping on recorded logs: how far its trajectory is off, what an update costs, and a picture of each map.

    python benchmarks/grid_logs.py DATA --out FOLDER --particles 100

DATA holds Radish's corrected CARMEN logs in carmen/ and CoreSLAM's rover in breezyslam/; those that are missing are
left out. The CARMEN logs' odometry is the corrected poses with errors drawn by --seed: a random walk and constants a
run as in OdometryConfig, times --noise. A row a log: updates; distance from the corrected positions after alignment in
SE(2), mean and max, m, of the best particle's path, of the estimate at the time (online), and of the odometry; CPU an
update, ms, and MB of the particles' maps at the end. The picture has the best particle's map and path.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from threadpoolctl import threadpool_limits

from tfg_drake.config import GridConfig
from tfg_drake.datasets.laser_run import run_grid
from tfg_drake.datasets.load import load_dataset
from tfg_drake.datasets.recording import Recording
from tfg_drake.geometry import se2
from tfg_drake.geometry.alignment import align
from tfg_drake.grid import gmapping
from tfg_drake.messages import FloatArray, GridMap

CARMEN = ("intel", "freiburg-079", "aces")
# Without a gyro the rover's heading is lost between scans far apart: one every so many m or rad.
ROVER, ROVER_STEP = "exp1", 0.1


def logs(folder: Path, noise: float, seed: int) -> list[Recording]:
    """Those that are there."""
    paths = [folder / "carmen" / f"{name}-corrected.log.gz" for name in CARMEN]
    found = [load_dataset(path, noise=noise, seed=seed) for path in paths if path.is_file()]
    rover = folder / "breezyslam" / f"{ROVER}.dat.gz"
    found += [load_dataset(rover)] if rover.is_file() else []
    return [one for one in found if isinstance(one, Recording)]


def errors(log: Recording, stamps: FloatArray, X_MS: FloatArray) -> str:
    """Mean and greatest distance (m) from the truth after alignment, as two cells."""
    if log.truth is None:
        return f"{'-':>8}{'-':>7}"
    p_WB = log.truth.X_WB[np.searchsorted(log.truth.stamps, stamps), :2]
    off = np.hypot(*(se2.transform(align(p_WB, X_MS[:, :2]), X_MS[:, :2]) - p_WB).T)
    return f"{off.mean():>8.2f}{off.max():>7.2f}"


def draw(path: Path, title: str, grid: GridMap, trajectory: FloatArray) -> None:
    """Write the map, dark where occupied, and the path on it."""
    h, w = grid.probability.shape
    rows, columns = (np.flatnonzero((grid.probability != 0.5).any(axis=axis)) for axis in (1, 0))
    x0, y0 = grid.origin
    figure = Figure(figsize=(10.0, 10.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(aspect="equal", xlabel="x (m)", ylabel="y (m)")
    extent = (x0, x0 + w * grid.resolution, y0, y0 + h * grid.resolution)
    axes.imshow(1.0 - grid.probability, cmap="gray", vmin=0.0, vmax=1.0, origin="lower", extent=extent)
    axes.plot(*trajectory[:, :2].T, color="#d62728", linewidth=0.8)
    axes.set_xlim(x0 + columns[0] * grid.resolution, x0 + columns[-1] * grid.resolution)
    axes.set_ylim(y0 + rows[0] * grid.resolution, y0 + rows[-1] * grid.resolution)
    axes.set_title(title, loc="left", fontsize=10)
    figure.savefig(path, dpi=120)


def main() -> None:
    """Run, draw, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, default=Path("grid_logs"))
    parser.add_argument("--particles", type=int, default=100)
    parser.add_argument("--noise", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="logs whose name contains this")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    print(f"{'log':24}{'particles':>9}{'updates':>8}{'path':>15}{'online':>15}{'odometry':>15}{'ms':>6}{'MB':>5}")
    for log in logs(options.data, options.noise, options.seed):
        if options.only not in log.name:
            continue
        config = GridConfig(particles=options.particles)
        if log.name == ROVER:
            config.update_distance = config.update_angle = ROVER_STEP
        begin = time.process_time()
        run = run_grid(log, config, options.seed)
        cpu, state, stamps = time.process_time() - begin, run.state, run.stamps
        X_OB = np.array([one.X_OB for one in log.odometry])
        X_OB = X_OB[np.searchsorted([one.stamp for one in log.odometry], stamps)]
        cells = errors(log, stamps, run.X_MS) + errors(log, stamps, run.online) + errors(log, stamps, X_OB)
        size = (state.maps.tiles.nbytes + state.maps.index.nbytes) / 1e6
        cells += f"{1e3 * cpu / max(1, state.updates):>6.0f}{size:>5.0f}"
        print(f"{log.name:24}{options.particles:>9}{state.updates:>8}{cells}", flush=True)
        draw(options.out / f"{log.name}.png", log.name, gmapping.grid_map(state, 0), run.X_MS)


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        main()
