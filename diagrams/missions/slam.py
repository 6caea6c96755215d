"""The estimator alone on a recorded data set, and what is kept of it."""

from __future__ import annotations

import json
import logging
import math
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from tfg_drake import __version__
from tfg_drake.datasets.batch_smoother import smooth
from tfg_drake.datasets.evaluation import landmark_error, robot_error
from tfg_drake.datasets.figure import draw_slam
from tfg_drake.datasets.g2o import write_g2o
from tfg_drake.datasets.online import run_online
from tfg_drake.datasets.pose_graph import PoseGraph, half_chi_square, solve_pose_graph
from tfg_drake.datasets.recording import DatasetError, GroundTruth, Recording
from tfg_drake.diagrams.mapping_explorer import MAPPING_METHODS
from tfg_drake.diagrams.missions.map_recording import SlamResult, map_recording
from tfg_drake.diagrams.missions.run_folder import open_run_folder
from tfg_drake.diagrams.scenario import ApplySettings, Scenario
from tfg_drake.geometry.se2 import transform
from tfg_drake.hardware.recordings import load_recording
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

_log = logging.getLogger("tfg_drake.slam_command")

SCHEMA = 1
# What a graph without a robot's way in it is solved by.
GRAPH_METHOD = "batch"
# Settings of a recording's scanner begin so.
_SCANNER = "hardware.scanner."
# Called with the part of the work ("online" or "batch") and the share of it done, 0 to 1.
OnProgress = Callable[[str, float], None]


def run_slam(
    dataset: Path,
    out: Path | None = None,
    say: Callable[[str], object] = lambda _text: None,
    load: Callable[[Path], Recording | PoseGraph] = load_recording,
    method: str | None = None,
    relations: Path | None = None,
    settings: Sequence[str] = (),
    **mapped: Any,
) -> SlamResult:
    """Run the estimator on a data set, online and then smoothed over all data, and write DIR/summary.json, figure.png,
    log.txt, trajectories and the map with its covariances, map.npz and landmarks.csv; of a g2o graph, which is only
    solved, solved.g2o. A laser recording is a mission, see `map_recording`.

    Args:
        dataset: its path.
        out: the folder, made if missing; runs/<time>-<data set> by default.
        say: is told how far the work is; what it raises ends that.
        load: reads the data set.
        method: of a laser recording, one of MAPPING_METHODS; None: the first.
        relations: of a laser recording, a file of relations between its poses, to be held against it.
        settings: of a laser recording's scenario.
        mapped: of a laser recording, more arguments of `map_recording`.

    Raises:
        DatasetError: the data set cannot be used; nothing is written.
        OSError: the folder cannot be written, or another run is at work in it.
    """
    report = lambda part, share: say(f"{part} {percent(share, 0):3.0f} %")  # noqa: E731
    cpu, wall = time.process_time(), time.monotonic()
    loaded = load(dataset)
    is_laser = isinstance(loaded, Recording) and len(loaded.scans) > 0
    if method is not None and not (is_laser and method in MAPPING_METHODS):
        methods = " or ".join(MAPPING_METHODS) + " for a laser recording, and nothing for other data sets"
        raise DatasetError(f"--method {method}: name {methods}")
    if isinstance(loaded, Recording) and is_laser:
        if not any(np.isfinite(scan.ranges).any() for scan in loaded.scans):
            raise DatasetError(f"{dataset}: no scan in it met anything; copy it again")
        online = lambda share: report("online", share)  # noqa: E731
        mapping = method or next(iter(MAPPING_METHODS))
        return map_recording(loaded, dataset, out, mapping, online, settings, relations=relations, **mapped)
    if relations is not None or settings:
        option = f"--relations {relations}" if relations is not None else f"--set {settings[0]}"
        raise DatasetError(f"{option}: is for laser recordings; leave it out")
    name = dataset.name.split(".")[0] if isinstance(loaded, PoseGraph) else loaded.name
    # Small dense operations are many times slower when BLAS spreads them over a busy machine's cores.
    with threadpool_limits(limits=1), open_run_folder(out, name) as folder, folder.logging():
        for note in loaded.notes:
            _log.info("%s", note.text)
        if isinstance(loaded, PoseGraph):
            figures = _solve_graph(loaded, dataset, name, folder.path, report)
        else:
            figures = _run_recording(loaded, folder.path, report)
        summary = {
            "schema": SCHEMA,
            "version": __version__,
            "dataset": str(dataset),
            "name": name,
            **figures,
            "cpu_time_s": time.process_time() - cpu,
            "wall_time_s": time.monotonic() - wall,
        }
        write_atomic(folder.path / "summary.json", json.dumps(summary, indent=2) + "\n")
    return SlamResult(summary, folder.path)


def scanner_settings(settings: Sequence[str]) -> tuple[dict[str, Any], list[str]]:
    """Splits settings into those of a recording's scanner, `hardware.scanner.KEY=VALUE`, by their keys, and the others.
    Raises ScenarioError."""
    said = [one for one in settings if one.startswith(_SCANNER)]
    scanner = ApplySettings(Scenario(), said).hardware.scanner
    keys = (one.removeprefix(_SCANNER).partition("=")[0] for one in said)
    return {key: getattr(scanner, key) for key in keys}, [one for one in settings if one not in said]


def table_rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """The closing table: name and value, "-" where there is none."""

    def metres(key: str) -> str:
        return "-" if summary[key] is None else f"{summary[key]:.3f} m"

    rows = [("data set", f"{summary['name']}, {summary['method']}")]
    if summary["method"] in MAPPING_METHODS:
        return rows + _log_rows(summary, metres)
    used, rejected = summary["measurements_used"], summary["measurements_rejected"]
    mapped = f"{summary['landmarks_mapped']} mapped"
    if summary["method"] == GRAPH_METHOD:  # It has no ground truth.
        rows.append(("landmarks", mapped))
    else:
        robot = (
            f"RMSE {metres('robot_rmse_m')} smoothed, {metres('online_rmse_m')} online where landmarks were in view,"
        )
        rows.append(("robot", f"{robot} {metres('online_blind_too_rmse_m')} with the blind stretches"))
        errors = f"RMSE {metres('landmark_rmse_m')} smoothed, {metres('online_landmark_rmse_m')} online"
        rows.append(("landmarks", f"{mapped}, {errors}"))
    if summary["landmarks_misfit"]:
        rows.append(("", f"RMSE {metres('landmark_rmse_without_misfits_m')} without those far from the given truth"))
    rows += [
        ("measurements", f"{used} used, {rejected} rejected, final error {summary['final_error']:.6g}"),
        ("CPU time", f"{summary['cpu_time_s']:.1f} s"),
    ]
    return rows + _note_rows(summary)


def _told(notes: Sequence[Note]) -> list[dict[str, Any]]:
    return [dict(vars(note)) for note in notes]


def _note_rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    at = lambda time: "" if time is None else f"{time:.1f} s: "  # noqa: E731
    return [("note", at(note["time_s"]) + note["text"]) for note in summary["notes"]]


def _log_rows(summary: dict[str, Any], metres: Callable[[str], str]) -> list[tuple[str, str]]:
    rows = [("scans", f"{summary['scans']} on {summary['way_m']:.0f} m of way")]
    if summary["relative_translation_m"] is not None:
        for of, unit in (("translation", "m"), ("rotation", "rad")):
            mean, worst = summary[f"relative_{of}_{unit}"].values()
            rows.append((of, f"{mean:.4f} {unit} between two scans, mean; {worst:.4f} {unit} of the worst tenth"))
        rows.append(("robot", f"RMSE {metres('robot_rmse_m')}, {metres('online_rmse_m')} online"))
    if relations := summary.get("relations"):
        off, turned = relations["translation_m"], relations["rotation_deg"]
        errors = f"{off['mean']:.4f} ± {off['std']:.4f} m, {turned['mean']:.3f} ± {turned['std']:.3f}°"
        rows.append(("relations", f"{relations['count']} checked by hand, off by {errors}"))
    mapped = "" if summary["walls_mapped"] is None else f"{summary['walls_mapped']} mapped, "
    rows.append(("walls", f"{mapped}hits {metres('wall_thickness_m')} off them, mean"))
    rows.append(("CPU time", f"{summary['cpu_time_s']:.1f} s"))
    return rows + _note_rows(summary)


def _run_recording(recording: Recording, folder: Path, report: OnProgress) -> dict[str, Any]:
    start = time.process_time()
    online = run_online(recording, on_progress=lambda share: report("online", share))
    middle = time.process_time()
    smoothed = smooth(recording.odometry, recording.detections, recording.model, lambda share: report("batch", share))
    end = time.process_time()
    truth = recording.truth or _no_truth()
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
    return {
        "method": "online+batch",
        "outcome": "complete",
        "robot_rmse_m": _number(robot.rmse),
        "online_rmse_m": _number(online_robot.rmse),
        "online_blind_too_rmse_m": _number(blind_too.rmse),
        "landmark_rmse_m": _number(landmarks.rmse),
        "landmark_rmse_without_misfits_m": _number(landmarks.rmse_without),
        "online_landmark_rmse_m": _number(online_landmarks.rmse) if online_landmarks is not None else None,
        "landmarks_mapped": len(smoothed.ids),
        "landmarks_misfit": landmarks.misfit_ids.tolist(),
        "final_error": smoothed.half_chi_square,
        "measurements_used": smoothed.used,
        "measurements_rejected": smoothed.rejected,
        "calibration": smoothed.calibration.tolist(),
        "online_cpu_s": middle - start,
        "batch_cpu_s": end - middle,
        "notes": _told([*recording.notes, *(Note("truth", None, text) for text in landmarks.notes)]),
    }


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


def _solve_graph(graph: PoseGraph, dataset: Path, name: str, folder: Path, report: OnProgress) -> dict[str, Any]:
    start = time.process_time()
    try:
        solved = solve_pose_graph(graph, lambda share: report("batch", share))
    except ValueError as error:
        raise DatasetError(f"{dataset}: {error}; add an edge or the vertices' values") from error
    write_g2o(folder / "solved.g2o", solved)
    truth, way = _no_truth(), {"smoothed": solved.X_MB[:, :2]}
    draw_slam(folder / "figure.png", name, way, solved.landmark_ids, solved.p_ML, truth, truth.ids)
    return {
        "method": GRAPH_METHOD,
        "outcome": "complete",
        "robot_rmse_m": None,
        "online_rmse_m": None,
        "online_blind_too_rmse_m": None,
        "landmark_rmse_m": None,
        "landmark_rmse_without_misfits_m": None,
        "online_landmark_rmse_m": None,
        "landmarks_mapped": len(solved.landmark_ids),
        "landmarks_misfit": [],
        "final_error": half_chi_square(solved),
        "measurements_used": len(graph.edges) + len(graph.sightings),
        "measurements_rejected": 0,
        "calibration": None,
        "online_cpu_s": None,
        "batch_cpu_s": time.process_time() - start,
        "notes": _told(graph.notes),
    }


def _no_truth() -> GroundTruth:
    return GroundTruth(np.empty(0), np.empty((0, 3)), np.empty(0, dtype=np.int64), np.empty((0, 2)))


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
