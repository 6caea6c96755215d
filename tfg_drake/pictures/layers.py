"""Layers of a picture: shapes of one look, made of the records of `tfg_drake.pictures.scene` and `tables`.

Every picture but the page, which has the records, draws these: Meshcat, Foxglove, RViz, figures and plans. What a layer
is called and looks like stands in LOOKS.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tfg_drake.mapfile.saved_map import KINDS, SavedMap
from tfg_drake.messages import FloatArray, GoalChoice, MapEstimate, Roadmap, TfgMap
from tfg_drake.pictures import scene, tables
from tfg_drake.pictures.drawing import bands, circles, ellipses, outline_segments, spreads
from tfg_drake.pictures.palette import FREE, GAINS, LIGHT, Colour

if TYPE_CHECKING:
    from tfg_drake.slam.keyframe_graph import KeyframeGraph

# Size of a symbol, width of an outline and height of letters in pictures to scale, m.
SYMBOL, OUTLINE, LETTER = 0.05, 0.01, 0.2
# Heights above the floor, m: of surfaces, of the lines of walls on them, and of tags.
SURFACE, ON_SURFACE, TAG = 0.4, 0.41, 0.45


class Look(NamedTuple):
    """Appearance of a layer.

    words: its name in a legend, "" where it has none. size: a line's width or a point's radius, in symbols of the
    picture. high: where its top is in space, m above the floor. stands: on the floor; else it is a sheet. lit: its
    colour in space, where lamps and a dark ground change what is seen.
    """

    words: str
    colour: Colour
    size: float = 0.0
    high: float = 0.0
    stands: bool = False
    opacity: float = 1.0
    lit: Colour | None = None

    @property
    def in_space(self) -> Colour:
        """The colour in space."""
        return self.lit or self.colour

    @property
    def rgba(self) -> dict[str, float]:
        """The same with its opacity, by the names that ROS and Foxglove have."""
        return dict(zip("rgba", (*self.in_space, self.opacity), strict=True))

    @property
    def width(self) -> float:
        """Width of its lines or outlines in pictures of true size, m."""
        return SYMBOL * self.size or OUTLINE


# Layers on the floor are far enough apart in height for a browser's depth buffer.
LOOKS: dict[str, Look] = {
    "floor": Look("", (0.80, 0.82, 0.85), high=0.01),
    "free_space": Look("free space", FREE, high=0.02),
    "wall": Look("true wall", LIGHT.wall, 1.1, 0.35, stands=True, opacity=0.6),
    "true_tag": Look("", LIGHT.wall_end, 1.6, 0.3, stands=True),
    "occupied": Look("occupied cell", LIGHT.edge, high=SURFACE, stands=True, lit=LIGHT.edge_in_space),
    "edge": Look("mapped surface", LIGHT.edge, 1.2, SURFACE, stands=True, lit=LIGHT.edge_in_space),
    "wall_end": Look("past the last tag", LIGHT.wall_end, 1.2, SURFACE, stands=True),
    "bare_surface": Look("without landmark", LIGHT.bare_surface, 1.2, SURFACE, stands=True),
    "keep_out": Look("keep-out area", LIGHT.keep_out, 1.2, SURFACE, stands=True),
    "wall_landmark": Look("wall (landmark)", LIGHT.wall_landmark, 0.6, ON_SURFACE),
    "wall_landmark_3sigma": Look("wall, 3\u03c3", LIGHT.wall_landmark, high=ON_SURFACE + 0.005, opacity=0.3),
    "landmark": Look("tag", LIGHT.landmark, 1.4, TAG, stands=True),
    "landmark_3sigma": Look("tag, 3\u03c3", LIGHT.landmark, high=TAG + 0.02, opacity=0.3),
    "doubtful": Look("doubtful tag", LIGHT.doubtful, 1.4, TAG, stands=True),
    "doubtful_3sigma": Look("doubtful tag, 3\u03c3", LIGHT.doubtful, high=TAG + 0.02, opacity=0.3),
    "trail": Look("way driven", LIGHT.trail, 0.6, 0.03),
    **{f"gain_{k}": Look("", GAINS[k], 0.4 + 0.3 * k, 0.04) for k in range(len(GAINS))},
    "frontier": Look("frontier", LIGHT.frontier, 1.6, 0.05),
    "path": Look("path and tour", LIGHT.path, 1.0, 0.06),
    "leg": Look("", LIGHT.path, 0.6, 0.06),
    "goal": Look("", LIGHT.path, 2.5, 0.06),
    "stop": Look("", LIGHT.path, 3.6, TAG + 0.05),
    "number": Look("", (1.0, 1.0, 1.0), 0.6, TAG + 0.06),
    "scan": Look("scan", LIGHT.scan, 0.6, 0.43),
    "robot": Look("robot", LIGHT.robot, high=0.3, stands=True),
    "heading": Look("", (1.0, 1.0, 1.0), high=0.33, stands=True),
    "robot_3sigma": Look("", LIGHT.robot, high=TAG + 0.02, opacity=0.4),
    "truth": Look("robot (true)", LIGHT.truth, high=0.15, stands=True, opacity=0.5),
    "person": Look("person", LIGHT.person, high=1.6, stands=True, opacity=0.8),
}
# Suffix of the name of a layer of standard deviations.
SPREAD = "_3sigma"
# Layers of surfaces by their kind (`tables.surfaces`); records that are segments of one appearance, and their layers.
SURFACES = (*KINDS, "keep_out")
SEGMENTS = {"frontiers": "frontier", "path": "path"}


class Layer(NamedTuple):
    """Shapes of one look, in the frame of their record, m.

    name: of LOOKS. shapes: points (n, 2), lines (m, 4) or areas, outlines (c, 2) that are stars round their first
    corner, as convex ones are. labels: places (2,) by the words that stand there.
    """

    name: str
    shapes: FloatArray | Sequence[FloatArray]
    labels: Mapping[str, FloatArray] = {}

    @property
    def look(self) -> Look:
        """Its appearance."""
        return LOOKS[self.name]

    @property
    def kind(self) -> str:
        """points, lines or areas."""
        shapes = self.shapes
        if not isinstance(shapes, np.ndarray) or shapes.ndim > 2:
            return "areas"
        return "lines" if shapes.shape[1] == 4 else "points"

    @property
    def segments(self) -> FloatArray:
        """Lines, or the outlines of areas, as segments (k, 4)."""
        shapes = np.asarray(self.shapes)
        return outline_segments(shapes) if self.kind == "areas" else shapes

    def outlines(self, unit: float) -> FloatArray:
        """All shapes as outlines (n, c, 2) as large as they look where a symbol has a size, m."""
        shapes, size = np.asarray(self.shapes), unit * self.look.size
        if self.kind == "areas":
            return shapes
        return bands(shapes, size) if self.kind == "lines" else circles(shapes, size)


def layers(record: str, arrays: scene.Record, sigmas: float = 3.0, cell: float = 0.0) -> Iterator[Layer]:
    """The layers of a record. sigmas: how many standard deviations are drawn. cell: a side of a grid's cells, m."""
    if record in SEGMENTS:
        yield Layer(SEGMENTS[record], arrays["segments"])
    elif record == "world":
        yield Layer("wall", arrays["segments"])
        along = 0.1 * np.stack([-np.sin(arrays["tag_facing"]), np.cos(arrays["tag_facing"])], axis=1)
        yield Layer("true_tag", np.hstack([arrays["tags"] - along, arrays["tags"] + along]))
    elif record == "free":
        # Each round its centre, and back to where it began.
        stars = np.split(arrays["points"], np.cumsum(arrays["count"])[:-1])
        yield Layer("free_space", [np.vstack([star, star[1:2]]) for star in stars])
    elif record == "grid":
        for name, cells in (("free_space", arrays["free"]), ("occupied", arrays["occupied"])):
            yield Layer(name, bands(cells, cell))
    elif record == "tfg":
        for kind, name in enumerate(SURFACES):
            yield Layer(name, arrays["segments"][arrays["kind"] == kind])
    elif record == "wall_landmarks":
        yield Layer("wall_landmark", arrays["segments"])
        yield Layer("wall_landmark_3sigma", spreads(arrays["segments"], arrays["deviation"], sigmas))
    elif record == "map":
        points, covariance = arrays["points"], arrays["covariance"][:, [0, 1, 1, 2]].reshape(-1, 2, 2)
        for kind, name in enumerate(("landmark", "doubtful")):
            some = arrays["doubtful"] == kind
            labels = dict(zip(map(str, arrays["ids"][some].tolist()), points[some], strict=True))
            yield Layer(name, points[some], labels)
            yield Layer(f"{name}{SPREAD}", ellipses(points[some], covariance[some], sigmas))
    elif record == "gains":
        shade = np.rint(arrays["share"] / 255.0 * (len(GAINS) - 1))
        for k in range(len(GAINS)):
            yield Layer(f"gain_{k}", arrays["points"][shade == k])
    elif record == "goal":
        yield Layer("goal", arrays["points"])
    elif record == "tour":  # of the goal's record
        yield Layer("leg", arrays["legs"])
        yield Layer("stop", arrays["tour"], {str(k): stop for k, stop in enumerate(arrays["tour"], 1)})


def of_map(
    known: MapEstimate | SavedMap | None,
    tfg: TfgMap | None,
    walls: MapEstimate | KeyframeGraph | None,
    sigmas: float = 3.0,
) -> Iterator[Layer]:
    """The layers of a map, as far as there are its tags, its TFG and its walls that are landmarks; see `layers`."""
    if tfg is not None:
        yield from layers("tfg", tables.surfaces(tfg).arrays)
        yield from layers("frontiers", tables.frontiers(tfg).arrays)
    if walls is not None:
        yield from layers("wall_landmarks", tables.wall_landmarks(walls).arrays, sigmas=sigmas)
    if known is not None:
        yield from layers("map", tables.landmarks(known).arrays, sigmas=sigmas)


def of_free_space(tfg: TfgMap) -> Iterator[Layer]:
    """The layer of a TFG's star polygons."""
    stars = scene.free_space(tfg)
    return layers("free", scene.packed_stars(stars, np.arange(len(stars))))


def of_choice(choice: GoalChoice | None, roadmap: Roadmap | None) -> Iterator[Layer]:
    """The layers of the goal and, on a roadmap of its stage, of what could be one and of the tour."""
    if choice is not None:
        yield from layers("goal", scene.goal(choice))
    if choice is not None and roadmap is not None and roadmap.stage == choice.stage:
        yield from layers("gains", tables.gains(choice, roadmap).arrays)
        yield from layers("tour", scene.tour(choice, roadmap))
