"""Merges two maps of one building.

B's graph becomes one keyframe of A's: the joint Gaussian of all its landmarks and its last pose, with its shared
parameters marginalised out, as two robots have two calibrations and a gyro has another bias in every session. The
motion from A's last pose to B's first is unknown, as after a kidnapping. Tags of the same id become one landmark, and
so do walls that agree; then the whole graph is solved again.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tfg_drake.bad_input import BadInput
from tfg_drake.config import ExplorerConfig, RobotConfig, TagSensorConfig
from tfg_drake.geometry import se2
from tfg_drake.mapfile.placement import by_walls, standing_in
from tfg_drake.mapfile.saved_map import SavedMap, as_one_keyframe, load_map
from tfg_drake.messages import FloatArray, MapEstimate, replace
from tfg_drake.slam.estimator_state import unknown_way
from tfg_drake.slam.evidence import disputed, reconciled
from tfg_drake.slam.keyframe import Keyframe, along_walls, rows_of, without_tags
from tfg_drake.slam.keyframe_graph import extended, no_observation
from tfg_drake.slam.map_solver import known_jointly, solve
from tfg_drake.slam.shared import exactly_known
from tfg_drake.slam.tag_search import by_tags
from tfg_drake.slam.walls import Names, named, renamed
from tfg_drake.table import concat, take
from tfg_drake.tfg.feature_graph import TfgGraph
from tfg_drake.tfg.graph import joined, resolve

# Greatest number of landmarks of B, as files with the joint Gaussian of more are not read.
MOST_LANDMARKS = 1900


def merge(a: SavedMap | Path | str, b: SavedMap | Path | str) -> SavedMap:
    """Merge two maps of one building into one, in A's frame M.

    Common tags determine the transformation or, if they do not suffice, the walls. A tag on whose place the maps
    disagree keeps its place in A and becomes doubtful. The shared parameters are those of A's robot.

    Args:
        a, b: maps, map files or folders of runs.

    Raises:
        MapFileError: a file is not a complete map.
        BadInput: the transformation is ambiguous or unknown, B is too large, or the maps share an observation or a
            session; one line.
    """
    first, second = (one if isinstance(one, SavedMap) else load_map(Path(one)) for one in (a, b))
    if len(second.graph.ids) > MOST_LANDMARKS:
        raise BadInput(f"the second map has {len(second.graph.ids)} landmarks; at most {MOST_LANDMARKS} are taken in")
    if shared := len(_looks(first) & _looks(second)):
        raise BadInput(f"{shared} looks are in both maps, and would count twice: merge maps of runs that share none")
    if len(np.intersect1d(first.graph.sessions, second.graph.sessions)):
        raise BadInput(
            "both maps hold the same session, which would count twice: one began with the other, or both with a third; "
            "use one alone"
        )
    found = by_tags(first.graph, second.graph) or by_walls(standing_in(first), standing_in(second))
    if found is None:
        raise BadInput(
            f"{len(np.intersect1d(first.ids, second.ids))} tags are in both, too few or too near to each other, and "
            "the walls fit nowhere or in several places: map more of what both have, or hang up three tags there"
        )
    told = solve(second.graph, second.stamp, no_observation(), joint=len(second.graph.ids))[1]
    own = without_tags(as_one_keyframe(told, exactly_known()).keyframes[0], found.moved)
    before = solve(first.graph, first.stamp, no_observation(), joint=known_jointly(first.graph))[1]
    names, walls = renamed(own, first.walls, before, found.X, found.covariance)
    one = named(own, names)
    views, X_BV = first.tfg_graph.stage, told.X_MA[: second.tfg_graph.stage]
    unknown = unknown_way(se2.between(first.graph.X_MN[-1], found.X))
    graph = extended(first.graph, unknown, found.X, is_view=False)
    graph = extended(graph, one, se2.compose(found.X, told.X_MD), is_view=False)
    view_keyframe = np.append(graph.view_keyframe[:views], np.full(len(X_BV), len(graph.keyframes) - 1))
    sessions = np.union1d(first.graph.sessions, second.graph.sessions)
    X_AV = np.vstack([graph.X_AV[:views], X_BV])
    graph = replace(graph, view_keyframe=view_keyframe, X_AV=X_AV, sessions=sessions)
    graph, estimate = solve(graph, second.stamp, no_observation(), joint=known_jointly(graph))
    graph, estimate, contradicted = reconciled(graph, estimate)
    wrong = np.append(found.moved, contradicted)
    tfg_graph = joined(
        first.tfg_graph, _with_names(second, one, names, estimate, graph.X_MN[-2]), estimate, TagSensorConfig()
    )
    tfg = resolve(tfg_graph, estimate, RobotConfig(), ExplorerConfig())
    others = take(second.evidence, ~np.isin(second.evidence.ids, first.evidence.ids))
    evidence = disputed(concat(first.evidence, others), wrong)
    doubtful = np.unique(np.concatenate([first.doubtful, second.doubtful, wrong]))
    both = replace(first, stage=estimate.stage, stamp=estimate.stamp, graph=graph, walls=walls, evidence=evidence)
    return replace(both, doubtful=doubtful, tfg_graph=tfg_graph, tfg=tfg)


def _looks(saved: SavedMap) -> set[bytes]:
    """The measurements of all keyframes with landmarks, as bytes; no two observations are equal to the bit."""
    return {one.y_AL.tobytes() + one.information.tobytes() for one in saved.graph.keyframes if len(one.ids)}


def _with_names(saved: SavedMap, one: Keyframe, names: Names, estimate: MapEstimate, X_MB: FloatArray) -> TfgGraph:
    """Return the TFG of a map with the ids and anchors that its walls have in the merged map. one: the map as a
    keyframe with these ids, at the pose X_MB (3,) of the estimate."""
    surfaces = saved.tfg_graph.surfaces
    wall, is_on = rows_of(surfaces.ids[:, 0], names.provisional)
    ids, vertices = surfaces.ids.copy(), surfaces.vertices.copy()
    named_so = names.ids[wall[is_on]]
    ids[is_on] = named_so[:, None]
    row = np.searchsorted(estimate.ids, named_so)
    at = se2.transform(X_MB, one.anchor[np.searchsorted(one.ids, named_so)])
    shift = np.sum((at - estimate.anchor[row]) * along_walls(estimate.p_ML[row]), axis=1)
    count = np.diff(surfaces.offsets)
    vertices[np.repeat(is_on, count), 0] += np.repeat(shift, count[is_on])
    return replace(saved.tfg_graph, surfaces=replace(surfaces, ids=ids, vertices=vertices))
