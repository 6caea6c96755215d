"""Straight at a wall with a poor scanner: does the filter before the base stop in time?

    python benchmarks/approaches.py --count 10000
    python benchmarks/approaches.py --count 3000 --at end edge behind
    python benchmarks/approaches.py --count 300 --at bumper

A robot that is told to drive straight on at 0.3 or 0.5 m/s approaches a wall, or the end of a wall or a post of 5 cm in
its way, from 0.5 to 3 m.
Its scanner sees nothing nearer than 0 to 0.6 m (half of them say so in scan.least_range), and of its rays are missing a
share drawn from 0 to 1, anew in each scan, or all on one side of a bearing, or none. Scans and odometry are as noisy as
those of `paper`. Prints a row a kind of loss: contacts, how near the outline came to the wall, and the share of robots
that were let drive at all.

edge: after a look round the robot drives an arc, on which it sees the end of a wall of 0.2 to 3 m, of a door leaf of
0.8 m, or a cross of 5 cm, and goes on straight towards it, along the wall; a fifth of the rays is lost, or none.
behind: it drives ahead and turns, or has looked round before, and is told to drive backwards among walls. bumper: it
drives into a bar that no scanner sees, and the bumper stays pressed; how far it backs is printed, too. The scanner sees
all round, or as far as that of `paper`.
"""

from __future__ import annotations

import argparse
import dataclasses

import numpy as np

from tfg_drake.config import OdometryConfig, RobotConfig, SafetyConfig, ScanConfig
from tfg_drake.geometry.se2 import compose, inverse
from tfg_drake.messages import FloatArray, Hazards, LaserScan, replace
from tfg_drake.safety.scan_watch import no_watch, watched
from tfg_drake.safety.velocity_filter import STATE_SIZE, filter_command
from tfg_drake.simulation import differential_drive as drive
from tfg_drake.simulation import odometry
from tfg_drake.simulation.laser_scanner import no_scan, ray_angles, scan

PERIOD = 1.0 / 32.0
# A scan every SCAN_EVERY steps, 10.7 Hz; the approach is over once the base stands for more than STANDS steps.
SCAN_EVERY, STANDS = 3, 64
LOSSES = ("none", "at random", "one side")
OBSTACLES = ("wall", "end", "post")
# The rows, obstacle and loss of rays, of each kind of approach that has its own.
ROWS = {
    "edge": [(thing, loss) for thing in ("thin wall", "door leaf", "cross") for loss in ("none", "a fifth")],
    "behind": [("all round", "none"), ("124 degrees", "none")],
    "bumper": [("all round", "none"), ("124 degrees", "none")],
}
NO_WALLS = np.zeros((0, 4))
LOOK_ROUND = (5.5, 0.0, 1.2)
# Walls of the closed room around an approach, m.
ROOM = np.array([[5, -5, 5, 5], [5, 5, -5, 5], [-5, 5, -5, -5], [-5, -5, 5, -5]], dtype=float)


@dataclasses.dataclass(frozen=True)
class Approach:
    """walls (n, 4) in W, m; legs: how long (s) the robot is told to drive at which speed (m/s) and turn rate (rad/s);
    rays lost: how, and the share or the bearing (rad); least range (m) of the scanner, and the one that its data sheet
    says, and its field of view, rad; X_WB: (3,) where it begins; bars: (m, 4) what no scanner sees, m, and whether the
    bumper stays pressed."""

    walls: FloatArray
    legs: list[tuple[float, float, float]]
    loss: str = "none"
    lost: float = 0.0
    least_range: float = 0.0
    stated: float = 0.0
    field_of_view: float = ScanConfig().field_of_view
    X_WB: FloatArray = dataclasses.field(default_factory=lambda: np.zeros(3))
    bars: FloatArray = dataclasses.field(default_factory=lambda: NO_WALLS)
    sticks: bool = False


def drawn(random: np.random.Generator, loss: str, obstacle: str) -> Approach:
    """An approach to one of OBSTACLES, rays lost in one way of LOSSES."""
    distance, angle = random.uniform(0.5, 3.0), random.uniform(-0.6, 0.6)
    along = np.array([-np.sin(angle), np.cos(angle)])
    first, last = -3.0, 3.0
    if obstacle != "wall":
        first = random.uniform(-0.15, 0.15)
        last = first + 0.05 if obstacle == "post" else 3.0 * random.choice([-1.0, 1.0])
    ends = np.array([distance, 0.0]) + np.outer([first, last], along)
    least_range = random.choice([0.0, random.uniform(0.0, 0.6)])
    lost = {"none": 0.0, "at random": random.uniform(0.0, 1.0), "one side": random.uniform(-1.0, 1.0)}[loss]
    stated = least_range if random.random() < 0.5 else 0.0
    legs = [(12.0, float(random.choice([0.3, 0.5])), 0.0)]
    return Approach(ends.reshape(1, 4), legs, loss, lost, least_range, stated)


def edge_on(random: np.random.Generator, thing: str, loss: str) -> Approach:
    """An approach to the origin of W, where something thin ends that lies along x."""
    length = random.uniform(0.2, 3.0) if thing == "thin wall" else 0.8
    walls, lost = np.array([[0.0, 0.0, length, 0.0]]), 0.0 if loss == "none" else 0.2
    if thing == "cross":
        turned = random.uniform(0.0, np.pi) + np.array([0.0, np.pi / 2.0])
        arm = 0.025 * np.column_stack([np.cos(turned), np.sin(turned)])
        walls = np.hstack([-arm, arm])
    while True:
        speed, sharp = float(random.choice([0.3, 0.5])), random.uniform(0.5, 2.5)
        turn_rate = min(sharp * speed, 1.4) * random.choice([-1.0, 1.0])
        arc = (random.uniform(0.2, 1.0) / speed, speed, turn_rate)
        # Beside the line of the wall by any distance at which the outline touches it, or by next to none.
        beside = random.uniform(-0.15, 0.15) * random.choice([0.1, 1.0])
        end = np.array([-random.uniform(0.25, 0.7), beside, random.uniform(-0.2, 0.2)])
        X_BE = poses([LOOK_ROUND, (1.0, 0.0, 0.0), arc])
        X_WB = compose(end, inverse(X_BE[-1]))
        x, y, theta = np.array([compose(X_WB, X) for X in X_BE[-round(arc[0] / PERIOD) :]]).T
        bearing = np.angle(np.exp(1j * (np.arctan2(-y, -x) - theta)))
        away = np.hypot(x, y)
        seen = (away < 0.9) & (np.abs(bearing) < 1.0) & ((np.abs(y) > 0.17 * away) | (thing == "cross"))
        if seen.sum() >= 10 and drive.clearance(walls, X_WB[0], X_WB[1], 0.18) > 0.02:
            legs = [LOOK_ROUND, (1.0, 0.0, 0.0), arc, (8.0, speed, 0.0)]
            return Approach(np.vstack([walls, ROOM]), legs, "at random", lost, X_WB=X_WB)


def poses(legs: list[tuple[float, float, float]]) -> FloatArray:
    """Poses (n, 3) of a base that nothing holds back, from the one where it begins."""
    base, found = drive.initial_state(np.zeros(3), NO_WALLS, RobotConfig()), []
    for duration, speed, turn_rate in legs:
        for _ in range(round(duration / PERIOD)):
            base = drive.step(base, np.array([speed, turn_rate]), NO_WALLS, RobotConfig(), PERIOD)
            found.append(base[drive.X : drive.THETA + 1])
    return np.array(found)


def cluttered(random: np.random.Generator) -> FloatArray:
    """Walls (n, 4), m, of which none touches a robot at the origin of W."""
    walls = [*ROOM]
    while len(walls) < 12:
        p, angle, length = random.uniform(-1.5, 1.5, 2), random.uniform(0.0, np.pi), random.uniform(0.1, 1.0)
        wall = np.array([*p, p[0] + length * np.cos(angle), p[1] + length * np.sin(angle)])
        if drive.clearance(wall[None], 0.0, 0.0, 0.18) > 0.03:
            walls.append(wall)
    return np.array(walls)


def reversing(random: np.random.Generator, scanner: str, _loss: str) -> Approach:
    """A robot that is told to drive backwards after it has driven ahead and turned, or has looked round."""
    legs = [LOOK_ROUND] if random.random() < 0.5 else []
    for _ in range(random.integers(3)):
        legs.append((random.uniform(0.2, 3.0), random.choice([0.0, 0.3, 0.5]), random.uniform(-1.0, 1.0)))
    back = random.uniform(-0.8, 0.8) * random.choice([0.0, 1.0])
    legs.append((1.0, 0.0, 0.0))
    legs.append((6.0, -float(random.choice([0.3, 0.5])), back))
    view = 2.0 * np.pi - 0.01 if scanner == "all round" else ScanConfig().field_of_view
    return Approach(cluttered(random), legs, field_of_view=view)


def held_bumper(random: np.random.Generator, scanner: str, loss: str) -> Approach:
    """A robot that drives into a bar that no scanner sees; its bumper stays pressed."""
    approach, ahead, side = reversing(random, scanner, loss), random.uniform(0.25, 0.8), random.uniform(-0.3, 0.1)
    legs = [LOOK_ROUND, (20.0, float(random.choice([0.3, 0.5])), 0.0)]
    bars = np.array([[ahead, side, ahead + random.uniform(-0.1, 0.1), side + 0.2]])
    # As the look round leaves it, the robot looks along x.
    X_WB = np.array([0.0, 0.0, -poses([LOOK_ROUND, (1.0, 0.0, 0.0)])[-1, 2]])
    return dataclasses.replace(approach, legs=[legs[0], (1.0, 0.0, 0.0), legs[1]], bars=bars, sticks=True, X_WB=X_WB)


def driven(approach: Approach, random: np.random.Generator) -> tuple[int, float, float, float]:
    """Contacts, least clearance (m), distance (m) from where it began and how far it was pushed back (m)."""
    robot, safety, wheels = RobotConfig(), SafetyConfig(), OdometryConfig()
    scanner = ScanConfig(least_range=approach.least_range, field_of_view=approach.field_of_view)
    angles, felt = ray_angles(scanner), np.vstack([approach.walls, approach.bars])
    base = drive.initial_state(approach.X_WB, felt, robot)
    reckoned, errors = odometry.initial_state(approach.X_WB), odometry.run_errors(random.normal(size=3), wheels)
    state, watch, seen, stood = np.zeros(STATE_SIZE), no_watch(no_scan(scanner)), no_scan(scanner), 0
    commands = [np.array(leg[1:]) for leg in approach.legs for _ in range(round(leg[0] / PERIOD))]
    pressed, back, moved = 0, 0.0, 0.0
    for k, command in enumerate(commands):
        pose, now = base[drive.X : drive.TURN_RATE + 1], k * PERIOD
        reckoned = odometry.integrate(reckoned, now, pose, errors, random.normal(size=2), wheels)
        told = odometry.message(reckoned)
        if k % SCAN_EVERY == 0:
            full = scan(approach.walls, pose[:3], now, angles, random.normal(size=len(angles)), scanner)
            seen = _with_losses(full, approach, random)
            watch = watched(watch, seen, told.X_OB, told.at_rest, robot.radius, approach.stated)
        pressed = int(base[drive.BUMPER]) | (pressed if approach.sticks else 0)
        velocity, hazards = state[:2], Hazards(now, pressed, 0, 0)
        state = filter_command(state, now, command, hazards, seen, watch, told, robot, safety, PERIOD)
        base = drive.step(base, velocity, felt, robot, PERIOD)
        moved, back = float(np.hypot(*(base[1:3] - approach.X_WB[:2]))), back + min(0.0, base[drive.SPEED]) * PERIOD
        stood = stood + 1 if state[0] == 0.0 and command[0] != 0.0 else 0
        if stood > STANDS and not approach.sticks:
            break
    return int(base[drive.CONTACTS]), float(base[drive.CLEARANCE]), moved, -back


def _with_losses(seen: LaserScan, approach: Approach, random: np.random.Generator) -> LaserScan:
    if approach.loss == "at random":
        lost = random.random(len(seen.ranges)) < approach.lost
    elif approach.loss == "one side":
        lost = (seen.angles < approach.lost) if approach.lost < 0.0 else (seen.angles > approach.lost)
    else:
        return seen
    return replace(seen, ranges=np.where(lost, np.nan, seen.ranges))


MAKERS = {"edge": edge_on, "behind": reversing, "bumper": held_bumper}


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=10_000, help="approaches, as many for each row")
    parser.add_argument("--at", choices=[*OBSTACLES, *ROWS], nargs="+", default=["wall"], help="what is in the way")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    heads = f"{'contacts':>9}{'least m':>9}{'median m':>9}{'drove':>7}{'back m':>8}"
    print(f"{'kind':<13}{'rays lost':<12}{'approaches':>11}" + heads)
    approaches = touches = 0
    for at in options.at:
        rows = ROWS.get(at, [(at, loss) for loss in LOSSES])
        for n, (kind, loss) in enumerate(rows):
            random = np.random.default_rng([options.seed, n])
            results = []
            for _ in range(options.count // len(rows) + 1):
                approach = MAKERS[at](random, kind, loss) if at in ROWS else drawn(random, loss, kind)
                results.append(driven(approach, random))
            contacts, clearance, distance, back = (np.array(column) for column in zip(*results, strict=True))
            moved = (back if at == "behind" else distance) > 0.05
            # The bar that is felt first is not to be felt again.
            touched = int((contacts > (at == "bumper")).sum())
            approaches, touches = approaches + len(results), touches + touched
            median = float(np.median(clearance[moved])) if moved.any() else np.nan
            print(
                f"{kind:<13}{loss:<12}{len(results):>11}{touched:>9}{clearance.min():>9.3f}{median:>9.3f}"
                f"{moved.mean():>7.2f}{back.max():>8.2f}",
                flush=True,
            )
    print(f"\n{touches} of {approaches} approaches end in a contact")


if __name__ == "__main__":
    main()
