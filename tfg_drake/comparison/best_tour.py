"""The best tour of a known map: how soon a robot that knew all walls could have seen what a mission has to see.

A tour is a chain of stops that the robot drives through by the shortest ways, ending anywhere. What it sees while it
drives counts, and a stop may have a look, a turn in place to a heading. The search is greedy, then ruin and recreate
(Schrimpf et al. 2000): stops are left out at random, others put in, pieces turned round. The tour that it finds is
driven and judged pose by pose.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from tfg_drake.comparison.curves import STEP, TURN, seen_from, view_rows
from tfg_drake.comparison.known_ways import known_ways
from tfg_drake.config import NODE_MARGIN, RobotConfig, ScanConfig, TagSensorConfig
from tfg_drake.geometry.se2 import wrap_angle
from tfg_drake.messages import BoolArray, FloatArray, message
from tfg_drake.slam.odometry_model import wrap
from tfg_drake.table import take
from tfg_drake.world.world import World

# Bends sharper than this, rad, are turned in place; at others the robot may cut corners by NODE_MARGIN, which ways keep
# from walls beyond its radius.
SHARPEST = 0.5 * math.pi
# Spacing of a driven tour's poses, s, and rad of a turn in place.
PERIOD, TURN_STEP = 0.1, 0.1
# Number of headings of a look.
HEADINGS = 16
# Greatest number of cells in the search; of more every n-th in x and y is used.
CELLS = 5000
# Stops lie on a lattice with step COARSE, m, then on one with step FINE, m, within AROUND, m, of those found.
COARSE, FINE, AROUND = 1.0, 0.35, 0.8
# Number of stops and looks evaluated exactly at each step of the repair, and the relative noise on the others' values,
# which makes repairs differ.
TRIED, NOISE = 6, 0.3
# Share of the stops that an iteration of the search keeps.
KEPT = 0.6
# Weight of a missed tag, in cells.
TAG_WEIGHT = 20

# Number of attempts until a driven tour has seen enough.
ATTEMPTS = 20

Stop = tuple[int, int]
# Which points are seen, eight to a byte.
Bits = NDArray[np.uint8]


@message
class ToSee:
    """What has to be seen.

    points: (t, 2) m in W. normals: (t, 2) unit, of tags; 0 of the floor's cells. limits: (t, 3) range, m, half of the
    field of view, rad, and the least cosine of the incidence. is_tag: (t,) all of these must be seen; of the others a
    share.
    """

    points: Annotated[FloatArray, "t", 2]
    normals: Annotated[FloatArray, "t", 2]
    limits: Annotated[FloatArray, "t", 3]
    is_tag: Annotated[BoolArray, "t"]
    share: float


def to_see(
    cells: FloatArray, world: World, tags: BoolArray, share: float, scan: ScanConfig, eyes: TagSensorConfig
) -> ToSee:
    """A share of the cells (c, 2), m in W, by the scanner and those of the world's tags that are marked (n,)."""
    normals = np.column_stack([np.cos(world.tag_facing[tags]), np.sin(world.tag_facing[tags])])
    of_cells, of_tags = (scan.range, 0.5 * scan.field_of_view, -1.0), (eyes.range, 0.5 * eyes.field_of_view, 0.0)
    limits = np.vstack([np.tile(of_cells, (len(cells), 1)), np.tile(of_tags, (len(normals), 1))])
    limits[len(cells) :, 2] = math.cos(eyes.max_incidence)
    points, normals = np.vstack([cells, world.p_WT[tags]]), np.vstack([np.zeros((len(cells), 2)), normals])
    return ToSee(points, normals, limits, np.arange(len(points)) >= len(cells), share)


@dataclasses.dataclass(frozen=True)
class BestTour:
    """A tour up to where it has seen enough.

    stamps: (n,) s. X_WB: (n, 3). is_enough: False where no tour was found that sees enough.
    """

    stamps: FloatArray
    X_WB: FloatArray
    is_enough: bool

    @property
    def time(self) -> float:
        """How long it takes, s."""
        return float(self.stamps[-1])

    @property
    def distance(self) -> float:
        """How long it is, m."""
        return float(np.hypot(*np.diff(self.X_WB[:, :2], axis=0).T).sum())


def turn_time(angle: float, robot: RobotConfig) -> float:
    """How long a turn in place by an angle (rad) takes, s."""
    angle, rate, change = abs(angle), robot.max_turn_rate, robot.max_turn_acceleration
    ramp = rate / change
    return angle / rate + ramp if angle > rate * ramp else 2.0 * math.sqrt(angle / change)


def _arc(angle: float, before: float, after: float, robot: RobotConfig) -> tuple[float, float, float]:
    """Of the arc round a bend by an angle (rad) between pieces of these lengths (m): how far from the bend it begins,
    its length, m, and the speed on it, m/s."""
    angle = abs(angle)
    if angle < 1e-6:
        return 0.0, 0.0, robot.max_speed
    half = math.tan(0.5 * angle)
    radius = min(NODE_MARGIN / (1.0 / math.cos(0.5 * angle) - 1.0), 0.5 * min(before, after) / half)
    return radius * half, radius * angle, min(robot.max_speed, radius * robot.max_turn_rate)


def driven(points: FloatArray, looks: FloatArray, heading: float, robot: RobotConfig) -> tuple[FloatArray, FloatArray]:
    """Stamps (n,), s, and poses (n, 3) of a robot that drives along points (m, 2) as fast as it may.

    looks: (m,) heading, rad, that it turns to at a point; nan: none. heading: at the first point, where it stands, rad.
    """
    kept = np.append(True, (np.hypot(*np.diff(points, axis=0).T) > 1e-9) | np.isfinite(looks[1:]))
    points, looks = points[kept], looks[kept]
    d = np.diff(points, axis=0)
    length, along = np.hypot(*d.T), np.arctan2(d[:, 1], d[:, 0])
    arcs = [(0.0, 0.0, 0.0)]
    for i in range(1, len(d)):
        bend = float(wrap_angle(along[i] - along[i - 1]))
        is_stop = math.isfinite(looks[i]) or abs(bend) > SHARPEST
        arcs.append((0.0, 0.0, 0.0) if is_stop else _arc(bend, float(length[i - 1]), float(length[i]), robot))
    arcs.append((0.0, 0.0, 0.0 if math.isfinite(looks[-1]) else robot.max_speed))
    begin, arc, speed = np.array(arcs).T
    straight = np.maximum(length - begin[:-1] - begin[1:], 0.0)
    change = robot.max_acceleration
    for i in range(len(d)):
        speed[i + 1] = min(speed[i + 1], math.sqrt(speed[i] ** 2 + 2.0 * change * straight[i]))
    for i in range(len(d) - 1, -1, -1):
        speed[i] = min(speed[i], math.sqrt(speed[i + 1] ** 2 + 2.0 * change * straight[i]))
    stamps, poses = [np.zeros(1)], [np.append(points[0], heading)[None]]

    def go_on(after: FloatArray, X: FloatArray) -> None:
        stamps.append(stamps[-1][-1] + after)
        poses.append(X)

    def turn(to: float) -> None:
        x, y, now = poses[-1][-1]
        angle = float(wrap_angle(to - now))
        share = np.linspace(0.0, 1.0, 2 + int(abs(angle) / TURN_STEP))[1:]
        go_on(turn_time(angle, robot) * share, np.column_stack([np.tile([x, y], (len(share), 1)), now + angle * share]))

    for i in range(len(points)):
        if math.isfinite(looks[i]):
            turn(float(looks[i]))
        if i == len(d):
            break
        if arc[i] > 0.0:  # an arc from along[i - 1] to along[i]
            angle = float(wrap_angle(along[i] - along[i - 1]))
            share, radius = np.linspace(0.0, 1.0, 5)[1:], arc[i] / angle
            headings = along[i - 1] + angle * share
            centre = poses[-1][-1, :2] + radius * np.array([-math.sin(along[i - 1]), math.cos(along[i - 1])])
            places = centre + radius * np.column_stack([np.sin(headings), -np.cos(headings)])
            go_on(arc[i] / speed[i] * share, np.column_stack([places, headings]))
        else:
            turn(float(along[i]))
        from_speed, to_speed, s = speed[i], speed[i + 1], straight[i]
        peak = min(robot.max_speed, math.sqrt(0.5 * (from_speed**2 + to_speed**2) + change * s))
        up, down = (peak - from_speed) / change, (peak - to_speed) / change
        level = max(0.0, s - 0.5 * (peak + from_speed) * up - 0.5 * (peak + to_speed) * down) / max(peak, 1e-9)
        t = np.linspace(0.0, up + level + down, 2 + int((up + level + down) / PERIOD))[1:]
        rising, falling = np.minimum(t, up), np.maximum(t - up - level, 0.0)
        done = from_speed * rising + 0.5 * change * rising**2 + peak * (t - rising) - 0.5 * change * falling**2
        ahead = np.array([math.cos(along[i]), math.sin(along[i])])
        places = points[i] + (begin[i] + np.minimum(done, s))[:, None] * ahead
        go_on(t, np.column_stack([places, np.full(len(t), along[i])]))
    return np.concatenate(stamps), np.concatenate(poses)


class Search:
    """Tours through places, the first of which is where the robot starts.

    A stop is (place, heading): the row of the place, and the number of the heading that it looks at there, -1 for none.
    """

    def __init__(
        self,
        places: FloatArray,
        walls: FloatArray,
        see: ToSee,
        heading: float,
        robot: RobotConfig,
        keep_out: FloatArray | None = None,
    ) -> None:
        """places: (p, 2) m in W. heading: at the start, rad. keep_out: as of `best_tour`."""
        self._walls, self._heading, self._robot = walls, heading, robot
        obstacles = walls if keep_out is None else np.vstack([walls, keep_out])
        self._ways = known_ways(obstacles, places, robot.radius + NODE_MARGIN)
        around = self._seen_all_round(places, see)
        self.is_visible = np.asarray(around.any(axis=0))
        # Cells that are visible from no place are not required, as otherwise there would be no tour.
        self._see, self.places = take(see, self.is_visible), places
        self._around = np.packbits(around[:, self.is_visible], axis=1)
        self._tags = np.packbits(self._see.is_tag)
        cells = int(np.count_nonzero(~see.is_tag))
        hidden = int(np.count_nonzero(~self.is_visible & ~see.is_tag))
        self._may_miss = max(0, math.floor((1.0 - see.share) * cells + 1e-9) - hidden)
        self._legs: dict[tuple[int, int], tuple[float, float, float]] = {}
        self._views: dict[tuple[int, int, int], Bits] = {}

    def _seen_all_round(self, places: FloatArray, see: ToSee) -> BoolArray:
        """Which of t points is seen from each place, turning there: (p, t)."""
        limits = see.limits.copy()
        limits[:, 1] = math.pi
        seen = [seen_from(np.append(p, 0.0)[None], see.points, see.normals, limits, self._walls) == 0 for p in places]
        reached = np.isfinite(self._ways.length[0])
        return np.asarray(np.array(seen).reshape(len(places), -1) & reached[:, None])

    def _bend(self, angle: float) -> float:
        """Seconds that a bend by an angle (rad, not negative) costs more than driving on."""
        robot = self._robot
        stop = robot.max_speed / robot.max_acceleration + turn_time(angle, robot)
        if angle > SHARPEST:
            return stop
        begin, arc, speed = _arc(angle, math.inf, math.inf, robot)
        slower = (robot.max_speed - speed) ** 2 / (robot.max_speed * robot.max_acceleration)
        return min(stop, slower + (arc / speed if arc else 0.0) - 2.0 * begin / robot.max_speed)

    def _leg(self, i: int, j: int) -> tuple[float, float, float]:
        """Time, s, and first and last heading, rad, of the way from place i to place j."""
        if (i, j) not in self._legs:
            d = np.diff(self._ways.way(i, j), axis=0)
            along = np.arctan2(d[:, 1], d[:, 0])
            bends = sum(self._bend(abs(wrap(angle))) for angle in np.diff(along).tolist())
            time = float(self._ways.length[i, j]) / self._robot.max_speed + bends
            self._legs[i, j] = time, float(along[0]), float(along[-1])
        return self._legs[i, j]

    def _view(self, i: int, j: int, look: int) -> Bits:
        """Bits of what is seen on the way from place i to place j, and by a look there."""
        key = i, j, look
        if key not in self._views:
            if look >= 0:
                poses = np.append(self.places[j], 2.0 * math.pi / HEADINGS * look)[None]
                self._views[key] = self._view(i, j, -1) | self._bits(poses)
            else:
                way = self._ways.way(i, j)
                _, poses = driven(way, np.full(len(way), np.nan), self._leg(i, j)[1] if i != j else 0.0, self._robot)
                self._views[key] = self._bits(_thin(poses))
        return self._views[key]

    def _bits(self, X_WB: FloatArray) -> Bits:
        see = self._see
        first = seen_from(X_WB, see.points, see.normals, see.limits, self._walls)
        return np.packbits(first < len(X_WB))

    def time(self, stops: Sequence[Stop]) -> float:
        """How long a tour takes, s, about: as if all pieces of it were long."""
        robot = self._robot
        here, heading, stands = 0, self._heading, True
        time = 0.5 * robot.max_speed / robot.max_acceleration
        for place, look in stops:
            if place != here:
                leg, first, last = self._leg(here, place)
                angle = abs(wrap(first - heading))
                time += turn_time(angle, robot) if stands else self._bend(angle)
                time += leg
                here, heading, stands = place, last, False
            if look >= 0:
                to = 2.0 * math.pi / HEADINGS * look
                time += turn_time(abs(wrap(to - heading)), robot)
                time += 0.0 if stands else robot.max_speed / robot.max_acceleration
                heading, stands = to, True
        return time

    def _all_views(self, stops: Sequence[Stop]) -> list[Bits]:
        begin = np.append(self.places[0], self._heading)[None]
        if (0, 0, -1) not in self._views:
            self._views[0, 0, -1] = self._bits(begin)
        chain = zip([(0, -1), *stops], stops, strict=False)
        return [self._views[0, 0, -1], *(self._view(a, b, look) for (a, _), (b, look) in chain)]

    def lacks(self, seen: Bits) -> float:
        """By how many cells what is seen (bits) is not enough; see TAG_WEIGHT."""
        tags = int(np.bitwise_count(self._tags & ~seen).sum())
        cells = len(self._see.is_tag) - int(np.bitwise_count(seen).sum()) - tags
        return max(0, cells - self._may_miss) + TAG_WEIGHT * tags

    def is_enough(self, stops: Sequence[Stop]) -> bool:
        """Whether a tour sees enough."""
        return self.lacks(np.bitwise_or.reduce(self._all_views(stops))) == 0

    def repaired(self, stops: list[Stop], rng: np.random.Generator) -> list[Stop] | None:
        """A tour with stops more until it sees enough, those first that show most for their time; None if none does."""
        length, speed = self._ways.length, self._robot.max_speed
        while True:
            views = self._all_views(stops)
            seen = np.bitwise_or.reduce(views)
            lack = self.lacks(seen)
            if lack == 0:
                return stops
            missed = self._around & ~seen
            tags = np.bitwise_count(missed & self._tags).sum(axis=1)
            cells = np.bitwise_count(missed).sum(axis=1) - tags
            most = int(np.bitwise_count(self._tags & ~seen).sum()) * TAG_WEIGHT
            gain = np.minimum(cells, lack - most) + TAG_WEIGHT * tags
            here = np.array([0, *(place for place, _ in stops)])
            more = length[here] + np.vstack([length[here[1:]] - length[here[:-1], here[1:]][:, None], 0.0 * length[:1]])
            value = np.where(gain > 0, gain / (np.maximum(more, 0.0) / speed + 1.0), 0.0)
            value *= np.exp(NOISE * rng.standard_normal(value.shape))
            time = self.time(stops)
            best, found = 0.0, stops
            for flat in np.argsort(-value, axis=None)[: TRIED if len(stops) else 3 * TRIED].tolist():
                at, place = divmod(flat, len(self.places))
                if value[at, place] <= 0.0 or not math.isfinite(more[at, place]):
                    continue
                for look in (-1, self._looks_at(place, missed[place])):
                    if (place == here[at] and look < 0) or (at < len(stops) and place == here[at + 1]):
                        continue
                    tried = [*stops[:at], (place, look), *stops[at:]]
                    got = lack - self.lacks(np.bitwise_or.reduce(self._all_views(tried)))
                    worth = got / (max(0.0, self.time(tried) - time) + 0.3)
                    if worth > best:
                        best, found = worth, tried
            if best == 0.0:
                return None
            stops = found

    def _looks_at(self, place: int, missed: Bits) -> int:
        """The number of the heading in which most of what is missed (bits) lies from a place."""
        rows = np.unpackbits(missed, count=len(self._see.points)).astype(np.bool_)
        d = self._see.points[rows] - self.places[place]
        bearing = np.arctan2(d[:, 1], d[:, 0])
        middle = math.atan2(float(np.sin(bearing).sum()), float(np.cos(bearing).sum()))
        return round(middle * HEADINGS / (2.0 * math.pi)) % HEADINGS

    def leaner(self, stops: list[Stop]) -> list[Stop]:
        """The tour without stops that it sees enough without, and with pieces of it the other way round where that is
        shorter (2-opt)."""
        n = len(stops)
        fewer = [stops[:i] + stops[i + 1 :] for i in range(n)]
        turned = [stops[:i] + stops[i:j][::-1] + stops[j:] for i in range(n) for j in range(i + 2, n + 1)]
        for tried in fewer + turned:
            if _goes(tried) and self.time(tried) < self.time(stops) - 1e-6 and self.is_enough(tried):
                return self.leaner(tried)
        return stops

    def best(self, stops: list[Stop], rounds: int, rng: np.random.Generator) -> list[Stop] | None:
        """The best tour found in so many rounds of ruin and recreate from stops; None where none sees enough."""
        first = self.repaired(stops, rng)
        if first is None:
            return None
        best = self.leaner(first)
        for _ in range(rounds if best else 0):
            rest = [stop for stop in best if rng.uniform() < KEPT]
            tried = self.repaired(rest, rng) if _goes(rest) else None
            if tried is not None and self.time(tried := self.leaner(tried)) < self.time(best):
                best = tried
        return best

    def correct(self, stops: Sequence[Stop]) -> None:
        """Takes back what the views of a tour promise and the robot, which cuts corners, does not see when it drives
        it; where that is enough, too, of the cells that the search counts, more of them is asked for."""
        views = self._all_views(stops)
        _, X_WB = self.drive(stops)
        seen = self._bits(X_WB[view_rows(X_WB)])
        for view in views:
            view &= seen
        if self.is_enough(stops):
            self._may_miss -= max(1, self._may_miss // 10)

    def drive(self, stops: Sequence[Stop]) -> tuple[FloatArray, FloatArray]:
        """Stamps (n,), s, and poses (n, 3) of a tour."""
        points, looks, here = [self.places[:1]], [np.full(1, np.nan)], 0
        for place, look in stops:
            way = self._ways.way(here, place)[1:] if place != here else self.places[[place]]
            points.append(way)
            looks.append(np.full(len(way), np.nan))
            if look >= 0:
                looks[-1][-1] = 2.0 * math.pi / HEADINGS * look
            here = place
        return driven(np.concatenate(points), np.concatenate(looks), self._heading, self._robot)


def _thin(X_WB: FloatArray) -> FloatArray:
    """Of poses (n, 3) the first, the last and some between, about STEP or TURN apart."""
    d = np.diff(X_WB, axis=0)
    gone = np.cumsum(np.hypot(d[:, 0], d[:, 1]) / STEP + np.abs(wrap_angle(d[:, 2])) / TURN).astype(np.int64)
    return X_WB[np.flatnonzero(np.append(True, np.diff(gone, prepend=0) > 0) | (np.arange(len(X_WB)) == len(d)))]


def _goes(stops: Sequence[Stop]) -> bool:
    """Whether no stop follows upon itself or stays at the start without a look."""
    chain = zip([(0, -1), *stops], stops, strict=False)
    return all(a != b or look >= 0 for (a, _), (b, look) in chain)


def best_tour(
    world: World,
    cells: FloatArray,
    see: ToSee,
    robot: RobotConfig,
    keep_out: FloatArray | None = None,
    rounds: int = 45,
    say: Callable[[str], object] = lambda line: None,
) -> BestTour:
    """The best tour found of a world.

    cells: (c, 2) m in W, all places where the robot may be. keep_out: (k, 4) m in W, what else than walls it does not
    drive through. rounds: of the search, on the coarse lattice and on the fine one. say: is told how far it is.
    """
    thinned, start, coarse = _thinned(see), world.start[:2], _lattice(cells, COARSE)

    def search_among(*places: FloatArray) -> Search:
        return Search(np.vstack([start, *places]), world.walls, thinned, float(world.start[2]), robot, keep_out)

    search, none = search_among(coarse), BestTour(np.zeros(1), world.start[None], False)
    found = search.best([], rounds, np.random.default_rng(0))
    if found is None:
        return none
    say(f"coarsely: {search.time(found):.1f} s")
    chosen = search.places[[place for place, _ in found]]
    fine = _lattice(cells, FINE)
    near = np.hypot(*(fine[:, None] - chosen).transpose(2, 0, 1)).min(axis=1, initial=np.inf) <= AROUND
    stops = [(1 + k, look) for k, (_, look) in enumerate(found)]
    search = search_among(chosen, fine[near], coarse)
    # A tag that no stop sees is not asked for.
    shown = take(see, np.append(~see.is_tag[~see.is_tag], search.is_visible[thinned.is_tag]))
    best, rng = none, np.random.default_rng(1)
    for k in range(ATTEMPTS):
        better = search.best(stops, rounds if k == 0 else rounds // 10, rng)
        if better is None:
            break
        stops = better
        best = judged(*search.drive(stops), shown, world.walls)
        say(f"finer: {best.time:.1f} s, {best.distance:.1f} m" + ("" if best.is_enough else ", does not see enough"))
        if best.is_enough:
            break
        search.correct(stops)
    return best


def judged(stamps: FloatArray, X_WB: FloatArray, see: ToSee, walls: FloatArray) -> BestTour:
    """A tour up to where it has seen enough of all, by the views that a mission is judged by."""
    rows = view_rows(X_WB)
    first = seen_from(X_WB[rows], see.points, see.normals, see.limits, walls)
    of_tags = np.max(first[see.is_tag], initial=0)
    of_cells = np.sort(first[~see.is_tag])
    needed = math.ceil(see.share * len(of_cells) - 1e-9)
    last = max(of_tags, of_cells[needed - 1] if needed else 0)
    end = rows[min(last, len(rows) - 1)] + 1
    return BestTour(stamps[:end], X_WB[:end], bool(last < len(rows)))


def _thinned(see: ToSee) -> ToSee:
    """With so many cells at most: of more, every n-th of rows and columns."""
    p = see.points[~see.is_tag]
    kept = np.ones(len(p), dtype=np.bool_)
    n = 1
    while np.count_nonzero(kept) > CELLS:
        n += 1
        # Cells lie on a lattice: its step is the least distance of two of them in x.
        step = np.diff(np.unique(p[:, 0].round(6))).min()
        kept = (np.round((p - p[0]) / step).astype(np.int64) % n == 0).all(axis=1)
    everything = see.is_tag.copy()
    everything[~see.is_tag] = kept
    return take(see, everything)


def _lattice(cells: FloatArray, step: float) -> FloatArray:
    """Of the cells (c, 2), m, in each square of this side (m) the one nearest to its middle."""
    square = np.floor((cells - cells.min(axis=0)) / step)
    off = np.abs(cells - cells.min(axis=0) - (square + 0.5) * step).max(axis=1)
    order = np.lexsort((off, square[:, 1], square[:, 0]))
    _, first = np.unique(square[order], axis=0, return_index=True)
    return np.asarray(cells[order[first]])
