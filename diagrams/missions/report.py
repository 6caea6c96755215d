"""Writes a run's folder: map, trajectories and figure, and the summary of them."""

from __future__ import annotations

import json
import math
import resource
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tfg_drake import __version__
from tfg_drake.diagrams.missions.errors import KnownWorld, driven, pose_errors
from tfg_drake.diagrams.missions.mission import Mission
from tfg_drake.diagrams.missions.run_folder import RunFolder
from tfg_drake.diagrams.missions.summary_words import title
from tfg_drake.geometry.se2 import transform
from tfg_drake.grid.saved_grid import save_grid
from tfg_drake.io.commit import commit
from tfg_drake.io.files import write_atomic
from tfg_drake.mapfile.changes import map_changes
from tfg_drake.mapfile.saved_map import SavedMap, load_map, save_map
from tfg_drake.messages import BoolArray, GridMap, MapEstimate, Roadmap, TfgMap
from tfg_drake.mission.manual_drive import drive_csv
from tfg_drake.planning.mission_end import UNSEEN
from tfg_drake.planning.openings import NOT_WORTH, WHY, find_openings, with_seen_before
from tfg_drake.planning.undiscovered import AREAS, undiscovered
from tfg_drake.slam.walls import least_known
from tfg_drake.storage.trajectory import write_tum

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCHEMA = 1
# Names of the shared parameters in the summary, in their order.
CALIBRATED = (
    "odometry_distance_scale",
    "odometry_gyro_bias_rad_s",
    "odometry_gyro_scale",
    "camera_yaw_rad",
    "camera_ahead_m",
    "camera_left_m",
    "camera_clock_offset_s",
    "range_scale",
    "scanner_yaw_rad",
    "scanner_ahead_m",
    "scanner_left_m",
    "scanner_clock_offset_s",
    "scanner_sweep_s_per_rad",
)
# Names of the learnt noise parameters: random walks, m per root m and rad per root s; ratio of the tags' deviations to
# the data sheet's; correlation of a tag's noise from frame to frame; ratio of the deviations of looks to their rays'.
NOISE = ("odometry_distance_noise", "odometry_gyro_noise", "tag_noise", "tag_noise_correlation", "wall_look_noise")


def write_report(mission: Mission, folder: RunFolder) -> dict[str, Any]:
    """Write map.npz or grid.npz, summary.json, trajectory.tum, truth.tum and figure.png, and return the summary.

    What would take the world or the truth is null where that is not known, and there is no truth.tum. The distance is
    that of the estimate then, and every landmark that is not doubtful counts as mapped. A file that cannot be written
    is told to the folder, and the others are written all the same.
    """
    saved, estimate, tfg = mission.final_map() or (None, mission.map, mission.tfg)
    write_map(folder, mission.grid, saved)
    if (pressed := mission.pressed()) is not None:
        folder.attempt("keys.csv", lambda path: write_atomic(path, drive_csv(pressed)))
    stamps, X_WB = mission.estimated_poses()
    true_poses = mission.true_poses()
    files = [path for name in ("map.npz", "grid.npz") if (path := folder.path / name).exists()]
    known_map = None
    if saved is not None and mission.scenario.explorer.known_map:
        known_map = load_map(Path(mission.scenario.explorer.known_map))
    has_found = known_map is not None and math.isfinite(mission.placed_since)
    size = sum(path.stat().st_size for path in files)
    summary = _known_to_any(mission, estimate, size, known_map.tfg if known_map is not None and has_found else None)
    if saved is not None and (least := least_known(saved.graph)) is not None:
        summary["least_known"] = {"deviation_m": least[0], "p_WL": transform(saved.X_WM, least[1][None])[0].tolist()}
    if saved is not None and known_map is not None:
        summary["changes"] = {"found_at_s": mission.placed_since, "places": mission.places}
        if has_found:
            summary["changes"] |= map_changes(known_map, saved)
    reachable = np.zeros(0, dtype=np.bool_)
    world = mission.world_then
    if world is not None:
        newest = None if true_poses is None or not len(true_poses[1]) else true_poses[1][-1]
        known = KnownWorld(world, mission.scenario, newest)
        reachable = known.reachable
        summary |= known.map_figures(mission, estimate, tfg)
        unreachable = ", ".join(map(str, world.tag_ids[~reachable].tolist()))
        if unreachable and mission.outcome in ("complete", "stuck", "apart"):
            summary["reason"] += f" The robot cannot reach any place that shows these tags: {unreachable}."
        if true_poses is not None:
            summary |= known.way_figures(mission, stamps, X_WB, *true_poses)
    if mission.truth is not None:
        truth = mission.truth
        summary |= {
            "contacts": truth.contacts,
            "contacts_received": truth.contacts_received,
            "min_clearance_m": truth.clearance,
        }
    summary = null_where_not_finite(summary)
    folder.attempt("summary.json", lambda path: write_summary(path, summary))
    folder.attempt("trajectory.tum", lambda path: write_tum(path, stamps, X_WB))
    if true_poses is not None:
        folder.attempt("truth.tum", lambda path: write_tum(path, *true_poses))
    folder.attempt("figure.png", lambda path: _draw(path, mission, title(summary), estimate, tfg, reachable))
    return summary


def write_summary(path: Path, summary: dict[str, Any]) -> dict[str, Any]:
    """Writes summary.json, and returns what is in it: what is not finite is null. Raises OSError."""
    summary = null_where_not_finite(summary)
    write_atomic(path, json.dumps(summary, indent=2, allow_nan=False) + "\n")
    return summary


def figure_of(
    mission: Mission,
    title: str,
    estimate: MapEstimate | None,
    tfg: TfgMap | None,
    reachable: BoolArray | None = None,
) -> Figure:
    """A mission's building, a map of it and the way. reachable: (t,) of the world's tags, where that is known."""
    from tfg_drake.pictures.figure import run_figure  # Its libraries stay out of a mission's memory.

    X_WB, true_poses = mission.estimated_poses()[1], mission.true_poses()
    X_WB_true = np.zeros((0, 3)) if true_poses is None else true_poses[1]
    seen = (mission.world_then, estimate, tfg, mission.grid, X_WB, X_WB_true, reachable, mission.X_WM)
    return run_figure(title, *seen, mission.landmarks)


def write_map(folder: RunFolder, grid: GridMap | None, saved: SavedMap | None, *, final: bool = True) -> None:
    """Writes grid.npz, or map.npz, as far as there is one. final: nothing comes after it."""
    if grid is not None:
        folder.attempt("grid.npz", lambda path: save_grid(path, grid, final=final))
    elif saved is not None:
        folder.attempt("map.npz", lambda path: save_map(path, saved, final=final))


def _known_to_any(
    mission: Mission, estimate: MapEstimate | None, map_bytes: int, before: TfgMap | None
) -> dict[str, Any]:
    """Every field of the summary in its order, those that take the world or the truth null. before: as of
    `_left_open`."""
    # Mask of the landmarks that are not doubtful, and ids of the tags whose place is doubtful; a grid has none.
    none: Any = np.zeros(0, dtype=np.int64)
    sure, doubtful = (none, none) if estimate is None else (~estimate.is_doubtful, estimate.doubtful)
    return {
        "schema": SCHEMA,
        "version": __version__,
        "commit": commit(),
        "scenario": mission.request.name,
        "world": mission.request.world,
        "seed": mission.scenario.seed,
        "method": mission.method.name,
        "outcome": mission.outcome,
        "reason": mission.reason,
        "sim_time_s": mission.end_time,
        "resumed_at_s": mission.resumed,
        "notes": [dict(vars(note)) for note in mission.notes],
        "wall_time_s": mission.wall_time,
        "cpu_time_s": mission.cpu_time,
        "real_time_factor": mission.end_time / mission.wall_time,
        "distance_m": driven(*mission.estimated_poses(lost=True)),
        "stages": len(mission.stages),
        **_null("landmarks_present", "landmarks_reachable"),
        "landmarks_mapped": None if mission.grid is not None else int(np.count_nonzero(sure)),
        "landmarks_doubtful": None if mission.grid is not None else doubtful.tolist(),
        "landmarks_extra": None,
        "walls_mapped": None if mission.grid is not None else mission.walls,
        **_null("landmark_rmse_m", "landmark_error_max_m", "landmark_rmse_aligned_m"),
        **_null("least_known", "changes"),
        "landmark_entropy_nats": estimate.entropy if estimate is not None else math.nan,
        **_null("landmark_anees", "landmark_nees", "pose_anees", "online_pose_anees"),
        **pose_errors(np.zeros((0, 3)), np.zeros((0, 3))),
        **_null("surface_coverage", "surface_coverage_5cm", "surface_phantom_m", "area_coverage", "area_seen_s"),
        "explored_s": mission.explored_time,
        "open_edges": mission.open_edges(),
        **_left_open(mission, before),
        **_null("contacts", "contacts_received", "min_clearance_m"),
        "map_variables": _variables(mission),
        "map_bytes": map_bytes,
        "calibration": _calibration(mission, estimate),
        "estimator_cpu_s": mission.estimator_cpu,
        "planner_cpu_s": mission.planner_cpu,
        "simulator_cpu_s": mission.cpu_time - mission.estimator_cpu - mission.planner_cpu,  # all the rest
        "peak_rss_bytes": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
        "stage_ms": _spread([1e3 * seconds for stage, seconds in mission.stage_cpu.items() if stage > 0]),
    }


def _null(*fields: str) -> dict[str, Any]:
    """Fields that take the world, the truth or a map: null where these are not known."""
    return dict.fromkeys(fields)


def _left_open(mission: Mission, before: TfgMap | None) -> dict[str, Any]:
    """The summary's `openings`, those with the most unknown behind them first, and `undiscovered`; both null for a
    method without a TFG. before: what an earlier session has seen, in the same frame M."""
    tfg, pose, roadmap = mission.tfg, mission.pose, None
    if tfg is not None and tfg.stage:
        roadmap = mission.look_for("roadmap", Roadmap)
    if tfg is None or roadmap is None or pose is None:
        return {"openings": None, "undiscovered": None}
    tfg = tfg if before is None else with_seen_before(tfg, before)
    found = find_openings(tfg, roadmap, pose.X_MB[:2], mission.scenario.robot, mission.scenario.view)
    why = [UNSEEN if row == NOT_WORTH and mission.outcome != "complete" else WHY[row] for row in found.why]
    places, missing = transform(mission.X_WM, found.p).round(2), found.missing.round(2)
    openings = [
        {
            "p_WO": places[i].tolist(),
            "width_m": round(float(found.width[i]), 2),
            "why": why[i],
            "missing_m": float(missing[i]) or None,
            "unknown_m2": round(float(found.unknown[i]), 1),
        }
        for i in np.lexsort((-found.width, -found.unknown))
    ]
    probability = undiscovered(found).round(4).tolist()
    rooms = [{"area_m2": area, "probability": p} for area, p in zip(AREAS, probability, strict=True)]
    return {"openings": openings, "undiscovered": rooms}


def _calibration(mission: Mission, estimate: MapEstimate | None) -> dict[str, Any]:
    """The shared parameters and the noise with their deviations, and the deviation of the tags' constant errors."""
    errors, shared = np.zeros(2) if estimate is None else estimate.tag_error, mission.shared
    noise, deviation = mission.noise.values
    found = zip((*CALIBRATED, *NOISE), np.append(shared.mean, noise), np.append(shared.sigma, deviation), strict=True)
    return {
        **{name: {"value": float(value), "deviation": float(sigma)} for name, value, sigma in found},
        "tag_range_error_m": float(errors[0]),
        "tag_bearing_error_rad": float(errors[1]),
    }


def _draw(path: Path, *shown: Any) -> None:
    from tfg_drake.pictures.figure_file import write_figure

    write_figure(path, figure_of(*shown))


def _variables(mission: Mission) -> dict[str, int] | None:
    if mission.grid is not None:
        return {"cells": mission.grid.probability.size}  # of the best particle's map
    state = mission.estimator_state()
    return None if state is None else state.graph.unknowns


def _spread(values: list[float]) -> dict[str, float]:
    if not values:
        return dict.fromkeys(("median", "p99", "max"), math.nan)
    median, p99 = np.percentile(values, [50.0, 99.0])
    return {"median": float(median), "p99": float(p99), "max": max(values)}


def null_where_not_finite(value: Any) -> Any:
    """A value, or a dict of such; what is not finite is None."""
    if isinstance(value, dict):
        return {key: null_where_not_finite(item) for key, item in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value
