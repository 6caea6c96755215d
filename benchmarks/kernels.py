"""How much quicker the numba kernels of planning are than the same in numpy and in shapely, with equal results.

    python benchmarks/kernels.py

On the walls and tags of `paper`, walls cut to pieces of a metre as a map has them: the clearance of roadmap edges up
to a metre, one robot's lines of sight, what many places see of all tags, which places lie in free space, and the
information gain of candidates. A row a kernel: CPU milliseconds of one call of the kernel, of numpy and of shapely, the
least of --repeat, and by what factor the kernel is quicker. numpy and shapely are used as one would: whole arrays at a
time, prepared geometries, an STRtree. Stops with an AssertionError where a result differs.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import shapely
from scipy.linalg import block_diag
from threadpoolctl import threadpool_limits

from tfg_drake.config import OdometryConfig, TagSensorConfig
from tfg_drake.diagrams.scenario import FindScenario, LoadScenario
from tfg_drake.geometry.distance import clearance
from tfg_drake.geometry.segment_grid import segment_grid
from tfg_drake.geometry.star import inside_any
from tfg_drake.geometry.visibility import cast_rays, line_of_sight
from tfg_drake.messages import BoolArray, FloatArray
from tfg_drake.planning.exact_gain import Arrival, Known, New, exact_gain, to_arrival
from tfg_drake.planning.expected_view import SURFACE_TOLERANCE, visible_targets
from tfg_drake.planning.information_gain import sightings_of_turn, turn_noise
from tfg_drake.planning.odometry_drift import odometry_covariance
from tfg_drake.planning.parameters import COMFORT

EDGES, PLACES, CANDIDATES, STARS = 4000, 400, 100, 30
SENSOR = TagSensorConfig()
NOISE = turn_noise(SENSOR, sightings_of_turn(SENSOR, 1.0))


def crosses(a: FloatArray, b: FloatArray, walls: FloatArray) -> BoolArray:
    """Which lines from a (n, 2) to b (n, 2) cross which walls (m, 4), (n, m)."""
    a, b, c, d = a[:, None], b[:, None], walls[None, :, :2], walls[None, :, 2:]

    def side(p: FloatArray, q: FloatArray, r: FloatArray) -> BoolArray:
        return (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) > (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])

    return np.asarray((side(a, b, c) != side(a, b, d)) & (side(c, d, a) != side(c, d, b)))


def numpy_clearance(edges: FloatArray, walls: FloatArray, reach: float) -> FloatArray:
    """As clearance; in blocks that stay in the cache."""

    def to(points: FloatArray, segments: FloatArray) -> FloatArray:
        start, span = segments[..., :2], segments[..., 2:] - segments[..., :2]
        t = ((points - start) * span).sum(-1) / np.maximum((span**2).sum(-1), 1e-300)
        return np.hypot(*np.moveaxis(start + t.clip(0.0, 1.0)[..., None] * span - points, -1, 0))

    nearest = []
    for block in np.array_split(edges, max(1, len(edges) // 50)):
        e, w = block[:, None], walls[None]
        apart = np.minimum.reduce([to(e[..., :2], w), to(e[..., 2:], w), to(w[..., :2], e), to(w[..., 2:], e)])
        nearest.append(np.where(crosses(block[:, :2], block[:, 2:], walls), 0.0, apart).min(axis=1))
    return np.minimum(np.concatenate(nearest), reach)


def lines(segments: FloatArray) -> Any:
    """Shapely's lines (n,) of segments (n, 4)."""
    return shapely.linestrings(segments.reshape(-1, 2, 2))


def shapely_clearance(edges: FloatArray, walls: FloatArray, reach: float) -> FloatArray:
    """As clearance, through an STRtree."""
    tree = shapely.STRtree(lines(walls))
    (row, _), distance = tree.query_nearest(lines(edges), max_distance=reach, return_distance=True)
    nearest = np.full(len(edges), reach)
    nearest[row] = distance
    return nearest


def blocked_by_numpy(sight: FloatArray, walls: FloatArray) -> BoolArray:
    """Which lines of sight (n, 4) a wall crosses, in blocks that stay in the cache."""
    blocks = np.array_split(sight, max(1, len(sight) // 50))
    return np.concatenate([crosses(block[:, :2], block[:, 2:], walls).any(axis=1) for block in blocks])


def blocked_by_shapely(sight: FloatArray, walls: FloatArray) -> BoolArray:
    """Which lines of sight (n, 4) a wall crosses, by one prepared geometry of all walls."""
    everything = shapely.multilinestrings(lines(walls))
    shapely.prepare(everything)
    return np.asarray(shapely.intersects(everything, lines(sight)))


def sight_to(p_from: FloatArray, p_to: FloatArray, tolerance: float) -> FloatArray:
    """Lines of sight (n, 4) from p_from (n, 2) or (2,) to p_to (n, 2), shortened at the far end by tolerance (m)."""
    d = p_to - p_from
    share = np.maximum(0.0, 1.0 - tolerance / np.hypot(*d.T))[:, None]
    return np.hstack([np.broadcast_to(p_from, p_to.shape), p_from + share * d])


def seen_with(
    blocked: Callable[[FloatArray, FloatArray], BoolArray],
) -> Callable[[FloatArray, FloatArray, FloatArray, FloatArray], FloatArray]:
    """As visible_targets, lines of sight judged by a function: rows of point and target (k, 2)."""

    def seen(points: FloatArray, targets: FloatArray, normals: FloatArray, walls: FloatArray) -> FloatArray:
        d = targets - points[:, None]
        r = np.hypot(*np.moveaxis(d, -1, 0))
        facing = -(d * normals).sum(-1) >= np.cos(SENSOR.max_incidence) * r
        i, t = np.nonzero((r <= SENSOR.range) & facing)
        clear = ~blocked(sight_to(points[i], targets[t], SURFACE_TOLERANCE), walls)
        return np.stack([i, t], axis=1)[clear]

    return seen


def kernel_seen(points: FloatArray, targets: FloatArray, normals: FloatArray, walls: FloatArray) -> FloatArray:
    """visible_targets, as seen_with gives it."""
    offsets, index = visible_targets(
        points,
        targets,
        normals,
        walls,
        segment_grid(walls),
        SENSOR.range,
        SENSOR.max_incidence,
        SURFACE_TOLERANCE,
        0.0,
        0.0,
    )
    return np.stack([np.repeat(np.arange(len(points)), np.diff(offsets)), index], axis=1)


def numpy_inside(points: FloatArray, offsets: FloatArray, vertices: FloatArray) -> BoolArray:
    """As inside_any: the even-odd rule, a star at a time."""
    inside = np.zeros(len(points), dtype=bool)
    x, y = points[:, :1], points[:, 1:]
    for j in range(len(offsets) - 1):
        a = vertices[offsets[j] : offsets[j + 1]]
        b = np.roll(a, 1, axis=0)
        level = (a[:, 1] > y) != (b[:, 1] > y)
        rise = np.where(a[:, 1] == b[:, 1], 1.0, b[:, 1] - a[:, 1])
        left = x < a[:, 0] + (y - a[:, 1]) / rise * (b[:, 0] - a[:, 0])
        inside |= np.count_nonzero(level & left, axis=1) % 2 == 1
    return inside


def shapely_inside(points: FloatArray, offsets: FloatArray, vertices: FloatArray) -> BoolArray:
    """As inside_any, through an STRtree."""
    polygons = [shapely.Polygon(vertices[offsets[j] : offsets[j + 1]]) for j in range(len(offsets) - 1)]
    rows, _ = shapely.STRtree(polygons).query(shapely.points(points), predicate="within")
    inside = np.zeros(len(points), dtype=bool)
    inside[rows] = True
    return inside


def numpy_gain(points: FloatArray, arrival: Arrival, known: Known, new: New, noise: FloatArray) -> FloatArray:
    """Exploitation (c,), nats, by its definition, without new landmarks: the joint covariance of landmarks and pose."""
    n = 2 * len(known.p_MT)
    gain = np.zeros(len(points))
    for c, point in enumerate(points):
        rows = known.rows[known.offsets[c] : known.offsets[c + 1]]
        d = known.p_MT[rows] - point
        r = np.hypot(*d.T)
        u = d / r[:, None]
        along = u / np.maximum(noise[0] + noise[1] * r, noise[2])[:, None]
        across = np.stack([-u[:, 1], u[:, 0]], axis=1) / (r * noise[3])[:, None]
        G = np.stack([along, across], axis=1)
        K = np.concatenate([-G, np.zeros((len(rows), 2, 1))], axis=2)
        K[:, 1, 2] = -1.0 / noise[3]
        J = np.hstack([block_diag(*G), K.reshape(-1, 3)])
        F = to_arrival(arrival.X_MD, point[None])[0]
        take = np.append(np.stack([2 * rows, 2 * rows + 1], axis=1).ravel(), np.arange(n, n + 3))
        S = known.covariance[np.ix_(take, take)]
        S[-3:] = F @ S[-3:]
        S[:, -3:] = S[:, -3:] @ F.T
        S[-3:, -3:] += arrival.odometry[c]
        S_given_map = F @ arrival.departure_given_map @ F.T + arrival.odometry[c]
        eye, K = np.eye(2 * len(rows)), J[:, -3:]
        gain[c] = np.linalg.slogdet(eye + J @ S @ J.T)[1] - np.linalg.slogdet(eye + K @ S_given_map @ K.T)[1]
    return 0.5 * gain


def kernel_gain(*arguments: Any) -> FloatArray:
    """The exploitation of exact_gain."""
    return exact_gain(*arguments)[:, 0]


def gain_problem(rng: np.random.Generator, p_ML: FloatArray, normals: FloatArray, walls: FloatArray) -> tuple[Any, ...]:
    """Arguments of exact_gain: candidates that see what they would, landmarks and pose known jointly to centimetres."""
    points = rng.uniform([15.0, 1.0], [33.0, 21.0], (CANDIDATES, 2))
    offsets, rows = visible_targets(
        points,
        p_ML,
        normals,
        walls,
        segment_grid(walls),
        SENSOR.range,
        SENSOR.max_incidence,
        SURFACE_TOLERANCE,
        0.0,
        0.0,
    )
    n = 2 * len(p_ML)
    root = rng.normal(0.0, 0.05 / np.sqrt(n), (n + 3, n + 3))
    S = root @ root.T + 1e-6 * np.eye(n + 3)
    X_MD = np.array([24.0, 8.0, 0.3])
    given = S[n:, n:] - S[n:, :n] @ np.linalg.solve(S[:n, :n], S[:n, n:])
    distance = np.hypot(*(points - X_MD[:2]).T)
    arrival = Arrival(X_MD, given, odometry_covariance(X_MD, points, distance, 2.0 * distance, OdometryConfig()))
    none = np.zeros(0, dtype=np.int64)
    new = New(np.zeros(CANDIDATES + 1, dtype=np.int64), none, np.zeros((0, 2)), np.zeros(0), 10.0, np.array([1.0, 1.0]))
    tags = np.arange(len(p_ML)), np.tile(np.eye(2), (len(p_ML), 1, 1)), np.zeros_like(p_ML)
    return points, arrival, Known(offsets, rows, p_ML, *tags, S), new, NOISE


def stars(centres: FloatArray, walls: FloatArray) -> tuple[Any, ...]:
    """The free polygons seen from centres (k, 2), as inside_any takes them."""
    angles = np.linspace(0.0, 2.0 * np.pi, 360, endpoint=False)
    outwards = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    reach = [np.minimum(cast_rays(walls, centre, angles, 10.0), 10.0) for centre in centres]
    vertices = np.vstack([centre + r[:, None] * outwards for centre, r in zip(centres, reach, strict=True)])
    return 360 * np.arange(len(centres) + 1), vertices


def main() -> None:
    """Time, compare and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeat", type=int, default=5)
    repeat = parser.parse_args().repeat
    world = LoadScenario(FindScenario("paper")).world
    walls = np.vstack(
        [
            np.hstack([ends[:-1], ends[1:]])
            for wall in np.array(world.walls, dtype=float)
            for ends in [np.linspace(wall[:2], wall[2:], 1 + int(np.ceil(np.hypot(*(wall[2:] - wall[:2])))))]
        ]
    )
    tags = np.array([tag.position for tag in world.tags], dtype=float)
    facing = np.array([tag.facing for tag in world.tags])
    normals = np.stack([np.cos(facing), np.sin(facing)], axis=1)
    rng = np.random.default_rng(0)

    def places(count: int) -> FloatArray:
        return rng.uniform([0.5, 0.5], [45.5, 21.5], (count, 2))

    start = places(EDGES)
    edges = np.hstack([start, start + rng.normal(0.0, 1.0, (EDGES, 2))])
    here, there = np.array([16.0, 11.0]), places(EDGES)
    free = stars(places(STARS), walls)
    sight = {
        "kernel": lambda p_from, p_to: line_of_sight(walls, p_from, p_to),
        "numpy": lambda p_from, p_to: ~blocked_by_numpy(sight_to(p_from, p_to, 1e-3), walls),
        "shapely": lambda p_from, p_to: ~blocked_by_shapely(sight_to(p_from, p_to, 1e-3), walls),
    }
    cases: list[tuple[str, list[Callable[..., Any]], tuple[Any, ...]]] = [
        ("clearance", [clearance, numpy_clearance, shapely_clearance], (edges, walls, COMFORT)),
        ("line of sight", list(sight.values()), (here, there)),
        (
            "visible tags",
            [kernel_seen, seen_with(blocked_by_numpy), seen_with(blocked_by_shapely)],
            (places(PLACES), tags, normals, walls),
        ),
        ("free space", [inside_any, numpy_inside, shapely_inside], (places(EDGES), *free)),
        ("gain", [kernel_gain, numpy_gain], gain_problem(rng, tags, normals, walls)),
    ]
    print(f"{len(walls)} segments, {len(tags)} tags")
    print("                kernel ms  numpy ms  shapely ms  numpy / kernel  shapely / kernel")
    for name, functions, arguments in cases:
        expected = functions[0](*arguments)
        spent = []
        for function in functions:
            np.testing.assert_allclose(function(*arguments), expected, rtol=1e-8, atol=1e-9, err_msg=name)
            taken = []
            for _ in range(repeat):
                begin = time.thread_time()
                function(*arguments)
                taken.append(1e3 * (time.thread_time() - begin))
            spent.append(min(taken))
        shapely_ms = spent[2] if len(spent) > 2 else np.nan
        print(f"{name:15}{spent[0]:10.2f}{spent[1]:10.2f}{shapely_ms:12.2f}", end="")
        print(f"{spent[1] / spent[0]:16.1f}{shapely_ms / spent[0]:18.1f}")


if __name__ == "__main__":
    with threadpool_limits(limits=1):
        main()
