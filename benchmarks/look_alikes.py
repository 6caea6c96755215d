"""Missions without tags in worlds that are alike in many places, or empty: nothing must be taken for what it is not.

    python benchmarks/look_alikes.py
    python benchmarks/look_alikes.py --rows dumb-bell ring --seeds 1
    python benchmarks/look_alikes.py draw ring ring.yaml

A dumb-bell of two equal rooms, a ring of twelve equal rooms, two rooms with 40 m of bare corridor between them, and a
hall of 40 x 40 m, wider than the scanner sees; sensors of `paper`. Columns and --out are as of consistency.py.
"""

from __future__ import annotations

from pathlib import Path

import consistency
import missions
import reality
import yaml

WORLDS = Path("runs/look_alikes")
SEEDS = 2
# Width of a door, m.
DOOR = 1.0

Walls = list[list[float]]


def _wall(x0: float, y0: float, x1: float, y1: float, door: bool = False) -> Walls:
    """A wall along an axis, with a door in its middle or without."""
    if not door:
        return [[x0, y0, x1, y1]]
    x, y, along_x = 0.5 * (x0 + x1), 0.5 * (y0 + y1), y0 == y1
    d_x, d_y = (0.5 * DOOR, 0.0) if along_x else (0.0, 0.5 * DOOR)
    return [[x0, y0, x - d_x, y - d_y], [x + d_x, y + d_y, x1, y1]]


def _box(x0: float, y0: float, x1: float, y1: float) -> Walls:
    return [[x0, y0, x1, y0], [x1, y0, x1, y1], [x1, y1, x0, y1], [x0, y1, x0, y0]]


def _two_rooms(length: float, half: float) -> tuple[Walls, list[float]]:
    """Two rooms of 6 x 6 m at the ends of a corridor of this length and half width, m."""
    walls: Walls = []
    for side in (-1.0, 1.0):
        near, far = side * 0.5 * length, side * (0.5 * length + 6.0)
        walls += [[near, -3.0, far, -3.0], [far, -3.0, far, 3.0], [far, 3.0, near, 3.0]]
        walls += [[near, 3.0, near, half], [near, -half, near, -3.0]]
        walls += [[-0.5 * length, side * half, 0.5 * length, side * half]]
    return walls, [-0.5 * length - 3.0, 0.0, 0.0]


def _ring() -> tuple[Walls, list[float]]:
    """Twelve rooms of 5 x 5 m round a block of 10 x 10 m, each with a door to the next."""
    walls = _box(0.0, 0.0, 20.0, 20.0) + _box(5.0, 5.0, 15.0, 15.0)
    for at in (5.0, 10.0, 15.0):
        for first in (0.0, 15.0):
            walls += _wall(at, first, at, first + 5.0, door=True) + _wall(first, at, first + 5.0, at, door=True)
    return walls, [2.5, 2.5, 0.0]


def world(name: str) -> tuple[Walls, list[float]]:
    """Walls (x0, y0, x1, y1), m, and a start (x, y, yaw)."""
    if name == "ring":
        return _ring()
    if name == "hall":
        return _box(0.0, 0.0, 40.0, 40.0), [5.0, 5.0, 0.5]
    return _two_rooms(*((12.0, 0.8) if name == "dumb-bell" else (40.0, 1.0)))


def write(name: str, path: Path) -> None:
    """A scenario of a world by its name."""
    path.parent.mkdir(parents=True, exist_ok=True)
    walls, start = world(name)
    path.write_text(yaml.safe_dump({"base": "paper", "world": {"start": start, "walls": walls, "tags": []}}))


if __name__ == "__main__":
    names = ("dumb-bell", "ring", "gap", "hall")
    missions.draw(write, str, names)
    rows: consistency.Rows = {}
    for one in names:
        write(one, WORLDS / f"{one}.yaml")
        arguments = ["paper", "--world", str(WORLDS / f"{one}.yaml"), "--tag-spacing", "none"]
        rows[one] = (arguments, reality.BELIEVED, SEEDS)
    consistency.main(__doc__, rows, Path("runs/look_alikes.jsonl"))
