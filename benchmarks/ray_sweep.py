"""Many runs on a local Ray cluster and as many by processes of one's own: the same bits, though a worker is killed.

    python benchmarks/ray_sweep.py house --seeds 100 --max-time 18 --jobs 2

Both are `tfg-drake compare` with the methods tfg and tfg-nearest; while Ray runs, a worker of its is killed each time
a quarter of the runs is done. Prints how many runs there are, and which differ in anything but times, CPU and memory.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

METHODS = "tfg,tfg-nearest"
# Endings of summary fields that depend on a machine's speed and load.
MACHINE = ("wall_time_s", "cpu_time_s", "real_time_factor", "_cpu_s", "peak_rss_bytes", "stage_ms")


def sweep(arguments: list[str], out: Path, kill: int) -> dict[tuple[str, str], dict[str, str]]:
    """The runs of one comparison by method and seed, less what the machine may change; every `kill` runs (0: never) a
    worker of Ray's is killed."""
    command = [sys.executable, "-m", "tfg_drake.diagrams.cli", "compare", *arguments, "--out", str(out)]
    done = 0
    with subprocess.Popen([*command, "--methods", METHODS], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        for line in process.stdout:
            done += ", seed " in line
            if kill and done and done % kill == 0 and ", seed " in line:
                print(f"{done} runs done: killed {kill_worker() or 'none, as none was at work'}", flush=True)
    with (out / "runs.csv").open() as file:
        rows = list(csv.DictReader(file))
    return {
        (row["method"], row["seed"]): {k: v for k, v in row.items() if not any(word in k for word in MACHINE)}
        for row in rows
    }


def kill_worker() -> str:
    """Kills a process that runs a mission for Ray, as soon as there is one; its name, "" where none comes in 10 s."""
    for _ in range(200):
        for folder in Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                name = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode().strip()
                if name.startswith("ray::_mission"):
                    os.kill(int(folder.name), signal.SIGKILL)
                    return name
        time.sleep(0.05)
    return ""


def main() -> None:
    """Run both and compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--jobs", type=int, default=2)
    options, arguments = parser.parse_known_args()
    arguments += ["--seeds", str(options.seeds)]
    out = Path(tempfile.mkdtemp(prefix="ray-sweep-"))
    jobs = sweep([*arguments, "--jobs", str(options.jobs)], out / "jobs", 0)
    ray = sweep([*arguments, "--ray", "local"], out / "ray", max(1, options.seeds // 2))
    different = [key for key in jobs.keys() | ray.keys() if jobs.get(key) != ray.get(key)]
    print(f"{len(jobs)} runs by --jobs, {len(ray)} on Ray, {len(different)} of them different; in {out}")
    for method, seed in sorted(different):
        print(f"  {method}, seed {seed}")


if __name__ == "__main__":
    main()
