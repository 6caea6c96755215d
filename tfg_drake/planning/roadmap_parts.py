"""Splits a roadmap into submaps by the views that its nodes are anchored to, and merges them again."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from tfg_drake.messages import BoolArray, FloatArray, IntArray, replace
from tfg_drake.planning.roadmap import Edges, RoadmapState, empty_roadmap, place_in_map
from tfg_drake.tfg.submaps import Submaps, undivided, whole

_NODES = ("anchor", "p_AN", "points", "sigma", "known_jointly")


def empty_roadmaps() -> Submaps[RoadmapState]:
    """The roadmap before the first view."""
    return undivided(empty_roadmap())


def split(state: RoadmapState, views: IntArray, stays: BoolArray) -> tuple[RoadmapState, RoadmapState]:
    """The roadmap split in two: the nodes anchored to those of its views (k,) that stay (k,), and the others.

    Edges between the two, and edges to nodes of inactive submaps, stay with the first as links while one of their ends
    is in it.
    """
    kept = np.zeros(int(views.max(initial=-1)) + 1, dtype=np.bool_)
    kept[views[stays]] = True
    kept = kept[state.anchor]
    links = _links(state)
    near = np.asarray(_has(state.ids[kept], links.nodes).any(axis=1))
    return (
        _with_links(_of_nodes(state, kept), links.of(near)),
        _with_links(_of_nodes(state, ~kept), links.of(~near)),
    )


def merged(states: Sequence[RoadmapState], views: Sequence[IntArray]) -> RoadmapState:
    """The roadmap of several submaps; the first is the active one."""
    del views
    order = np.argsort(np.concatenate([state.ids for state in states]))
    nodes: dict[str, Any] = {name: np.concatenate([getattr(state, name) for state in states])[order] for name in _NODES}
    ids = np.concatenate([state.ids for state in states])[order]
    first, *others = (_links(state) for state in states)
    return _with_links(replace(states[0], ids=ids, **nodes), first.and_those_of(*others))


def whole_roadmap(roadmaps: Submaps[RoadmapState], X_MA: FloatArray) -> RoadmapState:
    """The roadmap of all submaps, its nodes placed by the views X_MA (k, 3). Edges of inactive submaps are as they were
    checked last."""
    state = whole(roadmaps, merged)
    return replace(state, points=place_in_map(state.anchor, state.p_AN, X_MA))


def _of_nodes(state: RoadmapState, keep: BoolArray) -> RoadmapState:
    return replace(state, ids=state.ids[keep], **{name: getattr(state, name)[keep] for name in _NODES})


def _links(state: RoadmapState) -> Edges:
    """All edges of a submap by the ids of their nodes, those to other submaps last."""
    return replace(state.edges, nodes=state.ids[state.edges.nodes]).and_those_of(state.links)


def _with_links(state: RoadmapState, links: Edges) -> RoadmapState:
    """A submap with these edges instead of its own: those that have both ends in it in the order of their nodes."""
    inner = np.asarray(_has(state.ids, links.nodes).all(axis=1))
    own = links.of(inner)
    nodes = np.searchsorted(state.ids, own.nodes)
    edges = replace(own, nodes=nodes).of(np.lexsort(nodes.T[::-1]))
    return replace(state, edges=edges, links=links.of(~inner))


def _has(ids: IntArray, asked: IntArray) -> BoolArray:
    """Whether each of the ids asked for (...) is among the ids (n,), ascending."""
    if not len(ids):
        return np.zeros(asked.shape, dtype=np.bool_)
    return np.asarray(ids[np.searchsorted(ids, asked).clip(max=len(ids) - 1)] == asked)
