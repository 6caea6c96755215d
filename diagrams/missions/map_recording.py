"""A laser recording mapped: the mission whose station it is, and what is kept besides of its way."""

from __future__ import annotations

import dataclasses
import json
import math
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from pydrake.systems.framework import Context, EventStatus

from tfg_drake.comparison.metrics import rmse
from tfg_drake.datasets.evaluation import hits, relative_error, truth_at, wall_thickness
from tfg_drake.datasets.figure import draw_laser_map
from tfg_drake.datasets.recording import OnProgress, Recording
from tfg_drake.datasets.relations import off_relations, read_relations, relation_errors
from tfg_drake.datasets.way import poses_between
from tfg_drake.diagrams.mapping_explorer import MappingMethod
from tfg_drake.diagrams.missions.mission import Mission
from tfg_drake.diagrams.missions.mission_runner import Progress
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.recorded_station import RecordedRobot, RecordedScenario, length_of, start_of
from tfg_drake.diagrams.scenario import ApplySettings, Scenario
from tfg_drake.geometry import se2
from tfg_drake.geometry.alignment import align
from tfg_drake.grid.gmapping import best_particle
from tfg_drake.io.files import write_atomic
from tfg_drake.messages import FloatArray, IntArray, Observation
from tfg_drake.slam.shared import SCANNER_X, SCANNER_Y, SCANNER_YAW
from tfg_drake.slam.surface_fit import poses_by_surfaces
from tfg_drake.slam.walls import known_walls
from tfg_drake.storage.trajectory import write_tum

# What the summary says where a reference is known.
_AGAINST_TRUTH = ("relative_translation_m", "relative_rotation_rad", "robot_rmse_m", "online_rmse_m")


@dataclasses.dataclass(frozen=True)
class SlamResult:
    """The summary and the folder it is in."""

    summary: dict[str, Any]
    folder: Path


def map_recording(
    recording: Recording,
    dataset: Path,
    out: Path | None = None,
    method: str = "walls",
    on_progress: OnProgress = lambda _share: None,
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
        on_progress: told the share of the recording that is mapped.
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
        off_relations(at, np.zeros((len(at), 3)), told, recording.told_stamps)  # Rather now than when all is mapped.
    way, start, end = WayKeeper(), start_of(recording), length_of(recording)
    ended = (interrupted or threading.Event()).is_set

    def tell(progress: Progress) -> None:
        if not ended():
            on_progress(min(progress.time / max(end, 1e-9), 1.0))

    result = run_mission(
        scenario,
        method=MappingMethod(method, end),
        robot=RecordedRobot(recording),
        name=recording.name,
        world_name="unknown",
        max_time=math.inf,
        out_dir=out,
        on_progress=tell,
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
        # Where the scanner is estimated to sit, on what its log takes for its place.
        X_MS = se2.compose(se2.compose(X_MB, X_BS), recording.X_BS)
        figures["relations"] = relation_errors(at, X_MS, told, recording.told_stamps)
    met = hits(recording.scans, se2.compose(X_MB, X_BS))
    thickness = wall_thickness(met)
    walls = np.empty((0, 2, 2))
    if state is not None and state.map is not None:
        _, walls, _ = known_walls(state.map)
    summary = {
        **result.summary,
        "dataset": str(dataset),
        "name": recording.name,
        "method": method,
        "explored_s": None,
        "scans": len(recording.scans),
        "way_m": float(np.hypot(*np.diff(X_MB[:, :2], axis=0).T).sum()),
        **figures,
        "wall_thickness_m": thickness if math.isfinite(thickness) else None,
        "walls_mapped": None if state is None else len(walls),
        "online_cpu_s": mission.estimator_cpu,
    }
    write_tum(folder / "trajectory.tum", at, X_MB)
    write_tum(folder / "online.tum", online_stamps + start, online)
    true_path = np.empty((0, 2)) if truth is None else truth_at(truth, at)[:, :2]
    if truth is not None:
        true_path = se2.transform(align(X_MB[:, :2], true_path), true_path)
    draw_laser_map(folder / "figure.png", f"{recording.name}: {method}", met, walls, X_MB[:, :2], true_path)
    write_atomic(folder / "summary.json", json.dumps(summary, indent=2) + "\n")
    return SlamResult(summary, folder)


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
