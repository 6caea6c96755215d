"""Missions in office-like buildings that nobody chose, without tags: each seed draws its own plan.

    python benchmarks/offices.py
    python benchmarks/offices.py --seeds 3
    python benchmarks/offices.py draw 7 plan.yaml

Camera, wheels and scanner are those of `paper_real`, which the explorer does not know of. Columns and --out are as of
consistency.py; in the second row there are people, a tenth of the rays meets glass and the others' errors are
correlated. `draw` writes one plan, which `tfg-drake explore paper_real --world plan.yaml --tag-spacing none` takes.
"""

from __future__ import annotations

import math
from pathlib import Path

import consistency
import missions
import numpy as np
import reality
import yaml

PLANS = Path("runs/offices")
# Settings of the harder missions, on half of the plans: people, rays without a return, correlated errors of rays.
WORSE = ("reality.people=3", "reality.scan.dropout_probability=0.1", "reality.scan.correlation_angle=0.05")
SEEDS = 20
# Least width of a door, and of the wall left on either side of it, m.
DOOR, JAMB = 0.9, 0.15
# Least gap between pieces of furniture, or furniture and wall, m: the robot passes.
PASSAGE = 0.8
# Side of a table's leg, as a share of the table's.
LEG = 0.05
# MOVED: probability that a piece of furniture is moved. CORNERS: kinds of things that stand in corners.
MOVED = 0.1
CORNERS = ("bay", "round corner")

# A room or a wall: x0, y0, x1, y1, m.
Box = tuple[float, float, float, float]


def plan(seed: int, later: np.random.Generator | None = None) -> tuple[list[list[float]], list[float]]:
    """Walls (x0, y0, x1, y1), m, of a building of 12 x 8 to 36 x 22 m: a corridor, rooms of all sizes that have a door
    each, more doors here and there, furniture and pillars in the rooms, in every second plan
    legs and curved walls, too; and a start (x, y, yaw) in the corridor. later: the same building as it is then, with a
    tenth of its furniture moved and a door shut."""
    rng = np.random.default_rng([seed, 57])
    width, depth = rng.uniform(12.0, 36.0), rng.uniform(8.0, 22.0)
    corridor = rng.uniform(1.6, 2.6)
    y = rng.uniform(0.3, 0.7) * (depth - corridor)
    rooms: list[Box] = [(0.0, y, width, y + corridor)]
    for side in ((0.0, 0.0, width, y), (0.0, y + corridor, width, depth)):
        rooms += _divided(side, rng)
    # Between outer rooms thin, hollow or thick walls.
    half = 0.5 * rng.uniform(0.1, 0.3)
    gaps = _doors(rooms, half, rng)
    walls: list[list[float]] = []
    for i, room in enumerate(rooms):
        walls += _room_walls(room, half, [gap for a, gap in gaps if a == i])
        if i:
            walls += _furniture(room, half, [gap for a, gap in gaps if a == i], rng, later, curved=seed % 2 == 1)
    if later is not None:
        x0, y0, x1, y1 = gaps[later.integers(len(gaps))][1]
        middle_x, middle_y, is_across_x = 0.5 * (x0 + x1), 0.5 * (y0 + y1), x1 - x0 < y1 - y0
        walls.append([middle_x, y0, middle_x, y1] if is_across_x else [x0, middle_y, x1, middle_y])
    start = [rng.uniform(1.0, width - 1.0), y + 0.5 * corridor, rng.uniform(-math.pi, math.pi)]
    return [[round(float(value), 3) for value in wall] for wall in walls], [round(value, 3) for value in start]


def _divided(box: Box, rng: np.random.Generator) -> list[Box]:
    """A box cut into rooms of 3 m or wider."""
    x0, y0, x1, y1 = box
    sides = np.array([x1 - x0, y1 - y0])
    axis = int(np.argmax(sides * rng.uniform(0.8, 1.2, 2)))
    if sides[axis] < 6.0 or sides.prod() < rng.uniform(12.0, 70.0):
        return [box]
    cut = box[axis] + rng.uniform(3.0, sides[axis] - 3.0)
    first, second = list(box), list(box)
    first[2 + axis] = second[axis] = cut
    return _divided(tuple(first), rng) + _divided(tuple(second), rng)


def _doors(rooms: list[Box], half: float, rng: np.random.Generator) -> list[tuple[int, Box]]:
    """A gap, as a box from face to face of a wall, beside each of its two rooms: a tree that reaches all rooms, and one
    neighbour in six beside."""
    shared = []
    for i, a in enumerate(rooms):
        for j in range(i):
            for axis in (0, 1):
                b, along = rooms[j], 1 - axis
                low, high = max(a[along], b[along]), min(a[2 + along], b[2 + along])
                at = a[axis] if a[axis] == b[2 + axis] else a[2 + axis] if a[2 + axis] == b[axis] else None
                if at is not None and high - low > DOOR + 2.0 * (JAMB + half) + 0.1:
                    shared.append((i, j, axis, at, low + half + JAMB, high - half - JAMB))
    # Doors to the corridor are likelier.
    order = np.argsort(rng.uniform(size=len(shared)) - 0.5 * np.array([j == 0 for _, j, *_ in shared]))
    reached, gaps = list(range(len(rooms))), []
    for i, j, axis, at, low, high in (shared[k] for k in order):
        if reached[i] == reached[j] and rng.uniform() > 1.0 / 6.0:
            continue
        reached = [reached[i] if label == reached[j] else label for label in reached]
        wide = min(rng.uniform(DOOR, 1.3), high - low)
        begin = rng.uniform(low, high - wide)
        gap = (at - half, begin, at + half, begin + wide) if axis == 0 else (begin, at - half, begin + wide, at + half)
        gaps += [(i, gap), (j, gap)]
    return gaps


def _room_walls(room: Box, half: float, gaps: list[Box]) -> list[list[float]]:
    """A room's faces, open at its doors, and a jamb of each door on either side, as far as this room's face."""
    x0, y0, x1, y1 = room[0] + half, room[1] + half, room[2] - half, room[3] - half
    walls = []
    for axis, at, low, high in ((1, y0, x0, x1), (0, x1, y0, y1), (1, y1, x0, x1), (0, x0, y0, y1)):
        ends, along = [low], 1 - axis
        for gap in sorted(gaps, key=lambda gap: gap[along]):
            if gap[axis] - 1e-6 <= at <= gap[2 + axis] + 1e-6 and gap[2 + axis] - gap[axis] < 2.0 * half + 1e-6:
                ends += [gap[along], gap[2 + along]]
                middle = 0.5 * (gap[axis] + gap[2 + axis])
                for jamb in (gap[along], gap[2 + along]):
                    walls.append([jamb, at, jamb, middle] if axis == 1 else [at, jamb, middle, jamb])
        ends.append(high)
        for a, b in zip(ends[::2], ends[1::2], strict=True):
            walls.append([a, at, b, at] if axis == 1 else [at, a, at, b])
    return walls


def _furniture(
    room: Box,
    half: float,
    gaps: list[Box],
    rng: np.random.Generator,
    later: np.random.Generator | None,
    *,
    curved: bool,
) -> list[list[float]]:
    """Closed outlines of cupboards and desks at the walls, of tables at any angle, and of round pillars, where a robot
    can pass between them. later: as of `plan`. curved: of tables' legs, round corners and bays, too."""
    low, high = np.array(room[:2]) + half, np.array(room[2:]) - half
    placed = [(0.5 * np.array([gap[0] + gap[2], gap[1] + gap[3]]), 0.7) for gap in gaps]
    walls = []
    kinds, likely = (("wall", "table", "pillar"), [0.6, 0.3, 0.1])
    if curved:
        kinds, likely = ((*kinds, "legs", "bay", "round corner"), [0.25, 0.1, 0.2, 0.25, 0.1, 0.1])
    for _ in range(rng.poisson(float(np.prod(high - low)) / 3.0)):
        kind = rng.choice(kinds, p=likely)
        outline = _outline(kind, rng)
        turned = (
            rng.uniform(0.0, math.pi)
            if kind in ("table", "legs")
            else 0.5 * math.pi * rng.integers(4 if kind in CORNERS else 2)
        )
        c, s = math.cos(turned), math.sin(turned)
        outline = outline @ np.array([[c, s], [-s, c]])
        reach = outline.max(axis=0)
        if np.any(high - low < 2.0 * reach + 0.1):
            continue
        middle = rng.uniform(low + reach, high - reach)
        if kind == "wall":
            axis, end = rng.integers(2), rng.integers(2)
            middle[axis] = (low + reach)[axis] if end == 0 else (high - reach)[axis]
        elif kind in CORNERS:
            middle = np.where(outline[0] < 0.0, low + reach, high - reach)
        radius = float(np.hypot(*reach)) if kind != "pillar" else float(reach[0])
        from_wall = np.minimum(middle - reach - low, high - reach - middle)
        if np.any((from_wall > 1e-6) & (from_wall < PASSAGE)):
            continue
        if any(np.hypot(*(middle - other)) < radius + beside + PASSAGE for other, beside in placed):
            continue
        placed.append((middle, radius))
        if later is not None and later.uniform() < MOVED:
            middle = later.uniform(low + reach, high - reach)
        closed = [middle + outline]
        if kind == "legs":
            closed = [middle + (1.0 - LEG) * corner + LEG * outline for corner in outline]
        for corners in closed:
            walls += [[*a, *b] for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    return walls


def _outline(kind: str, rng: np.random.Generator) -> np.ndarray:
    """(n, 2) corners of a piece of furniture round its middle, m; of what stands in a corner the first is that."""
    size = rng.uniform([0.4, 0.3], [2.0, 0.9])
    if kind == "pillar":
        angles = np.linspace(0.0, 2.0 * math.pi, 24, endpoint=False)
        return rng.uniform(0.15, 0.4) * np.column_stack([np.cos(angles), np.sin(angles)])
    if kind in CORNERS:
        radius, quarter = rng.uniform(0.4, 1.5), np.linspace(0.0, 0.5 * math.pi, 20)
        arc = np.column_stack([np.cos(quarter), np.sin(quarter)]) - 0.5
        return radius * np.vstack([[-0.5, -0.5], arc if kind == "bay" else -arc])
    return 0.5 * size * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])


def write(seed: int, path: Path, later: np.random.Generator | None = None) -> None:
    """A scenario with the plan of a seed and no tags."""
    path.parent.mkdir(parents=True, exist_ok=True)
    walls, start = plan(seed, later)
    path.write_text(yaml.safe_dump({"base": "paper_real", "world": {"start": start, "walls": walls, "tags": []}}))


if __name__ == "__main__":
    missions.draw(write)
    for one in range(SEEDS):
        write(one, PLANS / f"{one}.yaml")
    arguments = ["paper_real", "--world", str(PLANS / "{seed}.yaml"), "--tag-spacing", "none"]
    worse = [word for setting in WORSE for word in ("--set", setting)]
    rows: consistency.Rows = {
        "offices": (arguments, reality.BELIEVED, SEEDS),
        "people, glass": (arguments + worse, reality.BELIEVED, SEEDS // 2),
    }
    consistency.main(__doc__, rows, Path("runs/offices.jsonl"))
