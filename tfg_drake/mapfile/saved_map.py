"""A map on disk: one .npz of plain arrays, no pickle, with a schema number; docs/map_format.md describes it.

The file holds the keyframes of the graph. The joint covariance of the landmarks, which grows with the square of their
number, is computed from them: `restored_estimate`.
"""

from __future__ import annotations

import dataclasses
import functools
import io
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import numpy as np

from tfg_drake.config import OdometryConfig
from tfg_drake.io.files import FileError, of_run, read_arrays, reading, write_atomic
from tfg_drake.mapfile import schema_13
from tfg_drake.mapfile.message_arrays import Array, ArraysError, from_arrays, to_arrays
from tfg_drake.messages import BoolArray, FloatArray, IntArray, MapEstimate, TfgMap, is_tag, message, replace
from tfg_drake.slam.estimator_state import EstimatorState, initial_state
from tfg_drake.slam.evidence import Evidence
from tfg_drake.slam.keyframe import of_places
from tfg_drake.slam.keyframe_graph import KeyframeGraph, empty_graph, extended, no_observation
from tfg_drake.slam.map_solver import known_jointly, solve
from tfg_drake.slam.shared import LEAST_SIGMA, METRES, SHARED, Shared, exactly_known
from tfg_drake.slam.walls import FLOORS, Walls
from tfg_drake.table import take
from tfg_drake.tfg.feature_graph import TfgGraph
from tfg_drake.tfg.frontier import POORLY_SEEN, STANDOFF, UNSEEN, FrontierPoints
from tfg_drake.world.world import LONGEST

# To be raised whenever the fields of a class in a SavedMap change.
SCHEMA = 16
BY_FLOOR = "walls.by_floor"
SCATTER = "graph.keyframes.scatter"
# Older schemas that are read, too; their additional arrays, of tags seen on the way and of places tried in vain.
OLDER = (13, 14, 15)
GONE = re.compile(r"tfg_graph\.(sighted|viewpoints|tried|tried_count)(\.|$)|tfg_graph\.\w+\.id$|tfg\.viewpoints$")
# Tables of frontier points before schema 16.
KINDS_BEFORE = ("free_space_frontiers", "uninspected", "unseen_backs", "open_ends")
# Kinds of a TfgMap's segments (segment_kind) by number.
KINDS = ("edge", "wall_end", "bare_surface")
# Fields of the TfgMap that are places.
PLACES = ("segments", "frontiers", "star_vertices", "star_centers", "given_up")


class MapFileError(FileError):
    """The file is not a map, or is incomplete."""


@message
class SavedMap:
    """A map as stored on disk.

    X_WM: (3,) pose of the map frame in the world, m and rad. stage: number of views. stamp: time of the last view, s.
    graph: the estimator's keyframes and values. compared: number of sightings whose range was compared with the scan's.
    doubtful: (d,) ids, ascending, of doubtful tags, landmarks or not. walls: likelihood of their straightness.
    evidence: support for the places of the tags. tfg_graph: the topological feature graph, anchored to landmarks and
    views, of the same stage or, if the run was interrupted in between, of the previous one. tfg: the same graph
    resolved in M.
    """

    X_WM: Annotated[FloatArray, 3]
    stage: int
    stamp: float
    graph: KeyframeGraph
    compared: int
    doubtful: Annotated[IntArray, "d"]
    walls: Walls
    evidence: Evidence
    tfg_graph: TfgGraph
    tfg: TfgMap

    @property
    def is_tag(self) -> BoolArray:
        """Mask of the graph's landmarks that are tags, not walls."""
        return is_tag(self.graph.ids)

    @property
    def ids(self) -> IntArray:
        """(n,) ids of the tags, ascending."""
        return self.graph.ids[self.is_tag]

    @property
    def is_doubtful(self) -> BoolArray:
        """Mask (n,) of the tags that are doubtful."""
        return np.isin(self.ids, self.doubtful)

    @property
    def p_ML(self) -> FloatArray:
        """(n, 2) positions of the tags in M, m."""
        return self.graph.p_ML[self.is_tag]

    @property
    def landmark_covariance(self) -> FloatArray:
        """(n, 2, 2) marginal covariances of the tags' positions in M, m^2."""
        return self.graph.landmark_covariance[self.is_tag]

    @property
    def entropy(self) -> float:
        """The entropy of all landmarks, nats."""
        return self.graph.entropy

    @property
    def X_MA(self) -> FloatArray:
        """(g, 3) arrival poses of the views in M, m and rad."""
        return self.graph.X_MA

    @property
    def facing(self) -> FloatArray:
        """(n, 2) unit vectors in M: the side each tag was seen from, zero where the TFG does not know it yet."""
        facing = np.zeros_like(self.p_ML)
        if self.tfg.stage == self.stage:
            facing[:] = self.tfg.facing
        return facing


def saved_map(X_WM: FloatArray, state: EstimatorState, tfg_graph: TfgGraph, tfg: TfgMap) -> SavedMap:
    """Return the map to save.

    Args:
        X_WM: (3,) pose of the map frame in the world, m and rad.
        state: state of the estimator after its first view.
        tfg_graph, tfg: outputs of the TFG builder at one stage, that of the estimator's map or the previous one.

    Raises:
        ValueError: no view is in the map yet.
    """
    estimate = state.map
    if estimate is None:
        raise ValueError("There is no map before the first view.")
    return SavedMap(
        X_WM=np.array(X_WM, dtype=float),
        stage=estimate.stage,
        stamp=estimate.stamp,
        graph=replace(state.graph, p_ML=estimate.p_ML),
        compared=state.ranges.pairs,
        doubtful=estimate.doubtful,
        walls=state.walls,
        evidence=take(state.evidence, state.evidence.is_mapped),
        tfg_graph=tfg_graph,
        tfg=tfg,
    )


@functools.lru_cache(maxsize=1)
def state_of_map(estimate: MapEstimate) -> EstimatorState:
    """Return an estimator state made from a map estimate alone: its Gaussian as one keyframe seen from the map's
    origin. Landmarks that are not jointly known count as independent; exactly known ones get the deviation
    LEAST_SIGMA."""
    prior = exactly_known()
    graph = replace(
        as_one_keyframe(estimate, prior),
        view_keyframe=np.zeros(estimate.stage, dtype=np.int64),
        X_AV=estimate.X_MA,
        landmark_covariance=estimate.landmark_covariance,
        entropy=estimate.entropy,
    )
    return replace(initial_state(OdometryConfig(), prior=prior), graph=graph, map=estimate)


def as_one_keyframe(estimate: MapEstimate, prior: Shared) -> KeyframeGraph:
    """Return a map as a graph of one keyframe, seen from its origin. Landmarks that are not jointly known count as
    independent."""
    n = len(estimate.ids)
    covariance = LEAST_SIGMA**2 * np.eye(2 * n + 3)
    for row, own in enumerate(estimate.landmark_covariance):
        covariance[2 * row : 2 * row + 2, 2 * row : 2 * row + 2] += own
    joint = np.append(np.stack([2 * estimate.local, 2 * estimate.local + 1], axis=1).ravel(), 2 * n + np.arange(3))
    covariance[np.ix_(joint, joint)] = estimate.covariance + LEAST_SIGMA**2 * np.eye(len(joint))
    one = of_places(estimate.ids, estimate.p_ML, estimate.anchor, estimate.reach, estimate.X_MD, covariance)
    return extended(empty_graph(prior), one, estimate.X_MD, is_view=False)


def restored_estimate(saved: SavedMap) -> MapEstimate:
    """Return the estimate of the tags with their joint covariance, computed from the keyframes; of a very large map,
    that of the landmarks around the last view. Its observation is empty: the newest view is in the keyframes."""
    estimate = solve(saved.graph, saved.stamp, no_observation(), joint=known_jointly(saved.graph))[1]
    return replace(estimate.of_tags, doubtful=saved.doubtful)


def save_map(path: Path, saved: SavedMap, *, final: bool = True) -> None:
    """Write a map atomically. One that is not final is neither compressed nor synced, in a quarter of the time.

    Raises:
        OSError: the file cannot be written.
    """
    buffer = io.BytesIO()
    save = np.savez_compressed if final else np.savez
    save(buffer, schema=np.int64(SCHEMA), **to_arrays(saved))  # type: ignore[arg-type]
    write_atomic(path, buffer.getvalue(), durable=final)


def load_map(path: Path) -> SavedMap:
    """Read a map.

    Args:
        path: the file, or the run's folder with it.

    Raises:
        MapFileError: the file is missing, no map, truncated, of another schema or inconsistent; one line.
    """
    path = of_run(path, "map.npz")
    with reading(path, MapFileError):
        arrays = read_arrays(path)
    schema = arrays.pop("schema", None)
    if schema is None or schema.shape != () or schema.dtype.kind != "i":
        raise MapFileError(f"{path} is not a map of tfg-drake")
    if schema not in (SCHEMA, *OLDER):
        mend = "update tfg-drake" if schema > SCHEMA else "make the map anew"
        raise MapFileError(f"{path} has map schema {schema}; this version reads {OLDER[0]} to {SCHEMA}: {mend}")
    arrays.setdefault("graph.sessions", np.zeros(0, dtype=np.int64))  # Of a map from before they were told apart.
    if f"{SCATTER}@shape" not in arrays:  # Of a map from before a keyframe's scans were put together.
        count = np.size(arrays.get("graph.keyframes.unit", ()))
        arrays |= {SCATTER: np.zeros(9 * count), f"{SCATTER}@shape": np.full((count, 2), 3)}
    if len(FLOORS) > np.size(arrays.get(BY_FLOOR, ())) > 0:  # From before walls could be off by more than four times.
        arrays[BY_FLOOR] = np.pad(arrays[BY_FLOOR], (0, len(FLOORS) - len(arrays[BY_FLOOR])), mode="edge")
    try:
        arrays = arrays if schema == SCHEMA else _of_before(arrays)
        return whole_map(arrays, int(schema))
    except ArraysError as error:
        raise MapFileError(f"{path} is not a whole map: {error}") from None


def _of_before(arrays: dict[str, Array]) -> dict[str, Array]:
    """`_with_one_table` of arrays that may be damaged. Raises ArraysError."""
    try:
        return _with_one_table(arrays)
    except ArraysError:
        raise
    except (KeyError, TypeError, ValueError) as error:
        raise ArraysError(f"its frontiers do not fit together: {error}") from None


def _with_one_table(arrays: dict[str, Array]) -> dict[str, Array]:
    """Convert arrays of a schema before 16: one table per kind of frontier points becomes one for all, and points of
    faces move from the faces to in front of them. Raises ArraysError."""
    arrays = {name: array for name, array in arrays.items() if not GONE.match(name)}
    for name in [name for name in arrays if name.endswith(".on_surface")]:
        arrays[name.replace("on_surface", "kind")] = UNSEEN * arrays.pop(name).astype(np.int64)
        arrays[name.replace("on_surface", "tries")] = np.zeros_like(arrays[name.replace("on_surface", "kind")])
    if (poorly := "tfg_graph.uninspected.kind") in arrays:
        arrays[poorly] = np.full(len(arrays[poorly]), POORLY_SEEN)
    for kind in ("uninspected", "unseen_backs"):
        if (p := f"tfg_graph.{kind}.p") in arrays:
            arrays[p] = arrays[p] + STANDOFF * arrays[f"tfg_graph.{kind}.normal"]
    for field in dataclasses.fields(FrontierPoints):
        names = [f"tfg_graph.{kind}.{field.name}" for kind in KINDS_BEFORE]
        if missing := [name for name in names if name not in arrays]:
            raise ArraysError(f"{missing[0]} is missing")
        arrays[f"tfg_graph.frontiers.{field.name}"] = np.concatenate([arrays.pop(name) for name in names])
    return arrays


def whole_map(arrays: Mapping[str, Array], schema: int = SCHEMA) -> SavedMap:
    """Return the map in arrays of a schema, with all indices checked. Raises ArraysError."""
    saved = schema_13.read_map(SavedMap, arrays) if schema == 13 else from_arrays(SavedMap, arrays)
    if contradiction := _contradiction(saved):
        raise ArraysError(contradiction)
    return saved


def _contradiction(saved: SavedMap) -> str:
    """The first inconsistency of a map, in words; "" without any, and then all indices are within bounds."""
    graph, tfg_graph, tfg, stage = saved.graph, saved.tfg_graph, saved.tfg, saved.stage
    keyframes, covariance = graph.keyframes, graph.landmark_covariance
    places = {f"graph.{name}": getattr(graph, name) for name in ("p_ML", "anchor", "reach")}
    places |= {"graph.X_MN": graph.X_MN[:, :2], **{f"tfg.{name}": getattr(tfg, name) for name in PLACES}}
    views = {"tag_view": tfg_graph.tag_view, "surfaces.view": tfg_graph.surfaces.view}
    for field in dataclasses.fields(TfgGraph):
        if isinstance(points := getattr(tfg_graph, field.name), FrontierPoints):
            views[f"{field.name}.view"] = points.view
    ids = {"tfg_graph.tag_ids": tfg_graph.tag_ids, "tfg_graph.surfaces.ids": tfg_graph.surfaces.ids}
    ids["tfg.segment_ids"] = tfg.segment_ids
    is_finite = np.isfinite(covariance).all()
    lengths = np.hypot(*np.vstack([tfg.facing, tfg_graph.tag_facing]).T).round(6)
    wrong = {
        "graph.view_keyframe does not fit stage": not 1 <= stage == len(graph.view_keyframe),
        "graph.view_keyframe does not fit graph.keyframes": _is_beyond(graph.view_keyframe, len(keyframes)),
        "graph.ids is not ascending": not _is_ascending(graph.ids),
        "graph.keyframes.ids does not fit graph.ids": not all(
            _within(one.ids, graph.ids) and _is_ascending(one.ids) for one in keyframes
        ),
        "graph.keyframes.information does not fit graph.keyframes.ids": any(
            len(one.information) - 3 - SHARED not in (2 * len(one.ids), 4 * len(one.ids)) for one in keyframes
        ),
        "graph.keyframes.unit is no parameter": any(not METRES <= one.unit < SHARED for one in keyframes),
        "tfg_graph.stage does not fit stage": tfg_graph.stage not in (stage - 1, stage) or tfg.stage != tfg_graph.stage,
        "tfg.facing does not fit graph.ids": tfg.stage == stage and len(tfg.facing) != len(saved.ids),
        "evidence does not fit graph.ids": not _within(saved.evidence.ids, graph.ids),
        **{
            f"{name} is more than {LONGEST:g} m from the origin": not (np.abs(p_M) <= LONGEST).all()
            for name, p_M in places.items()
        },
        **{
            f"tfg_graph.{name} does not fit tfg_graph.stage": _is_beyond(view, tfg_graph.stage)
            for name, view in views.items()
        },
        "tfg.segment_kind is no kind": _is_beyond(tfg.segment_kind, len(KINDS)),
        "tfg.facing or tfg_graph.tag_facing is no direction": not np.isin(lengths, (0.0, 1.0)).all(),
        "X_WM or graph.landmark_covariance is not finite": not (is_finite and np.isfinite(saved.X_WM).all()),
        "graph.landmark_covariance is no covariance": is_finite
        and np.any(np.linalg.eigvalsh(covariance) < -(LEAST_SIGMA**2)),
        **{f"{name} does not fit graph.ids": not _within(some[some != -1], graph.ids) for name, some in ids.items()},
        "tfg_graph.star_offsets does not fit tfg.stage": len(tfg_graph.star_offsets) != tfg.stage + 1,
        "tfg.star_offsets does not fit tfg.stage": len(tfg.star_offsets) != tfg.stage + 1,
    }
    return next((what for what, is_wrong in wrong.items() if is_wrong), "")


def _is_beyond(numbers: IntArray, count: int) -> bool:
    return bool(np.any((numbers < 0) | (numbers >= count)))


def _is_ascending(ids: IntArray) -> bool:
    return bool(np.all(np.diff(ids) > 0))


def _within(ids: IntArray, known: IntArray) -> bool:
    return bool(np.isin(ids, known).all())
