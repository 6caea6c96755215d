"""Straight at a wall with a poor scanner: does the filter before the base stop in time?

    python benchmarks/approaches.py --count 10000
    python benchmarks/approaches.py --count 3000 --at end

A robot that is told to drive straight on at 0.3 or 0.5 m/s approaches a wall, or the end of a wall or a post of 5 cm in
its way, from 0.5 to 3 m.
Its scanner sees nothing nearer than 0 to 0.6 m (half of them say so in scan.least_range), and of its rays are missing a
share drawn from 0 to 1, anew in each scan, or all on one side of a bearing, or none. Scans and odometry are as noisy as
those of `paper`. Prints a row a kind of loss: contacts, how near the outline came to the wall, and the share of robots
that were let drive at all.
"""

from __future__ import annotations

import argparse
import dataclasses

import numpy as np

from tfg_drake.config import OdometryConfig, RobotConfig, SafetyConfig, ScanConfig
from tfg_drake.messages import FloatArray, Hazards, LaserScan, replace
from tfg_drake.safety.scan_watch import no_watch, watched
from tfg_drake.safety.velocity_filter import STATE_SIZE, filter_command
from tfg_drake.simulation import differential_drive as drive
from tfg_drake.simulation import odometry
from tfg_drake.simulation.laser_scanner import no_scan, ray_angles, scan

PERIOD = 1.0 / 32.0
# Steps between two scans, 10.7 Hz, and the longest approach.
SCAN_EVERY, STEPS = 3, 32 * 12
LOSSES = ("none", "at random", "one side")
OBSTACLES = ("wall", "end", "post")
NO_HAZARD = Hazards(0.0, 0, 0, 0)


@dataclasses.dataclass(frozen=True)
class Approach:
    """Speed (m/s), walls (n, 4) in W (m), rays lost: how, and the share or the bearing (rad); least range (m) of the
    scanner, and the one that its data sheet says."""

    speed: float
    walls: FloatArray
    loss: str
    lost: float
    least_range: float
    stated: float


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
    return Approach(float(random.choice([0.3, 0.5])), ends.reshape(1, 4), loss, lost, least_range, stated)


def driven(approach: Approach, random: np.random.Generator) -> tuple[int, float, float]:
    """Contacts, least clearance (m) and distance driven (m) of an approach."""
    robot, safety, wheels = RobotConfig(), SafetyConfig(), OdometryConfig()
    scanner = ScanConfig(least_range=approach.least_range)
    angles, command = ray_angles(scanner), np.array([approach.speed, 0.0])
    base = drive.initial_state(np.zeros(3), approach.walls, robot)
    reckoned, errors = odometry.initial_state(np.zeros(3)), odometry.run_errors(random.normal(size=3), wheels)
    state, watch, seen, stood = np.zeros(STATE_SIZE), no_watch(no_scan(scanner)), no_scan(scanner), 0
    for k in range(STEPS):
        pose, now = base[drive.X : drive.TURN_RATE + 1], k * PERIOD
        reckoned = odometry.integrate(reckoned, now, pose, errors, random.normal(size=2), wheels)
        told = odometry.message(reckoned)
        if k % SCAN_EVERY == 0:
            full = scan(approach.walls, pose[:3], now, angles, random.normal(size=len(angles)), scanner)
            seen = _with_losses(full, approach, random)
            watch = watched(watch, seen, told.X_OB, told.at_rest, robot.radius, approach.stated)
        velocity = state[:2]
        state = filter_command(state, now, command, NO_HAZARD, seen, watch, told, robot, safety, PERIOD)
        base = drive.step(base, velocity, approach.walls, robot, PERIOD)
        stood = stood + 1 if state[0] == 0.0 else 0
        if stood > 64:
            break
    return int(base[drive.CONTACTS]), float(base[drive.CLEARANCE]), float(np.hypot(*base[drive.X : drive.Y + 1]))


def _with_losses(seen: LaserScan, approach: Approach, random: np.random.Generator) -> LaserScan:
    if approach.loss == "at random":
        lost = random.random(len(seen.ranges)) < approach.lost
    elif approach.loss == "one side":
        lost = (seen.angles < approach.lost) if approach.lost < 0.0 else (seen.angles > approach.lost)
    else:
        return seen
    return replace(seen, ranges=np.where(lost, np.nan, seen.ranges))


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=10_000, help="approaches, a third for each way to lose rays")
    parser.add_argument("--at", choices=OBSTACLES, default="wall", help="what stands in the way")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print(f"{'rays lost':<12}{'approaches':>11}{'contacts':>9}{'least m':>9}{'median m':>9}{'drove':>7}")
    for loss in LOSSES:
        random = np.random.default_rng([options.seed, LOSSES.index(loss)])
        rows = [driven(drawn(random, loss, options.at), random) for _ in range(options.count // len(LOSSES) + 1)]
        contacts, clearance, distance = (np.array(column) for column in zip(*rows, strict=True))
        moved = distance > 0.05
        touched = int((contacts > 0).sum())
        median = float(np.median(clearance[moved])) if moved.any() else np.nan
        print(
            f"{loss:<12}{len(rows):>11}{touched:>9}{clearance.min():>9.3f}{median:>9.3f}{moved.mean():>7.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
