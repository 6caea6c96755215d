"""The messages between the systems: frozen, stamped, in SI units.

Every message is a frozen dataclass whose arrays are read-only and whose deep copy is itself, so Drake copies a context
at no cost, and no system can change a message that another one reads.

Frames: W world, M map (the true start pose: X_WM = start), O odometry, B robot body, A the robot where a view's
turn begins (arrival), D where it ends (departure). A pose is an array (x, y, theta) in metres and radians,
theta modulo 2 pi; a covariance of a pose X_MB is that of (x, y) in M and theta.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, dataclass_transform

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

T = TypeVar("T")


def _freeze(array: NDArray[Any]) -> NDArray[Any]:
    # Over bytes no view of it can ever be written, and the caller's array stays the caller's. An array that another
    # message holds already is shared, not copied.
    base: object = array.base
    if type(base) is bytes:
        return array
    return np.ndarray(array.shape, array.dtype, array.tobytes())


def _post_init(self: Any) -> None:
    fields, array = self.__dict__, np.ndarray
    for name, value in fields.items():
        if isinstance(value, array):
            fields[name] = _freeze(value)


if TYPE_CHECKING:
    from dataclasses import replace as replace  # It checks the names and types of the changes.
else:

    def replace(message, /, **changes):
        """The message with some fields changed: `dataclasses.replace` without another look at all that stays."""
        old, new, array = message.__dict__, object.__new__(type(message)), np.ndarray
        fields, names = new.__dict__, message.__dataclass_fields__
        # Values derived from the old fields are not copied.
        fields.update((name, old[name]) for name in names)
        for name, value in changes.items():
            fields[name] = _freeze(value) if isinstance(value, array) else value
        if len(fields) != len(names):
            unknown = ", ".join(sorted(changes.keys() - names.keys()))
            raise TypeError(f"{type(message).__name__} has no field {unknown}.")
        return new


@dataclass_transform(frozen_default=True, eq_default=False)
def message(cls: type[T]) -> type[T]:
    """A frozen dataclass of read-only arrays whose deep copy is itself; compared by identity."""
    frozen_self: Callable[[Any, Any], Any] = lambda self, _memo: self  # noqa: E731
    cls.__post_init__ = _post_init  # type: ignore[attr-defined]
    cls.__deepcopy__ = frozen_self  # type: ignore[attr-defined]
    cls.__copy__ = lambda self: self  # type: ignore[attr-defined]
    return dataclasses.dataclass(frozen=True, eq=False, slots=False)(cls)


@message
class Odometry:
    """Dead reckoning by wheels and gyro.

    stamp: s. X_OB: (3,) integrated pose of the body in the odometry frame O, the pose where odometry began: in
    simulation it starts at zero, so O equals M then. V_B: (2,) measured forward speed (m/s) and turn rate (rad/s).
    at_rest: no wheel has turned since the previous message: by the encoders the robot stands, while the gyro's angle
    drifts. breaks: number of times so far that the motion between two messages was unknown, as odometry was reset,
    jumped or was silent; X_OB then continues by a guess.
    """

    stamp: float
    X_OB: Annotated[FloatArray, 3]
    V_B: Annotated[FloatArray, 2]
    at_rest: bool = False
    breaks: int = 0


@message
class TagDetections:
    """The tags seen in one camera frame, as range and bearing of the tag's centre from the body.

    stamp: s. ids: (n,). range: (n,) m. bearing: (n,) rad from the body's x axis. sigma_range, sigma_bearing: (n,)
    standard deviations stated by the sensor.
    """

    stamp: float
    ids: Annotated[IntArray, "n"]
    range: Annotated[FloatArray, "n"]
    bearing: Annotated[FloatArray, "n"]
    sigma_range: Annotated[FloatArray, "n"]
    sigma_bearing: Annotated[FloatArray, "n"]


@message
class LaserScan:
    """One planar scan, taken at one instant from the body's origin.

    stamp: s. angles: (m,) rad from the body's x axis, increasing. ranges: (m,) m, inf without a return within
    range_max, nan if unknown. range_max: m. sigma: standard deviation of a range, m.
    """

    stamp: float
    angles: Annotated[FloatArray, "m"]
    ranges: Annotated[FloatArray, "m"]
    range_max: float
    sigma: float


@message
class Hazards:
    """The base's own alarms, as bits: 1 right, 2 centre, 4 left (Kobuki's order). stamp: s."""

    stamp: float
    bumper: int
    cliff: int
    wheel_drop: int


@message
class PoseEstimate:
    """The online estimate of the robot's pose.

    stamp: s. X_MB: (3,). covariance: (3, 3) of its x, y and theta in M. speed: (2,) m/s and rad/s, from odometry.
    stage: number of views in the map it is relative to. new_ids: (u,) tags seen on the way that are not in the map
    yet, p_MU: (u, 2) their estimated places, m. places: number of possible places of the robot in its map or in its
    known map, 0 for none or any, -1 if its place is known.
    """

    stamp: float
    X_MB: Annotated[FloatArray, 3]
    covariance: Annotated[FloatArray, 3, 3]
    speed: Annotated[FloatArray, 2]
    stage: int
    new_ids: Annotated[IntArray, "u"]
    p_MU: Annotated[FloatArray, "u", 2]
    places: int = -1


# A place with a probability above this is counted as possible.
LIKELY = 0.05
# A robot whose position in its map has a greater deviation than this, m, is lost.
ADRIFT = 2.0


@message
class Hypotheses:
    """Possible places of a session in its known map K, empty once the place is known; or, for a robot lost in its own
    map, of the part mapped since in that map.

    X_KM: (k, 3) poses of the frame in K, probability: (k,) of each. surfaces: (p, 4) of the map, m in K, with normals.
    """

    X_KM: Annotated[FloatArray, "k", 3]
    probability: Annotated[FloatArray, "k"]
    surfaces: Annotated[FloatArray, "p", 4]

    @property
    def likely(self) -> int:
        """The number of likely places."""
        return int(np.count_nonzero(self.probability > LIKELY))


@message
class SaidPose:
    """The robot's pose as stated by a person, in the world W of the map that the session began with.

    stamp: s, time of the statement. count: number of statements so far. X_WB: (3,), m and rad. sigma: (2,) its standard
    deviations, m and rad.
    """

    stamp: float = -math.inf
    count: int = 0
    X_WB: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(3))
    sigma: FloatArray = dataclasses.field(default_factory=lambda: np.array([0.5, 0.3]))


@message
class Observation:
    """Sightings of a turn, glance or piece of way. ids: (n,) tags. stamps: (t,) s and X_AB: (t, 3), its poses in its
    arrival frame A."""

    ids: Annotated[IntArray, "n"]
    stamps: Annotated[FloatArray, "t"]
    X_AB: Annotated[FloatArray, "t", 3]


# Landmarks with lower ids are walls.
WALLS_BELOW = -(1 << 40)


def is_tag(ids: IntArray) -> BoolArray:
    """Return a mask of the landmarks (n,) that are tags, not walls. The first wall of a map has the id WALLS_BELOW - 1,
    each further one the next lower; a wall keeps its id."""
    return np.asarray(ids >= WALLS_BELOW)


@message
class MapEstimate:
    """The Gaussian of landmarks and departure pose after a view (MAP and its marginal covariance).

    stage: number of views k. stamp: s. ids: (n,) ascending: numbers of tags, and of walls, see `is_tag`. p_ML: (n, 2),
    m; for a wall the angle of its normal, rad, and its distance along the normal from its anchor, m. anchor: (n, 2) m,
    and reach: (n, 2) extent of the wall along its normal turned left by 90 degrees, m from the anchor; zero for a tag.
    X_MD: (3,) the last departure pose. local: (m,) rows of the jointly known landmarks, ascending: all in a small map,
    those around the last departure in a large one. covariance: (2m + 3, 2m + 3) of (p_ML[local] row by row, X_MD).
    landmark_covariance: (n, 2, 2) of each landmark; if it is not local, from when the robot was last near. X_MA: (k, 3)
    arrival poses of all views. observation: of the newest view. entropy: of the landmarks, 1/2 log|2 pi e Sigma_L|,
    nats (the paper's objective). doubtful: (d,) ids, ascending, of doubtful tags, landmarks or not. doubtful_places:
    (d, 2) the best supported place of each, in M, m. frame_worth: information of one frame in a long sequence, as a
    share of an independent one's; below 1 if the noise is correlated in time. tag_error: (2,) standard deviations of
    the tags' constant errors of range, m, and bearing, rad. shared: (q,) the shared parameters
    (`tfg_drake.slam.shared`), with_shared: (2m + 3 + q, q) their covariance with (p_ML[local] row by row, X_MD,
    shared). by_walls: True if walls also determine the pose at every view.
    """

    stage: int
    stamp: float
    ids: Annotated[IntArray, "n"]
    p_ML: Annotated[FloatArray, "n", 2]
    anchor: Annotated[FloatArray, "n", 2]
    reach: Annotated[FloatArray, "n", 2]
    X_MD: Annotated[FloatArray, 3]
    local: Annotated[IntArray, "m"]
    covariance: Annotated[FloatArray, "2m+3", "2m+3"]
    landmark_covariance: Annotated[FloatArray, "n", 2, 2]
    X_MA: Annotated[FloatArray, "k", 3]
    observation: Observation
    entropy: float
    doubtful: Annotated[IntArray, "d"] = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    doubtful_places: Annotated[FloatArray, "d", 2] = dataclasses.field(default_factory=lambda: np.zeros((0, 2)))
    frame_worth: float = 1.0
    tag_error: Annotated[FloatArray, 2] = dataclasses.field(default_factory=lambda: np.zeros(2))
    shared: Annotated[FloatArray, "q"] = dataclasses.field(default_factory=lambda: np.zeros(0))
    with_shared: FloatArray = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))
    by_walls: bool = False

    @property
    def is_doubtful(self) -> BoolArray:
        """Mask of the landmarks (n,) that are doubtful."""
        return np.isin(self.ids, self.doubtful)

    @property
    def places(self) -> FloatArray:
        """The places (n, 2) of the landmarks in M, m; for a wall its point nearest to the anchor."""
        walls = ~is_tag(self.ids)
        angle, distance = self.p_ML[walls].T
        places = self.p_ML.copy()
        places[walls] = self.anchor[walls] + distance[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        return places

    @property
    def of_tags(self) -> MapEstimate:
        """The map without its walls."""
        return self if is_tag(self.ids).all() else self._without_walls

    @functools.cached_property
    def _without_walls(self) -> MapEstimate:
        # Not itself where there are none: it would hold itself in memory.
        return replace(self.of_landmarks(is_tag(self.ids)), by_walls=True)

    @property
    def is_adrift(self) -> bool:
        """Whether the robot is lost in the map: the place of its newest part relative to the rest is unknown."""
        return bool(np.trace(self.covariance[-3:-1, -3:-1]) > ADRIFT**2)

    @property
    def is_joint(self) -> bool:
        """Whether all landmarks are jointly known."""
        return len(self.local) == len(self.ids)

    @property
    def is_local(self) -> BoolArray:
        """Mask of the jointly known landmarks (n,)."""
        return self.local_entry >= 0

    @property
    def local_entry(self) -> IntArray:
        """The index of each landmark (n,) among those jointly known, -1 for the others."""
        entry = np.full(len(self.ids), -1)
        entry[self.local] = np.arange(len(self.local))
        return entry

    @property
    def joint_covariance(self) -> FloatArray:
        """The covariance (2m + 3 + q, 2m + 3 + q) of (p_ML[local] row by row, X_MD, shared)."""
        m = len(self.covariance)
        joint = np.empty((m + len(self.shared), m + len(self.shared)))
        joint[:m, :m], joint[:, m:], joint[m:, :m] = self.covariance, self.with_shared, self.with_shared[:m].T
        return joint

    def of_landmarks(self, keep: BoolArray) -> MapEstimate:
        """Return the map with some of its landmarks (n,) only, and with all its views."""
        joint = keep[self.local]
        rows = np.append(np.repeat(joint, 2), np.ones(3, dtype=np.bool_))
        with_parameters = np.append(rows, np.ones(len(self.shared), dtype=np.bool_))
        return replace(
            self,
            ids=self.ids[keep],
            p_ML=self.p_ML[keep],
            anchor=self.anchor[keep],
            reach=self.reach[keep],
            local=(np.cumsum(keep) - 1)[self.local[joint]],
            covariance=self.covariance if joint.all() else self.covariance[np.ix_(rows, rows)],
            landmark_covariance=self.landmark_covariance[keep],
            with_shared=self.with_shared[with_parameters] if len(self.shared) else self.with_shared,
        )

    def given_shared(self) -> MapEstimate:
        """The map with its uncertainty given the shared parameters, for planning: a look has the same errors of scale
        and mount as the map, so a formula that assumes independent noise would predict that each look reduces them."""
        if not len(self.shared):
            return self
        m, of_local = len(self.covariance), np.arange(len(self.local))
        across = self.with_shared[:m]
        covariance = self.covariance - across @ np.linalg.solve(self.with_shared[m:], across.T)
        each = self.landmark_covariance.copy()
        each[self.local] = covariance[:-3, :-3].reshape(len(of_local), 2, len(of_local), 2)[of_local, :, of_local, :]
        nothing = np.zeros(0), np.zeros((m, 0))
        return replace(self, covariance=covariance, landmark_covariance=each, shared=nothing[0], with_shared=nothing[1])

    @property
    def local_p_ML(self) -> FloatArray:
        """The values p_ML (m, 2) of the jointly known landmarks."""
        return self.p_ML[self.local]


@message
class TfgMap:
    """The topological feature graph resolved in the map frame: what planning and pictures need.

    stage: number of views in it. segments: (m, 4) obstacle surface pieces x0, y0, x1, y1 in M, m, without those that
    have drifted (see `tfg_drake.tfg.overlap`). segment_kind: (m,) 0 edge, of a wall or between two tags, 1
    surface with a tag at one end, 2 surface without a landmark. segment_ids: (m, 2) ids of the landmarks that it joins:
    the wall that it lies on, twice, or the tags where it begins and ends, -1 where there is none. A tag without a
    surface is a piece of no length. facing: (n, 2) unit vectors in M, row for row
    with MapEstimate.ids: the side from which each landmark was seen, zero where its surfaces have drifted. frontiers:
    (f, 2) points in M, a little inside the unknown, frontier_length: (f,) m of frontier each stands for,
    frontier_normal: (f, 2) unit vectors pointing from the unknown back to where the frontier was seen from; where it
    lies in front of a surface not seen well enough, that surface's normal. Every piece of surface was seen from its
    left. star_offsets: (k + 1,) and star_vertices: (v, 2): star j, the free polygon seen from view j, has the vertices
    star_offsets[j]:star_offsets[j + 1] in M, counter-clockwise round star_centers[j]. star_centers: (k, 2). given_up:
    (g, 2) points of open frontier that were tried in vain as often as the explorer tries, wide enough for the robot,
    given_up_length: (g,) m, given_up_normal: (g, 2). inspected: m of surface that was seen well enough to find a tag
    there. keep_out: (o, 4) segments that surround and fill the keep-out areas, m in M; they do not block sight.
    """

    stage: int
    segments: Annotated[FloatArray, "m", 4]
    segment_kind: Annotated[IntArray, "m"]
    segment_ids: Annotated[IntArray, "m", 2]
    facing: Annotated[FloatArray, "n", 2]
    frontiers: Annotated[FloatArray, "f", 2]
    frontier_length: Annotated[FloatArray, "f"]
    frontier_normal: Annotated[FloatArray, "f", 2]
    star_offsets: Annotated[IntArray, "k+1"]
    star_vertices: Annotated[FloatArray, "v", 2]
    star_centers: Annotated[FloatArray, "k", 2]
    given_up: Annotated[FloatArray, "g", 2] = dataclasses.field(default_factory=lambda: np.zeros((0, 2)))
    given_up_length: Annotated[FloatArray, "g"] = dataclasses.field(default_factory=lambda: np.zeros(0))
    given_up_normal: Annotated[FloatArray, "g", 2] = dataclasses.field(default_factory=lambda: np.zeros((0, 2)))
    inspected: float = dataclasses.field(default=0.0, metadata={"kept": False})
    keep_out: Annotated[FloatArray, "o", 4] = dataclasses.field(
        default_factory=lambda: np.zeros((0, 4)), metadata={"kept": False}
    )

    @property
    def obstacles(self) -> FloatArray:
        """The segments that the robot must keep clear of, (m + o, 4), m in M: surfaces and keep_out."""
        return _freeze(np.vstack([self.segments, self.keep_out])) if len(self.keep_out) else self.segments


@message
class GridMap:
    """An occupancy grid in the map frame, for the grid methods.

    stage: number of views. stamp: s, of the newest scan in it. resolution: side of a cell, m. origin: (2,) the
    corner of cell [0, 0] with the least x and y, in M, m. probability: (h, w) of occupancy, 0.5 for unmeasured cells;
    rows run along y, columns along x.
    """

    stage: int
    stamp: float
    resolution: float
    origin: FloatArray
    probability: NDArray[np.float32]


@message
class Roadmap:
    """The probabilistic roadmap of one stage, in the map frame.

    stage. points: (n, 2) m. edges: (e, 2) node indices, those within the chance constraint. reachable: (n,) from the
    robot's place, along edges. enterable: (n,) the whole way has room for the robot, though perhaps not for its
    uncertainty. entry: (n,) the last reachable node on the way to each enterable one, -1 for others. travel_time: (n,)
    expected time from the robot, s, turns included, inf if unreachable, travel_length: (n,) m. home_time and
    home_length: (n,) the same between each node and the start, empty unless the robot must return home. driven: m, so
    far. frontier_offsets: (n + 1,), frontier_index: node i sees the rows frontier_index[frontier_offsets[i]:...] of
    TfgMap.frontiers; computed only for places where the robot fits and has not turned yet. ids: (n,) ascending, of the
    nodes, constant from stage to stage; empty if an id is the index. once_open: (n,) the whole way was free with room
    for the robot, but surfaces cross it now; empty for none. need: (n,) m, the clearance that a way needs for the
    robot's deviation at each node; empty if unknown.
    """

    stage: int
    points: Annotated[FloatArray, "n", 2]
    edges: Annotated[IntArray, "e", 2]
    reachable: Annotated[BoolArray, "n"]
    enterable: Annotated[BoolArray, "n"]
    entry: Annotated[IntArray, "n"]
    travel_time: Annotated[FloatArray, "n"]
    travel_length: Annotated[FloatArray, "n"]
    home_time: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(0))
    home_length: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(0))
    driven: float = 0.0
    frontier_offsets: IntArray = dataclasses.field(default_factory=lambda: np.zeros(1, dtype=np.int64))
    frontier_index: IntArray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    ids: IntArray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    once_open: BoolArray = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    need: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(0))

    def node_ids(self, nodes: IntArray) -> IntArray:
        """Return the ids of nodes, which are constant from stage to stage, unlike their indices."""
        return self.ids[nodes] if len(self.ids) else nodes

    def nodes(self, node_ids: IntArray) -> IntArray:
        """Return the nodes with these ids, -1 for those that are not in this roadmap."""
        ids = self.node_ids(np.arange(len(self.points)))
        if not len(ids):
            return np.full(len(node_ids), -1)
        rows = np.searchsorted(ids, node_ids)
        return np.where(ids[rows.clip(max=len(ids) - 1)] == node_ids, rows, -1)

    def reaches(self, node_ids: IntArray, within: float = math.inf) -> BoolArray:
        """Return whether the nodes with these ids are in this roadmap and reachable by a way within a length, m."""
        nodes = self.nodes(node_ids)
        near = self.reachable & (self.travel_length <= within)
        return np.asarray((nodes >= 0) & np.append(near, False)[nodes])


@message
class GoalChoice:
    """The goal chosen at one stage, and its candidates.

    stage. node: its id in the roadmap, -1 for none. p_MG: (2,). candidates: (c,) ids of the nodes evaluated,
    exploitation, exploration, pose_price: (c,) nats (gain = exploitation + exploration, price included in it).
    value: (c,) the maximised value. verdict: "goal", "look" to turn in place, or the outcome of the mission,
    "complete", "stuck" or "budget", which takes effect once the robot is at the node, if there is one: home. reason:
    one sentence. latest_arrival: s, time by which the robot must be at the goal or turn back. spent: the goal's
    frontiers have been seen on the way, so the next goal can be chosen at once. look: (l,) headings, rad in M, in which
    the robot looks at the goal; empty for all around. looked_again: (t,) ids of the nodes to which the robot has
    returned before the mission ends, for a passage that was too narrow or a doubtful tag. longest_way: m from the place
    of the choice; after a longer way the robot could not return home within its budget. explored: s, since when nothing
    has been left to explore and goals serve accuracy alone; otherwise inf. tour: (s,) ids of the candidates to visit in
    this order, the goal first; empty without a tour.
    """

    stage: int
    node: int
    p_MG: Annotated[FloatArray, 2]
    candidates: Annotated[IntArray, "c"]
    exploitation: Annotated[FloatArray, "c"]
    exploration: Annotated[FloatArray, "c"]
    pose_price: Annotated[FloatArray, "c"]
    gain: Annotated[FloatArray, "c"]
    value: Annotated[FloatArray, "c"]
    verdict: str
    reason: str
    latest_arrival: float = math.inf
    spent: bool = False
    look: Annotated[FloatArray, "l"] = dataclasses.field(default_factory=lambda: np.zeros(0))
    looked_again: Annotated[IntArray, "t"] = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    explored: float = math.inf
    longest_way: float = math.inf
    tour: Annotated[IntArray, "s"] = dataclasses.field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @property
    def is_explored(self) -> bool:
        """Whether nothing is left to explore; then landmarks all over a large map must be jointly known."""
        return math.isfinite(self.explored)


@message
class Path:
    """A path to follow. id: increases with every new path. stage: that of the mission. points: (n, 2) in M, m; empty if
    none was found, so that the goal is given up.

    The mission stays in phase "plan" until there is a Path with stage == mission.stage and id > mission.path_id. It
    returns to that phase, with one more of mission.replans, to ask for another path to the same goal.
    """

    id: int
    stage: int
    points: Annotated[FloatArray, "n", 2]


@message
class MissionStatus:
    """The status of the mission.

    phase: "observe" (turning in place at a goal), "glance" (looking ahead for a moment on the way), "map" (solving the
    observation), "choose", "plan", "follow", "done", or "paused". stage: number of views in the map. since: s, start of
    the phase. resume_phase: the phase after a pause, "" otherwise. outcome: "" until done, then complete, stuck, budget
    or interrupted; from outside a mission ends by time_limit, battery or fault. reason: one sentence, if done or
    paused. replans: number of paths requested after the first since the robot last stood and looked. path_id: the
    current path. failures: number of consecutive unreachable goals. moving: the robot continues along its path after a
    glance until there is a new one. changes: number of goals replaced on the way since the robot last stood and looked.
    """

    phase: str
    stage: int
    since: float
    resume_phase: str = ""
    outcome: str = ""
    reason: str = ""
    replans: int = 0
    path_id: int = 0
    failures: int = 0
    moving: bool = False
    changes: int = 0

    @property
    def drives(self) -> bool:
        """Whether the robot follows its path."""
        return self.phase in ("follow", "glance") or (self.moving and self.phase in ("map", "choose", "plan"))


@message
class FollowerStatus:
    """The progress of the follower, which drives while mission.drives, turns in phase "observe" and otherwise stands.

    stamp: s. path_id: the path it follows; arrived, stalled and left count while it is mission.path_id. arrived: it is
    at that path's end. turn_done: the turn of the current observation is complete; counts if stamp > mission.since +
    0.125. stalled: the robot has not moved for some time although commanded to. left: m of the path ahead. At 1 m or
    less the mission glances at once if the path is longer than 1 m, so with left = 0 at each of these paths.
    """

    stamp: float
    path_id: int
    arrived: bool
    turn_done: bool
    stalled: bool = False
    left: float = 0.0


@message
class PathStatus:
    """The state of the path with this id. free: no obstacle in the scan blocks the rest of it; false counts while the
    id is mission.path_id. unreachable: no path leads to the goal, and the planner leaves it to the goal selector to
    choose another at once."""

    path_id: int
    free: bool
    unreachable: bool = False
