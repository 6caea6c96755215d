"""A data set without scans, estimated and written into a folder: a recording online and over all data, or a graph."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tfg_drake.datasets.batch_smoother import smooth
from tfg_drake.datasets.evaluation import landmark_error, robot_error
from tfg_drake.datasets.figure import draw_slam
from tfg_drake.datasets.g2o import write_g2o
from tfg_drake.datasets.online import run_online
from tfg_drake.datasets.pose_graph import PoseGraph, half_chi_square, solve_pose_graph
from tfg_drake.datasets.recording import DatasetError, GroundTruth, OnProgress, Recording
from tfg_drake.geometry.se2 import transform
from tfg_drake.io.files import write_atomic
from tfg_drake.mapfile.landmark_table import landmark_csv
from tfg_drake.mapfile.saved_map import save_map, saved_map
from tfg_drake.messages import is_tag, replace
from tfg_drake.notes import Note
from tfg_drake.percent import percent
from tfg_drake.slam.estimator import finished_map
from tfg_drake.slam.estimator_state import EstimatorState
from tfg_drake.storage.trajectory import write_tum
from tfg_drake.table import empty
from tfg_drake.tfg.feature_graph import TfgGraph
from tfg_drake.tfg.graph import empty_map

# What a graph without a robot's way in it is solved by.
GRAPH_METHOD = "batch"
# Figures that a graph has none of.
_OF_RUNS: tuple[str, ...] = ("robot_rmse_m", "online_rmse_m", "online_blind_too_rmse_m", "landmark_rmse_m")
_OF_RUNS += ("landmark_rmse_without_misfits_m", "online_landmark_rmse_m", "calibration", "online_cpu_s")


def estimated(
    loaded: Recording | PoseGraph, dataset: Path, name: str, folder: Path, say: Callable[[str], object]
) -> dict[str, Any]:
    """The figures of a data set, whose trajectories, map and figure are written into a folder.

    dataset: its path. say: is told how far the work is. Raises DatasetError where a graph cannot be solved, OSError.
    """
    notes: Sequence[Note] = loaded.notes
    if isinstance(loaded, PoseGraph):
        found = _solve_graph(loaded, dataset, name, folder, say)
    else:
        found, notes = _run_recording(loaded, folder, say)
    return {"outcome": "complete", **found, "notes": [dict(vars(note)) for note in notes]}


def shares(say: Callable[[str], object], part: str) -> OnProgress:
    """Says the share that is done of a part of the work, "online" or "batch"."""

    def report(share: float) -> None:
        say(f"{part} {percent(share, 0):3.0f} %")

    return report


def _run_recording(
    recording: Recording, folder: Path, say: Callable[[str], object]
) -> tuple[dict[str, Any], Sequence[Note]]:
    start = time.process_time()
    online = run_online(recording, on_progress=shares(say, "online"))
    middle = time.process_time()
    way, report = (online.stamps, online.X_MB), shares(say, "batch")
    smoothed = smooth(recording.odometry, recording.detections, recording.model, report, way)
    end = time.process_time()
    truth = recording.truth or empty(GroundTruth)
    robot = robot_error(truth, smoothed.stamps, smoothed.X_MB)
    online_robot = robot_error(truth, online.stamps[online.seen], online.X_MB[online.seen])
    blind_too = robot_error(truth, online.stamps, online.X_MB)
    landmarks = landmark_error(truth, smoothed.ids, smoothed.p_ML)
    online_landmarks = landmark_error(truth, online.map.ids, online.map.p_ML) if online.map is not None else None

    write_tum(folder / "trajectory.tum", smoothed.stamps, smoothed.X_MB)
    write_tum(folder / "online.tum", online.stamps, online.X_MB)
    _keep_map(folder, online.state)
    # Without a truth for one of the two the other's alignment serves both.
    X_landmarks = landmarks.X_WM if len(landmarks.ids) else robot.X_WM
    X_robot = robot.X_WM if robot.compared else landmarks.X_WM
    X_online = online_robot.X_WM if online_robot.compared else X_robot
    draw_slam(
        folder / "figure.png",
        f"{recording.name}: each aligned to the truth" if recording.truth is not None else recording.name,
        {"smoothed": transform(X_robot, smoothed.X_MB[:, :2]), "online": transform(X_online, online.X_MB[:, :2])},
        smoothed.ids,
        transform(X_landmarks, smoothed.p_ML),
        truth,
        landmarks.misfit_ids,
    )
    figures = {
        "method": "online+batch",
        "robot_rmse_m": robot.rmse,
        "online_rmse_m": online_robot.rmse,
        "online_blind_too_rmse_m": blind_too.rmse,
        "landmark_rmse_m": landmarks.rmse,
        "landmark_rmse_without_misfits_m": landmarks.rmse_without,
        "online_landmark_rmse_m": online_landmarks.rmse if online_landmarks is not None else None,
        "landmarks_mapped": len(smoothed.ids),
        "landmarks_misfit": landmarks.misfit_ids.tolist(),
        "final_error": smoothed.half_chi_square,
        "measurements_used": smoothed.used,
        "measurements_rejected": smoothed.rejected,
        "calibration": smoothed.calibration.tolist(),
        "online_cpu_s": middle - start,
        "batch_cpu_s": end - middle,
    }
    return figures, [*recording.notes, *(Note("truth", None, text) for text in landmarks.notes)]


def _keep_map(folder: Path, state: EstimatorState) -> None:
    """Write the online estimator's map, if it has one, without free space and surfaces: nobody built a TFG."""
    state = finished_map(state)
    estimate = state.map
    if estimate is None:
        return
    stage, stars = estimate.stage, np.zeros(estimate.stage + 1, dtype=np.int64)
    tfg = replace(
        empty_map(),
        stage=stage,
        facing=np.zeros((np.count_nonzero(is_tag(estimate.ids)), 2)),
        star_offsets=stars,
        star_centers=estimate.X_MA[:, :2],
    )
    saved = saved_map(np.zeros(3), state, empty(TfgGraph, stage=stage, star_offsets=stars), tfg)
    save_map(folder / "map.npz", saved)
    write_atomic(folder / "landmarks.csv", landmark_csv(saved))


def _solve_graph(
    graph: PoseGraph, dataset: Path, name: str, folder: Path, say: Callable[[str], object]
) -> dict[str, Any]:
    start = time.process_time()
    try:
        solved = solve_pose_graph(graph, shares(say, "batch"))
    except ValueError as error:
        raise DatasetError(f"{dataset}: {error}; add an edge or the vertices' values") from error
    write_g2o(folder / "solved.g2o", solved)
    truth, way = empty(GroundTruth), {"smoothed": solved.X_MB[:, :2]}
    draw_slam(folder / "figure.png", name, way, solved.landmark_ids, solved.p_ML, truth, truth.ids)
    return {
        "method": GRAPH_METHOD,
        **dict.fromkeys(_OF_RUNS),
        "landmarks_mapped": len(solved.landmark_ids),
        "landmarks_misfit": [],
        "final_error": half_chi_square(solved),
        "measurements_used": len(graph.edges) + len(graph.sightings),
        "measurements_rejected": 0,
        "batch_cpu_s": time.process_time() - start,
    }
