"""A small flat world to turn round in, with exact view poses."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from tests.walls import walls_between
from tfg_drake.config import ExplorerConfig, RobotConfig, ScanConfig, TagSensorConfig
from tfg_drake.geometry.se2 import between, inverse
from tfg_drake.geometry.visibility import cast_rays, line_of_sight
from tfg_drake.messages import WALLS_BELOW, LaserScan, MapEstimate, Observation, TfgMap, replace
from tfg_drake.slam.keyframe import placed
from tfg_drake.table import concat, empty
from tfg_drake.tfg.feature_graph import TfgGraph
from tfg_drake.tfg.frontier import points_of
from tfg_drake.tfg.graph import resolve, update
from tfg_drake.tfg.panorama import Panorama, build_panorama


@dataclass
class Simulation:
    """Walls (m, 4), tags p_WT (n, 2) with outward normals (n, 2), and a graph that grows view by view; M is W."""

    walls: np.ndarray
    p_WT: np.ndarray
    normal: np.ndarray
    noise: float = 0.015
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))
    X_MA: list[np.ndarray] = field(default_factory=list)
    mapped: set[int] = field(default_factory=set)
    graph: TfgGraph = field(default_factory=lambda: empty(TfgGraph))
    estimate: MapEstimate | None = None
    last_panorama: Panorama | None = None
    tags: TagSensorConfig = field(default_factory=TagSensorConfig)
    scan: ScanConfig = field(default_factory=ScanConfig)
    robot: RobotConfig = field(default_factory=RobotConfig)
    explorer: ExplorerConfig = field(default_factory=ExplorerConfig)
    # Faces (w, 4) of walls that are landmarks, seen from their left.
    landmarks: np.ndarray = field(default_factory=lambda: np.zeros((0, 4)))
    # What the map makes of the tags: their error (n, 2) and its standard deviation (n,), m.
    error: np.ndarray | None = None
    sigma: np.ndarray | None = None
    # Of the newest view, s.
    stamp: float = 0.0

    def turn(self, X_WA: np.ndarray) -> tuple[list[LaserScan], np.ndarray, np.ndarray]:
        """Scans, stamps and X_AB of a turn at 1 rad/s."""
        angles = np.arange(-124, 125) * self.scan.resolution
        stamps = np.arange(0.0, 6.4, 0.1)
        scans = []
        for stamp in stamps:
            ranges = cast_rays(self.walls, X_WA[:2], angles + X_WA[2] + stamp, self.scan.range)
            ranges = ranges + self.noise * self.rng.standard_normal(len(ranges))
            scans.append(LaserScan(float(stamp), angles, ranges, self.scan.range, self.noise))
        return scans, stamps, np.stack([0.0 * stamps, 0.0 * stamps, stamps], axis=1)

    def visible(self, p_WA: np.ndarray) -> np.ndarray:
        """Rows of the tags that a turn at p_WA detects."""
        towards = p_WA - self.p_WT
        distance = np.hypot(*towards.T)
        facing = np.sum(towards * self.normal, axis=1) >= np.cos(self.tags.max_incidence) * distance
        clear = line_of_sight(self.walls, p_WA, self.p_WT)
        return np.flatnonzero((distance <= self.tags.range) & facing & clear)

    def panorama(self, X_WA: np.ndarray) -> Panorama:
        return build_panorama(*self.turn(X_WA))

    def observe(self, X_WA: np.ndarray, glance: bool = False) -> TfgMap:
        """Adds a view with an exact pose and landmarks that are exact, but for `error`. glance: its first scan only."""
        scans, stamps, X_AB = self.turn(X_WA)
        scans = scans[:1] if glance else scans
        seen = self.visible(X_WA[:2])
        self.mapped |= set(seen.tolist())
        self.X_MA.append(X_WA)
        ids = np.array(sorted(self.mapped), dtype=np.int64)
        error = np.zeros_like(self.p_WT) if self.error is None else self.error
        sigma = np.full(len(self.p_WT), 1e-3) if self.sigma is None else self.sigma
        observation = Observation(seen, stamps, X_AB)
        w = len(self.landmarks)
        each = np.concatenate([np.full(w, 1e-3), sigma[ids]])
        wall, anchor, reach = walls_between(self.landmarks)
        no_wall = np.zeros((len(ids), 2))
        self.estimate = MapEstimate(
            len(self.X_MA),
            self.stamp,
            np.concatenate([WALLS_BELOW - w + np.arange(w), ids]),
            np.vstack([wall, self.p_WT[ids] + error[ids]]),
            np.vstack([anchor, no_wall]),
            np.vstack([reach, no_wall]),
            X_WA,
            np.arange(len(each)),
            np.diag(np.append(np.repeat(each, 2), np.full(3, 1e-3))) ** 2,
            each[:, None, None] ** 2 * np.eye(2),
            np.array(self.X_MA),
            observation,
            0.0,
        )
        self.last_panorama = build_panorama(scans, stamps, X_AB)
        self.graph = update(
            self.graph,
            self.estimate,
            self.last_panorama,
            self.tags,
            self.robot,
            self.explorer,
            glance=glance,
        )
        return resolve(self.graph, self.estimate, self.robot, self.explorer)

    def put_frontiers(self, p: np.ndarray) -> TfgMap:
        """A metre of frontier at each of the points (n, 2), seen from where x is less."""
        points = points_of(0, p, np.tile([-1.0, 0.0], (len(p), 1)), np.ones(len(p)))
        self.graph = replace(self.graph, frontiers=concat(self.graph.frontiers, points))
        return resolve(self.graph, self.estimate, self.robot, self.explorer)

    def moved(self, X_NM: np.ndarray) -> MapEstimate:
        """The estimate with the whole map moved rigidly."""
        e = self.estimate
        assert e is not None
        X_MA = np.array([between(inverse(X_NM), X) for X in e.X_MA])
        p_ML, anchor = placed(X_NM, e.ids, e.p_ML, e.anchor)
        return replace(e, p_ML=p_ML, anchor=anchor, X_MA=X_MA)


def _rectangle(x0: float, y0: float, x1: float, y1: float) -> list[list[float]]:
    return [[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]]


def _tags_on(walls: np.ndarray, spacing: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Tags 1 cm off both faces of every wall, about spacing apart."""
    p, normal = [], []
    for x0, y0, x1, y1 in walls:
        d = np.array([x1 - x0, y1 - y0])
        length = np.hypot(*d)
        n = np.array([-d[1], d[0]]) / length
        count = max(1, round(length / spacing))
        for k in range(count):
            at = np.array([x0, y0]) + (k + 0.5) / count * d
            for side in (n, -n):
                p.append(at + 0.01 * side)
                normal.append(side)
    return np.array(p), np.array(normal)


@pytest.fixture
def simulate():
    """Simulation of any walls (m, 4), with tags on both faces."""

    def make(walls, spacing: float = 1.0, **options) -> Simulation:
        walls = np.array(walls, dtype=float)
        return Simulation(walls, *_tags_on(walls, spacing), **options)

    return make


@pytest.fixture
def two_rooms(simulate) -> Simulation:
    """A 12 x 6 m box in two by a thin wall with a door 1 m wide, and a 1 m pillar in the right room."""
    walls = _rectangle(0.0, 0.0, 12.0, 6.0)
    walls += [[6.0, 0.0, 6.0, 2.5], [6.0, 3.5, 6.0, 6.0]]
    walls += _rectangle(8.5, 2.5, 9.5, 3.5)
    return simulate(walls)
