"""Missions whose disk fills up on the way: what is told, and what is on the disk at the end.

    python benchmarks/disk_full.py house --points 10

Mounts a small disk in memory (as root), runs `tfg-drake explore` into it, and fills it up to the last byte when the
mission has come to a share of its stages, the first time at its start. Prints a line a mission, and below it the lines
that the command showed beside its progress and its table.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from tfg_drake.mapfile.saved_map import MapFileError, load_map

CLI = [sys.executable, "-m", "tfg_drake.diagrams.cli"]
# Of the disk, bytes: the reserve of a run and its recording fit.
SIZE = 64 * 2**20
TOLD = ("cannot be written", "no room", "not whole", "Traceback", "Exception")


@contextlib.contextmanager
def small_disk() -> Iterator[Path]:
    """A disk of SIZE bytes, mounted meanwhile."""
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", folder], check=True)
        try:
            yield Path(folder)
        finally:
            subprocess.run(["umount", folder], check=True)


def fill(disk: Path) -> None:
    """Writes until nothing fits any more."""
    block = bytes(2**20)
    with (disk / "filler").open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(block)
    with (disk / "filler").open("ab", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(block[:1])


def stages(folder: Path) -> int:
    """Stages that the mission has come to; -1 before it begins."""
    try:
        return len((folder / "stages.jsonl").read_text().splitlines())
    except OSError:
        return -1


def mission(scenario: str, at: int | None, seed: int) -> tuple[int, str, int, int, int, list[str]]:
    """One mission on a disk that fills up at a stage, or does not.

    Returns the exit code, the outcome, stages, landmarks in the summary and in the map, -1 of a file that does not
    open, and the lines that were shown.
    """
    with small_disk() as disk:
        out = disk / "run"
        command = [*CLI, "explore", scenario, "--headless", "--json", "--seed", str(seed), "--out", str(out)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        while at is not None and process.poll() is None:
            if stages(out) >= at:
                fill(disk)
                break
            time.sleep(0.02)
        shown = process.communicate()[0].splitlines()
        lines = [line.replace(str(disk), "DISK") for line in shown[:-1] if any(word in line for word in TOLD)]
        try:
            landmarks = len(load_map(out / "map.npz").ids)
        except MapFileError:
            landmarks = -1
        try:
            summary = json.loads((out / "summary.json").read_text())
        except (OSError, ValueError):
            return process.returncode, "no summary", -1, -1, landmarks, lines
    return process.returncode, summary["outcome"], summary["stages"], summary["landmarks_mapped"], landmarks, lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenario")
    parser.add_argument("--points", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    _, outcome, count, mapped, _, _ = mission(arguments.scenario, None, arguments.seed)
    print(f"never full: {outcome}, {count} stages, {mapped} landmarks", flush=True)
    good = 0
    for point in range(arguments.points):
        at = count * point // arguments.points
        code, outcome, came, of, landmarks, lines = mission(arguments.scenario, at, arguments.seed)
        good += outcome == "complete" and landmarks == mapped
        opens = f"the map opens, {landmarks} of {mapped} landmarks" if landmarks >= 0 else "the map does not open"
        print(f"full at stage {at:3d}: exit {code}, {outcome}, {came} stages, {of} landmarks; {opens}")
        print("".join(f"    {line}\n" for line in lines), end="", flush=True)
    print(f"{good} of {arguments.points} missions complete, with the whole map")


if __name__ == "__main__":
    main()
