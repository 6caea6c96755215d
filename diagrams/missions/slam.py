"""Recordings mapped: a laser recording by a mission without wheels, other data by the estimator alone."""

from __future__ import annotations

import dataclasses
import logging
import math
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, EventStatus
from threadpoolctl import threadpool_limits

from tfg_drake import __version__
from tfg_drake.comparison.metrics import rmse
from tfg_drake.datasets.estimated import GRAPH_METHOD, estimated, shares
from tfg_drake.datasets.evaluation import hits, poses_between, relative_error, truth_at, wall_thickness
from tfg_drake.datasets.figure import draw_laser_map
from tfg_drake.datasets.pose_graph import PoseGraph
from tfg_drake.datasets.recording import DatasetError, Recording, as_told
from tfg_drake.datasets.relations import off_relations, read_relations, relation_errors
from tfg_drake.diagrams.mapping_explorer import MAPPING_METHODS, MappingMethod
from tfg_drake.diagrams.missions.mission import Mission
from tfg_drake.diagrams.missions.mission_runner import Progress
from tfg_drake.diagrams.missions.report import SCHEMA, write_summary
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.missions.run_folder import open_run_folder
from tfg_drake.diagrams.recorded_station import RecordedRobot, RecordedScenario, length_of, start_of
from tfg_drake.diagrams.scenario import ApplySettings, Scenario
from tfg_drake.geometry import se2
from tfg_drake.geometry.alignment import align
from tfg_drake.grid.gmapping import best_particle
from tfg_drake.hardware.recordings import load_recording
from tfg_drake.io.commit import commit
from tfg_drake.messages import FloatArray, IntArray, Observation
from tfg_drake.slam.shared import SCANNER_X, SCANNER_Y, SCANNER_YAW
from tfg_drake.slam.surface_fit import poses_by_surfaces
from tfg_drake.slam.walls import known_walls
from tfg_drake.storage.trajectory import write_tum

_log = logging.getLogger("tfg_drake.slam_command")

# Prefix of the settings of a recording's scanner.
_SCANNER = "hardware.scanner."
# Fields of the summary if there is a ground truth.
_AGAINST_TRUTH = ("relative_translation_m", "relative_rotation_rad", "robot_rmse_m", "online_rmse_m")


@dataclasses.dataclass(frozen=True)
class SlamResult:
    """The summary and the folder it is in."""

    summary: dict[str, Any]
    folder: Path


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
    cpu, wall = time.process_time(), time.monotonic()
    loaded = load(dataset)
    is_laser = isinstance(loaded, Recording) and len(loaded.scans) > 0
    if method is not None and not (is_laser and method in MAPPING_METHODS):
        methods = " or ".join(MAPPING_METHODS) + " for a laser recording, and nothing for other data sets"
        raise DatasetError(f"--method {method}: name {methods}")
    if isinstance(loaded, Recording) and is_laser:
        if not any(np.isfinite(scan.ranges).any() for scan in loaded.scans):
            raise DatasetError(f"{dataset}: no scan in it met anything; copy it again")
        mapping = method or next(iter(MAPPING_METHODS))
        return map_recording(loaded, dataset, out, mapping, say, settings, relations=relations, **mapped)
    given = {f"--relations {relations}": relations, **{f"--set {one}": one for one in settings}}
    given |= {"--page": mapped.get("cockpit"), "--meshcat": mapped.get("meshcat")}
    if wrong := next((option for option, value in given.items() if value is not None), ""):
        raise DatasetError(f"{wrong}: is for laser recordings; leave it out")
    name = dataset.name.split(".")[0] if isinstance(loaded, PoseGraph) else loaded.name
    # Small dense operations are many times slower when BLAS spreads them over a busy machine's cores.
    with threadpool_limits(limits=1), open_run_folder(out, name) as folder, folder.logging():
        for note in loaded.notes:
            _log.info("%s", note.text)
        summary = {
            "schema": SCHEMA,
            "version": __version__,
            "commit": commit(),
            "dataset": str(dataset),
            "name": name,
            **estimated(loaded, dataset, name, folder.path, say),
            "cpu_time_s": time.process_time() - cpu,
            "wall_time_s": time.monotonic() - wall,
        }
        summary = write_summary(folder.path / "summary.json", summary)
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
        ended = summary["outcome"] == "complete"
        return rows + ([] if ended else [("outcome", summary["reason"])]) + _log_rows(summary, metres)
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
        ("CPU time", f"{summary['cpu_time_s']:.1f} s, with loading and files"),
    ]
    return rows + _note_rows(summary)


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
    rows.append(("walls", f"{mapped}{metres('wall_thickness_m')} thick: mean spread of scan points about a line"))
    spent = f"{summary['cpu_time_s']:.0f} s of CPU in {summary['wall_time_s']:.0f} s"
    rows.append(("online", f"{spent}, without loading, the last solve and files"))
    return rows + _note_rows(summary)


def map_recording(
    recording: Recording,
    dataset: Path,
    out: Path | None = None,
    method: str = "walls",
    say: Callable[[str], object] = lambda _text: None,
    settings: Sequence[str] = (),
    seed: int = 0,
    relations: Path | None = None,
    interrupted: threading.Event | None = None,
    **shown: Any,
) -> SlamResult:
    """Map a laser recording: a mission without wheels, whose station is the recording.

    It leaves what any run leaves, with the body's way smoothed by the whole recording in trajectory.tum, as it was
    estimated at the time in online.tum, and what the scans met in figure.png; both by the recording's stamps.

    Args:
        recording: what is believed of it. dataset: its path.
        out, interrupted, shown: as out_dir and others of `run_mission`.
        method: one of MAPPING_METHODS.
        say: is told how far the work is.
        settings: of the scenario, such as "grid.particles=50".
        seed: of the filter that maps a grid.
        relations: a file of relations between its poses, to be held against them.

    Raises:
        ScenarioError: a setting cannot be used.
        DatasetError: the relations cannot.
        OSError: the folder cannot be written at the beginning, or another run is at work in it.
        EstimateLost: the estimate became nonsense; what there was before is kept.
    """
    scenario = RecordedScenario(recording, ApplySettings(Scenario(seed=seed), settings))
    at, told = np.array([scan.stamp for scan in recording.scans]), None
    if relations is not None:
        told = read_relations(relations)
        off_relations(at, np.zeros((len(at), 3)), told, recording.told_stamps)  # Errors are raised before the mapping.
    way, start, end = WayKeeper(), start_of(recording), length_of(recording)
    ended = (interrupted or threading.Event()).is_set

    def tell(text: str) -> None:
        if not ended():
            say(text)

    tell_share = shares(tell, "online")

    def on_progress(progress: Progress) -> None:
        tell(progress.line) if progress.outcome else tell_share(min(progress.time / max(end, 1e-9), 1.0))

    result = run_mission(
        scenario,
        method=MappingMethod(method, end),
        robot=RecordedRobot(recording),
        name=recording.name,
        max_time=math.inf,
        out_dir=out,
        on_progress=on_progress,
        interrupted=interrupted,
        monitor=way.monitor,
        notes=recording.notes,
        **shown,
    )
    mission, folder = result.mission, result.folder
    if mission.failure is not None:
        raise mission.failure
    truth = recording.truth
    stamps, X_MB, X_BS = way.poses(mission)
    online_stamps, online = mission.estimated_poses()
    tell("solving all poses, measuring and drawing the map")
    X_MB, state = poses_between(recording, stamps + start, X_MB), mission.estimator_state()
    if state is not None and state.map is not None:
        X_MB, _ = poses_by_surfaces(state.graph, recording.scans, X_MB)
    figures = dict.fromkeys(_AGAINST_TRUTH)
    if truth is not None:
        X_WB = truth_at(truth, at)
        off = relative_error(X_WB, X_MB)
        of_online = poses_between(recording, online_stamps + start, online)
        figures = dict(zip(_AGAINST_TRUTH, (*off, _rmse(X_WB, X_MB), _rmse(X_WB, of_online)), strict=True))
    if told is not None:
        # The scanner's pose by its estimated mount, times the mount that the log assumes.
        X_MS = se2.compose(se2.compose(X_MB, X_BS), recording.X_BS)
        figures["relations"] = relation_errors(at, X_MS, told, recording.told_stamps)
    met = hits(recording.scans, se2.compose(X_MB, X_BS))
    walls = np.empty((0, 2, 2))
    if state is not None and state.map is not None:
        _, walls, _ = known_walls(state.map)
    for note in result.summary["notes"][len(recording.notes) :]:
        if note["time_s"] is not None:
            note["time_s"] += start  # The mission's time is 0 at the recording's first message.
    summary = {
        **result.summary,
        "dataset": str(dataset),
        "name": recording.name,
        "method": method,
        "explored_s": None,
        "scans": len(recording.scans),
        "way_m": float(np.hypot(*np.diff(X_MB[:, :2], axis=0).T).sum()),
        **figures,
        "wall_thickness_m": wall_thickness(met),
        "walls_mapped": None if state is None else len(walls),
        "online_cpu_s": mission.estimator_cpu,
    }
    write_tum(folder / "trajectory.tum", as_told(at, recording.told_stamps), X_MB)
    write_tum(folder / "online.tum", online_stamps + start, online)
    true_path = np.empty((0, 2)) if truth is None else truth_at(truth, at)[:, :2]
    if truth is not None:
        true_path = se2.transform(align(X_MB[:, :2], true_path), true_path)
    draw_laser_map(folder / "figure.png", f"{recording.name}: {method}", met, walls, X_MB[:, :2], true_path)
    return SlamResult(write_summary(folder / "summary.json", summary), folder)


def _rmse(X_WB: FloatArray, X_MB: FloatArray) -> float:
    """RMSE, m, of poses (n, 3) after their alignment."""
    return rmse(se2.transform(align(X_WB[:, :2], X_MB[:, :2]), X_MB[:, :2]) - X_WB[:, :2])


class WayKeeper:
    """Keeps what a mission's views tell of the way, for it to be known better at the end than it was on the way."""

    def __init__(self) -> None:
        self._seen: list[Observation] = []
        self._put_in: list[tuple[int, float, FloatArray, IntArray]] = []

    def monitor(self, mission: Mission) -> Callable[[Context], EventStatus]:
        """A function that looks on after every step."""

        def look(context: Context) -> EventStatus:
            now = mission.explorer.GetMyContextFromRoot(context)
            if mission.explorer.HasOutputPort("filter"):
                state = mission.explorer.GetOutputPort("filter").Eval(now)
                if state.updates > (self._put_in[-1][0] if self._put_in else 0):
                    self._put_in.append((state.updates, state.stamp, state.X_MU, state.parents))
                    self._best = best_particle(state)
            else:
                estimate = mission.explorer.GetOutputPort("landmarks").Eval(now)
                if estimate.stage > len(self._seen):
                    self._seen.append(estimate.observation)
            return EventStatus.DidNothing()

        return look

    def poses(self, mission: Mission) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Stamps (n,), s, the body's poses then X_MB (n, 3), and where the scanner sits X_BS (3,): as a mission that
        has ended knows them."""
        if self._put_in:
            row, way = self._best, []
            for _, _, X_MU, parents in reversed(self._put_in):
                way.append(X_MU[row])
                row = int(parents[row])
            return np.array([stamp for _, stamp, _, _ in self._put_in]), np.array(way[::-1]), np.zeros(3)
        if mission.landmarks is None or not self._seen:
            stamps, X_MB = mission.estimated_poses()
            return (stamps, X_MB, np.zeros(3)) if len(stamps) else (np.zeros(1), np.zeros((1, 3)), np.zeros(3))
        starts = mission.landmarks.X_MA
        stamps, first = np.unique(np.concatenate([one.stamps for one in self._seen]), return_index=True)
        way_of_views = [
            se2.compose(X_MA, one.X_AB) for X_MA, one in zip(starts[-len(self._seen) :], self._seen, strict=True)
        ]
        return stamps, np.concatenate(way_of_views)[first], mission.shared.mean[[SCANNER_X, SCANNER_Y, SCANNER_YAW]]
