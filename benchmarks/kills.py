"""Missions killed at a random time and gone on with, against as many that nobody killed.

    python benchmarks/kills.py --seeds 20 --scenario house
    python benchmarks/kills.py --seeds 1 --scenario office --at 3000

A row a seed: when the mission was killed and from when it went on, simulated s; what was lost of its work on the wall,
s; CPU s until it drove on; whether the map opens after the kill, and whether summary and stages are those of the
mission that nobody killed, but for times and costs. Goes on where it ended.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from tfg_drake.mapfile.saved_map import load_map
from tfg_drake.storage.checkpoint import read_told

COSTS = ("resumed_at_s", "wall_time_s", "cpu_time_s", "real_time_factor", "peak_rss_bytes", "stage_ms")
SHOWN = re.compile(rb"(\d+\.\d) s  ")


def explore(*arguments: str, stop=None) -> tuple[float, float]:
    """Runs a mission, or kills it as soon as `stop` says so of the simulated time that it shows; that time, and CPU s
    when it first was one that the mission drove on from."""
    command = [
        sys.executable,
        "-m",
        "tfg_drake.diagrams.cli",
        "explore",
        *arguments,
        "--headless",
        "--max-time",
        "7200",
    ]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    shown, first = 0.0, 0.0
    assert process.stdout is not None
    for chunk in iter(lambda: process.stdout.read1(4096), b""):
        if found := SHOWN.findall(chunk):
            shown = float(found[-1])
            if not first and shown:
                ticks = Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()[11:13]
                first = sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")
            if stop is not None and stop(shown):
                process.send_signal(signal.SIGKILL)
    process.wait()
    return shown, first


def row(scenario: str, seed: int, at: float, folder: Path) -> dict[str, object]:
    """One mission, killed and gone on with."""
    whole, killed = folder / f"{scenario}-{seed}-whole", folder / f"{scenario}-{seed}-killed"
    if not (whole / "summary.json").exists():
        explore(scenario, "--seed", str(seed), "--out", str(whole))
    summary = json.loads((whole / "summary.json").read_text())
    at = at or float(np.random.default_rng(seed).uniform(0.0, summary["sim_time_s"]))
    shutil.rmtree(killed, ignore_errors=True)
    died, _ = explore(scenario, "--seed", str(seed), "--out", str(killed), stop=lambda shown: shown >= at)
    opens = not (killed / "map.npz").exists() or load_map(killed / "map.npz").stage > 0
    lost, cpu, told = 0.0, 0.0, {"sim_time_s": summary["sim_time_s"]}
    if not (killed / "summary.json").exists():  # Else it came too late.
        lost, told = time.time() - (killed / "checkpoint.bin").stat().st_mtime, read_told(killed)
        _, cpu = explore("--resume", str(killed))
    after = json.loads((killed / "summary.json").read_text())
    kept = [key for key in summary if key not in COSTS and not key.endswith("cpu_s")]
    return {
        "seed": seed,
        "killed_s": died,
        "resumed_s": told["sim_time_s"],
        "lost_wall_s": round(lost, 2),
        "cpu_until_driving_s": cpu,
        "map_opens": opens,
        "outcome": after["outcome"],
        "tags": f"{after['landmarks_mapped']} of {after['landmarks_reachable']}",
        "rmse_m": after["landmark_rmse_m"],
        "same": all(after[key] == summary[key] for key in kept)
        and (killed / "stages.jsonl").read_bytes() == (whole / "stages.jsonl").read_bytes(),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--scenario", default="house")
    parser.add_argument("--at", type=float, default=0.0, help="simulated s; 0: at a random time")
    parser.add_argument("--out", type=Path, default=Path("runs/kills"))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    rows = options.out / f"{options.scenario}.jsonl"
    done = [json.loads(line) for line in rows.read_text().splitlines()] if rows.exists() else []
    for seed in range(options.seeds):
        if seed not in [one["seed"] for one in done]:
            done.append(row(options.scenario, seed, options.at, options.out))
            with rows.open("a") as file:
                file.write(json.dumps(done[-1]) + "\n")
        print(
            *(f"{key} {value}" for key, value in next(one for one in done if one["seed"] == seed).items()), flush=True
        )
    print(f"\n{sum(one['same'] for one in done)} of {len(done)} end as if nobody had killed them")
