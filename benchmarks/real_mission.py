"""A whole mission of a real robot's explorer against an emulated robot in real time, beside simulated missions.

    python benchmarks/real_mission.py kobuki --world house --simulated 3
    python benchmarks/real_mission.py ros2 without_ros without_tags --world house --simulated 0

Starts `tfg-drake kobuki emulate` or `tfg-drake ros2 emulate`, then `tfg-drake explore --robot` for that robot, enables
the wheels and waits for the end. The emulator is asked for its true pose ten times a second, and the run is measured by
it as a simulated one is by its own truth: the explorer does not know it. Prints a line a run; what is in --out is not
run again.

`without_ros` is a Kobuki with an RPLidar and a camera of its own, as docs/map_my_house.md has it: the camera is
calibrated and looked through first; on the way its stream ends and comes again, and the scanner's cable is pulled and
put back.
`without_tags` is a Kobuki with a scanner alone: the column `mapped` has its walls.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import re
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from typing import IO, Any

import numpy as np

from tfg_drake.comparison import metrics
from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld
from tfg_drake.geometry.se2 import compose, rotation
from tfg_drake.mapfile.saved_map import load_map
from tfg_drake.storage.trajectory import poses_at, read_tum

CLI = [sys.executable, "-m", "tfg_drake.diagrams.cli"]
FIELDS = {"outcome": "", "time": "s", "distance": "m", "mapped": "", "position": "m", "heading": "rad"}
FIELDS |= {"landmarks": "m", "aligned": "m", "contacts": ""}

# Time after which the operator enables a base again that has stopped until it is enabled, s.
ANEW = 2.0
# Events on the robot without ROS: time after it was enabled, s, and order to the emulator.
INCIDENTS = ((60.0, "camera off"), (70.0, "camera on"), (110.0, "lidar unplug"), (115.0, "lidar plug"))


class Emulator:
    """The emulated robot; truth: what it said of itself, a dictionary a report."""

    def __init__(self, robot: str, world: str, out: Path) -> None:
        """out: a folder for what is calibrated."""
        place = {
            "kobuki": ["kobuki", "emulate", "--world", world],
            "ros2": ["ros2", "emulate", world],
            "without_ros": ["kobuki", "emulate", "--world", world, "--sensors"],
            "without_tags": ["kobuki", "emulate", "--world", world],
        }[robot]
        self._process = subprocess.Popen([*CLI, *place], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        lines = [self._process.stdout.readline().strip()]
        count = 5 if robot == "without_ros" else 2
        while len(lines) < count or (robot == "ros2" and not lines[-1].startswith("/cmd_vel")):
            lines.append(self._process.stdout.readline().strip())
        # What explore is told to find it, and what happens to it.
        self.arguments = ["--preset", "emulated"]
        self.incidents: tuple[tuple[float, str], ...] = ()
        if robot == "kobuki":
            source = f"socket:{lines[1]}"
            self.arguments = ["--port", lines[0], "--tags", source, "--scan", source]
        if robot == "without_tags":
            self.arguments = ["--port", lines[0], "--scan", f"socket:{lines[1]}"]
        if robot == "without_ros":
            device, _, scanner, camera, board = lines
            self.arguments = ["--port", device, "--tags", camera, "--scan", scanner, *_calibrated(camera, board, out)]
            self.incidents = INCIDENTS
        # Held while an order is written.
        self._lock = threading.Lock()
        self.truth: list[dict[str, Any]] = []
        for target in (self._listen, self._ask):
            threading.Thread(target=target, daemon=True).start()

    def _listen(self) -> None:
        assert self._process.stdout is not None
        self.truth += (json.loads(line) for line in self._process.stdout)

    def _ask(self) -> None:
        while self._process.poll() is None:
            self._order("report")
            time.sleep(0.1)

    def _order(self, line: str) -> None:
        assert self._process.stdin is not None
        with self._lock:
            self._process.stdin.write(f"{line}\n")
            self._process.stdin.flush()

    def begin(self) -> None:
        """From now on the incidents' times count."""
        for after, line in self.incidents:
            threading.Timer(after, self._order, (line,)).start()

    def close(self) -> None:
        self._process.terminate()
        self._process.wait()


def _calibrated(camera: str, board: str, out: Path) -> list[str]:
    """Options of explore for a camera, after it was calibrated and looked through."""
    file, source = out / "camera.yaml", camera.removeprefix("camera:")
    subprocess.run(
        [*CLI, "camera", "calibrate", board, "--board", "9x6", "--square", "0.025", "--out", str(file)], check=True
    )
    check = ["--calibration", str(file), "--tag-size", "0.16", "--frames", "8", "--out", str(out / "seen.png")]
    subprocess.run([*CLI, "camera", "check", source, *check], check=True)
    settings = [f"calibration={file}", "x=0.05", "latency=0.15"]
    return [word for setting in settings for word in ("--set", f"hardware.camera.{setting}")]


def real(robot: str, world: str, speed: float, max_time: float, out: Path) -> dict[str, Any]:
    """The figures of one mission in real time, which are kept beside its folder."""
    out.parent.mkdir(parents=True, exist_ok=True)
    kept = out.with_suffix(".json")
    if kept.exists():
        return json.loads(kept.read_text())
    emulator = Emulator(robot, world, out.parent)
    robot = "kobuki" if robot.startswith("without") else robot
    arguments = [*emulator.arguments, "--max-time", f"{max_time:g}", "--set", f"hardware.max_speed={speed}"]
    command = [*CLI, "explore", "--robot", robot, *arguments, "--headless", "--out", str(out)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        for line in process.stdout:
            print(f"  {line.rstrip()}", flush=True)
            if line.startswith("nothing moves before"):
                _press(process.stdin)
                emulator.begin()
            if "until it is enabled anew" in line:  # on a busy machine odometry pauses
                threading.Timer(ANEW, _press, (process.stdin,)).start()
    emulator.close()
    scene = MakeWorld(LoadScenario(world).world)
    origin = float(re.findall(r"time 0 is ([0-9.]+) s", (out / "log.txt").read_text())[0])
    true_stamps = np.array([report["stamp"] for report in emulator.truth]) - origin
    true_poses = np.array([report["pose"] for report in emulator.truth])
    stamps, X_MB = read_tum(out / "trajectory.tum")
    known = (stamps >= true_stamps[0]) & (stamps <= true_stamps[-1])
    X_WB = compose(scene.start, X_MB[known])
    position, heading = metrics.pose_errors(X_WB, poses_at(stamps[known], true_stamps, true_poses))
    saved = load_map(out / "map.npz")
    row_of = {tag: row for row, tag in enumerate(scene.tag_ids.tolist())}
    p_WL = scene.start[:2] + saved.p_ML @ rotation(scene.start[2]).T
    p_WL_true = scene.p_WT[[row_of[tag] for tag in saved.ids.tolist()]]
    summary = json.loads((out / "summary.json").read_text())
    figures = {
        "outcome": summary["outcome"],
        "time": summary["sim_time_s"],
        "distance": emulator.truth[-1]["distance"],
        "mapped": len(saved.ids) or summary["walls_mapped"],
        "position": position.mean(),
        "heading": np.abs(heading).mean(),
        "landmarks": metrics.landmark_rmse(p_WL, p_WL_true),
        "aligned": metrics.landmark_rmse_aligned(p_WL, p_WL_true),
        "contacts": emulator.truth[-1]["contacts"],
    }
    kept.write_text(json.dumps(figures))
    return figures


def _press(keys: IO[str]) -> None:
    """Enables the wheels, unless the mission is over."""
    with contextlib.suppress(OSError, ValueError):
        keys.write("e")
        keys.flush()


def simulated(world: str, speed: float, seed: int, max_time: float, out: Path) -> dict[str, Any]:
    """The same figures of a simulated mission."""
    arguments = ["--seed", str(seed), "--max-time", f"{max_time:g}", "--set", f"robot.max_speed={speed}"]
    command = [*CLI, "explore", world, *arguments, "--headless", "--out", str(out)]
    subprocess.run(command, check=False, stdout=subprocess.DEVNULL)
    summary = json.loads((out / "summary.json").read_text())
    return {
        "outcome": summary["outcome"],
        "time": summary["sim_time_s"],
        "distance": summary["distance_m"],
        "mapped": summary["landmarks_mapped"],
        "position": summary["position_error_m"]["mean"],
        "heading": summary["heading_error_rad"]["mean"],
        "landmarks": summary["landmark_rmse_m"],
        "aligned": summary["landmark_rmse_aligned_m"],
        "contacts": summary["contacts"],
    }


def line(name: str, figures: dict[str, Any]) -> str:
    """A row of the table."""
    cells = [f"{figures[field]:.4g}" if isinstance(figures[field], float) else str(figures[field]) for field in FIELDS]
    return "  ".join(f"{cell:>12}" for cell in (name, *cells))


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robots", choices=("kobuki", "ros2", "without_ros", "without_tags"), nargs="+")
    parser.add_argument("--speed", type=float, default=0.3, help="limit of both, m/s")
    parser.add_argument("--world", default="house")
    parser.add_argument("--max-time", type=float, default=3600.0)
    parser.add_argument("--simulated", type=int, default=3, help="simulated missions beside it")
    parser.add_argument("--out", type=Path, help="keep the runs' folders here")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        out = options.out or Path(temporary)
        mission = options.world, options.speed, options.max_time
        rows = [line(robot, real(robot, *mission, out / robot)) for robot in options.robots]
        for seed in range(options.simulated):
            folder = out / f"seed{seed}"
            rows.append(line(f"seed {seed}", simulated(options.world, options.speed, seed, options.max_time, folder)))
    heads = [f"{field} {unit}".strip() for field, unit in FIELDS.items()]
    print("\n" + "  ".join(f"{cell:>12}" for cell in ("", *heads)))
    print("\n".join(rows))


if __name__ == "__main__":
    main()
