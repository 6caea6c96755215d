"""Missions without tags in rooms whose walls are curved in part: each seed draws its own room.

    python benchmarks/curved_rooms.py
    python benchmarks/curved_rooms.py --seeds 3
    python benchmarks/curved_rooms.py draw 7 room.yaml

A room is a rectangle of 5 to 14 m whose ends are straight, half round or wavy and whose corners may be rounded, with
columns and straight partitions in it; every fourth is round as a whole. Sensors are those of `house` and of `paper`. A
mission is told wrongly where its poses are off by more than five of the deviations that it states, root mean square,
and no note says that little is straight. Each is a line of --out, and what is there is not run again.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path

import missions
import numpy as np
import yaml

from tfg_drake.bad_input import BadInput
from tfg_drake.io.files import write_atomic

SEEDS = 30
# Length of the segments that approximate a curve, m.
PIECE = 0.08
# Least clearance between columns, m.
PASSAGE = 0.9
# The pose is wrong above this normalised squared error: five standard deviations.
WRONG = 25.0


def room(seed: int) -> tuple[list[list[float]], list[float]]:
    """Walls (x0, y0, x1, y1), m, and a start (x, y, yaw)."""
    rng = np.random.default_rng([seed, 91])
    if seed % 4 == 3:
        radius = rng.uniform(2.5, 4.5)
        outline, length, half = _arc(np.zeros(2), radius, -math.pi, math.pi), radius, radius
    else:
        length, half = 0.5 * rng.uniform(5.0, 14.0), 0.5 * rng.uniform(4.0, 8.0)
        outline = np.vstack([_end(length, half, rng), -_end(length, half, rng)])
    walls = [[*a, *b] for a, b in zip(outline, np.roll(outline, -1, axis=0), strict=True)]
    columns: list[tuple[np.ndarray, float]] = [(np.array([0.6 - length, 0.0]), 0.3)]
    for _ in range(rng.integers(0, 12)):
        middle, radius = rng.uniform(-0.7, 0.7, 2) * [length, half], rng.uniform(0.15, 0.6)
        if all(np.hypot(*(middle - other)) > radius + beside + PASSAGE for other, beside in columns):
            columns.append((middle, radius))
            ring = _arc(middle, radius, -math.pi, math.pi)
            walls += [[*a, *b] for a, b in zip(ring, np.roll(ring, -1, axis=0), strict=True)]
    return [[round(float(value), 4) for value in wall] for wall in walls], [round(0.8 - length, 3), 0.0, 0.0]


def _arc(middle: np.ndarray, radius: float, begin: float, end: float) -> np.ndarray:
    angle = np.linspace(begin, end, max(round(radius * (end - begin) / PIECE), 24), endpoint=False)
    return middle + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def _end(length: float, half: float, rng: np.random.Generator) -> np.ndarray:
    """The right end of a room round the origin, from its lower wall to its upper one, counterclockwise."""
    kind = rng.choice(["straight", "round", "wavy", "rounded"], p=[0.2, 0.4, 0.2, 0.2])
    if kind == "round":
        return _arc(np.array([length, 0.0]), half, -0.5 * math.pi, 0.5 * math.pi)
    if kind == "wavy":
        y = np.linspace(-half, half, round(2.0 * half / PIECE))
        waves = rng.uniform(0.1, 0.5) * np.sin(math.pi * rng.integers(1, 4) * (y / half + 1.0))
        return np.column_stack([length + waves, y])
    if kind == "rounded":
        radius = rng.uniform(0.5, 0.9) * min(length, half)
        corners = [np.array([length - radius, side * (half - radius)]) for side in (-1, 1)]
        return np.vstack([_arc(corners[0], radius, -0.5 * math.pi, 0.0), _arc(corners[1], radius, 0.0, 0.5 * math.pi)])
    return np.array([[length, -half], [length, half]])


def write(seed: int, path: Path) -> None:
    """A scenario with the room of a seed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    walls, start = room(seed)
    path.write_text(yaml.safe_dump({"base": ("house", "paper")[seed % 2], "world": {"start": start, "walls": walls}}))


def run(seed: int, folder: Path) -> dict:
    """The figures of one mission."""
    path = folder / f"{seed}.yaml"
    write(seed, path)
    summary = missions.run_seed([str(path), "--tag-spacing", "none", "--max-time", "1200"], seed, folder)
    row = {"seed": seed, "outcome": summary["outcome"], "reason": summary["reason"]}
    log = folder / f"seed-{seed}" / "log.txt"
    row["told"] = log.exists() and "are straight; deviations may not hold" in log.read_text()
    if "sim_time_s" in summary:
        row["known_m"] = (summary["least_known"] or {}).get("deviation_m")
        row["position_error_m"] = summary["position_error_m"]["mean"]
        row |= {name: summary[name] for name in ("pose_anees", "online_pose_anees", "sim_time_s", "contacts")}
    worst = max((row.get(name) or 0.0 for name in ("pose_anees", "online_pose_anees")), default=0.0)
    return row | {"wrong": worst > WRONG and not row["told"]}


def main() -> None:
    """Run what is missing, then print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--out", type=Path, default=Path("runs/curved_rooms.jsonl"))
    options = parser.parse_args()
    if options.seeds < 1:
        raise BadInput(f"--seeds {options.seeds}: must be 1 or more")
    rows = [json.loads(text) for text in options.out.read_text().splitlines()] if options.out.exists() else []
    done = {row["seed"] for row in rows}
    for seed in range(options.seeds):
        if seed not in done:
            rows.append(run(seed, options.out.parent / options.out.stem))
            write_atomic(options.out, "".join(json.dumps(row) + "\n" for row in rows))
            print(json.dumps(rows[-1]), flush=True)
    complete, told, wrong = (sum(map(bool, of)) for of in zip(*(
        (row["outcome"] == "complete", row["told"], row["wrong"]) for row in rows), strict=True))  # fmt: skip
    print(f"\n{len(rows)} rooms: {complete} complete, {told} told that little is straight, {wrong} told wrongly")


if __name__ == "__main__":
    missions.draw(write)
    main()
