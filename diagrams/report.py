"""What is kept of a run: its folder's map, trajectories and figure, and the summary of them."""

from __future__ import annotations

import json
import math
import resource
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tfg_drake import __version__, metrics
from tfg_drake.comparison.curves import scan_coverage
from tfg_drake.diagrams.scenario import Scenario
from tfg_drake.figure import draw_run
from tfg_drake.files import write_atomic
from tfg_drake.geometry.se2 import compose, inverse, transform
from tfg_drake.grid.frontier import OCCUPIED, classify
from tfg_drake.grid.runs import cell_sides
from tfg_drake.grid.saved_grid import save_grid
from tfg_drake.mapfile.saved_map import save_map
from tfg_drake.messages import BoolArray, FloatArray, GridMap, IntArray, MapEstimate, TfgMap
from tfg_drake.trajectory import poses_at, write_tum
from tfg_drake.world.reachability import Grid, make_grid, reachable_cells, reachable_surface, reachable_tags
from tfg_drake.world.world import World

if TYPE_CHECKING:
    from tfg_drake.diagrams.run import Departure, Mission

SCHEMA = 1
# What the scanner sees on its way is counted on every n-th of the reachable cells in x and y; so much of them is all
# but corners that a scan happens to miss.
EVERY = 4
NEARLY_ALL = 0.99
# Scans this near to where a goal's turn or glance began count, m.
IN_PLACE = 0.1


def write_report(mission: Mission, scenario: Scenario, folder: Path, name: str, world_name: str) -> dict[str, Any]:
    """Write map.npz, trajectory.tum, truth.tum, summary.json and figure.png, and return the summary.

    Raises:
        OSError: a file cannot be written.
    """
    world, tfg = mission.world, mission.tfg
    estimate = mission.map
    map_bytes = 0
    final = mission.final_map()
    if final is not None:
        saved, estimate, tfg = final
        save_map(folder / "map.npz", saved)
        map_bytes = (folder / "map.npz").stat().st_size
    else:
        (folder / "map.npz").unlink(missing_ok=True)  # of an earlier run in this folder
    if mission.grid is not None:
        save_grid(folder / "grid.npz", mission.grid)
        map_bytes = (folder / "grid.npz").stat().st_size
    else:
        (folder / "grid.npz").unlink(missing_ok=True)
    true_stamps, X_WB_true = mission.true_poses()
    stamps, X_WB = mission.estimated_poses()
    write_tum(folder / "truth.tum", true_stamps, X_WB_true)
    write_tum(folder / "trajectory.tum", stamps, X_WB)

    grid = make_grid(world)
    cells = reachable_cells(grid, world, scenario.robot.radius)
    reachable = reachable_tags(world, grid, cells, scenario.tags.range, scenario.tags.max_incidence)
    X_WD_true = poses_at(np.array([one.stamp for one in mission.departures]), true_stamps, X_WB_true)
    summary: dict[str, Any] = {
        "schema": SCHEMA,
        "version": __version__,
        "scenario": name,
        "world": world_name,
        "seed": scenario.seed,
        "method": mission.method.name,
        "outcome": mission.outcome,
        "reason": mission.reason,
        "sim_time_s": mission.end_time,
        "wall_time_s": mission.wall_time,
        "cpu_time_s": mission.cpu_time,
        "real_time_factor": mission.end_time / mission.wall_time,
        "distance_m": float(np.linalg.norm(np.diff(X_WB_true[:, :2], axis=0), axis=1).sum()),
        "stages": len(mission.stages),
        **_landmarks(world, reachable, estimate, mission.grid is None),
        **_consistency(mission.departures, compose(inverse(world.start), X_WD_true)),
        **_pose_errors(X_WB, poses_at(stamps, true_stamps, X_WB_true)),
        **_surfaces(scenario, world, grid, cells, _mapped_surfaces(world, tfg, mission.grid)),
        **_area(scenario, world, grid, cells, mission, true_stamps, X_WB_true),
        "contacts": mission.contacts,
        "min_clearance_m": mission.clearance,
        "map_variables": _variables(mission, estimate),
        "map_bytes": map_bytes,
        "estimator_cpu_s": mission.estimator_cpu,
        "planner_cpu_s": mission.planner_cpu,
        "simulator_cpu_s": mission.cpu_time - mission.estimator_cpu - mission.planner_cpu,  # all the rest
        "peak_rss_bytes": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
        "stage_ms": _spread([1e3 * seconds for stage, seconds in mission.stage_cpu.items() if stage > 0]),
    }
    summary = _null_where_not_finite(summary)
    write_atomic(folder / "summary.json", json.dumps(summary, indent=2, allow_nan=False) + "\n")
    draw_run(folder / "figure.png", _title(summary), world, estimate, tfg, mission.grid, X_WB, X_WB_true, reachable)
    return summary


def _landmarks(
    world: World, reachable: BoolArray, estimate: MapEstimate | None, maps_landmarks: bool
) -> dict[str, Any]:
    mapped = estimate.ids if estimate is not None else np.zeros(0, dtype=np.int64)
    counted = np.isin(mapped, world.tag_ids[reachable])
    figures = {
        "landmarks_present": len(world.tag_ids),
        "landmarks_reachable": int(np.count_nonzero(reachable)),
        "landmarks_mapped": int(np.count_nonzero(counted)) if maps_landmarks else None,
        "landmarks_extra": int(np.count_nonzero(~counted)) if maps_landmarks else None,
        "landmark_rmse_m": math.nan,
        "landmark_rmse_aligned_m": math.nan,
        "landmark_entropy_nats": estimate.entropy if estimate is not None else math.nan,
        "landmark_anees": math.nan,
        "landmark_nees": math.nan,
    }
    if estimate is None:
        return figures
    row_of_tag = {tag: row for row, tag in enumerate(world.tag_ids.tolist())}
    known = np.array([i for i, tag in enumerate(mapped.tolist()) if tag in row_of_tag], dtype=np.int64)
    rows = np.array([row_of_tag[mapped[i]] for i in known], dtype=np.int64)
    p_ML_true = transform(inverse(world.start), world.p_WT[rows])
    p_ML = estimate.p_ML[known]
    jointly = known[np.isin(known, estimate.local)]
    entry = np.searchsorted(estimate.local, jointly)
    entries = np.stack([2 * entry, 2 * entry + 1], axis=1).ravel()
    covariance = estimate.covariance[np.ix_(entries, entries)]
    of_joint = np.isin(known, jointly)
    return figures | {
        "landmark_rmse_m": metrics.landmark_rmse(p_ML, p_ML_true),
        "landmark_rmse_aligned_m": metrics.landmark_rmse_aligned(p_ML, p_ML_true),
        "landmark_anees": metrics.anees(p_ML - p_ML_true, estimate.landmark_covariance[known]),
        "landmark_nees": metrics.landmark_nees(p_ML[of_joint], p_ML_true[of_joint], covariance),
    }


def _consistency(departures: list[Departure], X_MD_true: FloatArray) -> dict[str, Any]:
    X_MD = np.array([one.X_MD for one in departures]).reshape(-1, 3)
    covariance = np.array([one.covariance for one in departures]).reshape(-1, 3, 3)
    return {"pose_anees": metrics.pose_anees(X_MD, X_MD_true, covariance)}


def _pose_errors(X_WB: FloatArray, X_WB_true: FloatArray) -> dict[str, Any]:
    position, heading = metrics.pose_errors(X_WB, X_WB_true)
    return {"position_error_m": metrics.statistics(position), "heading_error_rad": metrics.statistics(heading)}


def _variables(mission: Mission, estimate: MapEstimate | None) -> dict[str, int]:
    if mission.grid is not None:
        return {"cells": mission.grid.probability.size}  # of the best particle's map
    return {
        "landmarks": len(estimate.ids) if estimate is not None else 0,
        "poses": 2 * len(mission.departures),  # arrival and departure
        "calibration": 1,  # the range scale
    }


def _mapped_surfaces(world: World, tfg: TfgMap | None, grid: GridMap | None) -> FloatArray:
    """Segments (n, 4) in W of what a map takes for obstacle surfaces; of a grid, a side of every occupied cell."""
    if tfg is not None:
        p_MS = tfg.segments
    elif grid is not None:
        p_MS = cell_sides(grid, classify(grid) == OCCUPIED)
    else:
        p_MS = np.zeros((0, 4))
    return transform(world.start, p_MS.reshape(-1, 2)).reshape(-1, 4)


def _surfaces(scenario: Scenario, world: World, grid: Grid, cells: BoolArray, segments: FloatArray) -> dict[str, float]:
    surface = reachable_surface(world, grid, cells, scenario.scan.range)
    return {
        "surface_coverage": metrics.surface_coverage(surface, segments),
        "surface_phantom_m": metrics.surface_phantom(segments, world.walls),
    }


def _area(
    scenario: Scenario,
    world: World,
    grid: Grid,
    cells: BoolArray,
    mission: Mission,
    stamps: FloatArray,
    X_WB: FloatArray,
) -> dict[str, float]:
    """The share of the reachable cells that was seen, and when the scanner had seen nearly all of them.

    Seen from where the goals' turns and glances began, by a method that maps only there; by the scanner on the whole
    way by one that maps all along.
    """
    scan = scenario.scan
    thinned = np.zeros_like(cells)
    thinned[::EVERY, ::EVERY] = cells[::EVERY, ::EVERY]
    rows, share = scan_coverage(X_WB, grid.centers(thinned), world.walls, scan.range, scan.field_of_view)
    nearly = np.flatnonzero(share >= NEARLY_ALL)
    coverage = float(share[-1]) if len(share) else math.nan
    if mission.grid is None:
        looked = np.concatenate(
            [np.zeros(0, dtype=np.int64), *(_looked(one, stamps, X_WB) for one in mission.departures)]
        )
        _, share = scan_coverage(X_WB[looked], grid.centers(thinned), world.walls, scan.range, scan.field_of_view)
        coverage = float(share[-1]) if len(share) else 0.0
    return {"area_coverage": coverage, "area_seen_s": float(stamps[rows[nearly[0]]]) if len(nearly) else math.nan}


def _looked(one: Departure, stamps: FloatArray, X_WB: FloatArray) -> IntArray:
    """Rows of the true poses X_WB (n, 3) at stamps (n,) from which one goal's scans were kept."""
    rows = np.flatnonzero((stamps >= one.since) & (stamps <= one.stamp))
    return rows[np.hypot(*(X_WB[rows, :2] - X_WB[rows[:1], :2]).T) < IN_PLACE] if len(rows) else rows


def _spread(values: list[float]) -> dict[str, float]:
    if not values:
        return dict.fromkeys(("median", "p99", "max"), math.nan)
    median, p99 = np.percentile(values, [50.0, 99.0])
    return {"median": float(median), "p99": float(p99), "max": max(values)}


def _null_where_not_finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _null_where_not_finite(item) for key, item in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _title(summary: dict[str, Any]) -> str:
    def value(number: float | None, form: str) -> str:
        return "-" if number is None else form.format(number)

    landmarks = (
        ""
        if summary["landmarks_mapped"] is None
        else (
            f"{summary['landmarks_mapped']} of {summary['landmarks_reachable']} landmarks,"
            f" RMSE {value(summary['landmark_rmse_m'], '{:.3f}')} m"
            f" ({value(summary['landmark_rmse_aligned_m'], '{:.3f}')} m aligned); "
        )
    )
    return (
        f"{summary['scenario']}, {summary['method']}, seed {summary['seed']}: {summary['outcome']} after"
        f" {summary['sim_time_s']:.0f} s, {summary['distance_m']:.0f} m, {summary['stages']} stages\n{landmarks}"
        f"pose error {value(summary['position_error_m']['mean'], '{:.3f}')} m,"
        f" {value(summary['heading_error_rad']['mean'], '{:.4f}')} rad on average"
    )
