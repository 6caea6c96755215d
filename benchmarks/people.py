"""Missions among people who walk about: outcome, contacts, what is left of people in the map, and time, a row a seed.

    python benchmarks/people.py house --people 5 --seeds 20 --out DIR
    python benchmarks/people.py office --people 10 --seeds 1 --max-time 20000 --out DIR

Each seed is run with people and without, one mission at a time; the same command in the same folder goes on where it
was stopped. Anything after the known options goes to `tfg-drake explore` unchanged.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path

HEADS = ("seed", "outcome", "mapped", "of", "contacts", "received", "phantom m", "time s", "alone s", "ratio")
# Bounds for every seed: length of phantom surface, m, and ratio of the time to that of the mission without people.
MOST_PHANTOM, MOST_TIME = 1.0, 1.3


def run(arguments: list[str], seed: int, people: int, out: Path) -> dict:
    """The summary of one headless mission, from its folder if it has been run there."""
    folder = out / f"seed-{seed}-people-{people}"
    if not (folder / "summary.json").exists():
        command = [sys.executable, "-m", "tfg_drake.diagrams.cli", "explore", *arguments, "--headless"]
        command += ["--seed", str(seed), "--set", f"reality.people={people}", "--out", str(folder)]
        subprocess.run(command, capture_output=True, text=True, check=False)
    return json.loads((folder / "summary.json").read_text())


def holds(among: dict, alone: dict) -> bool:
    """Whether a mission among people is as good as it has to be."""
    return (
        among["outcome"] == "complete"
        and among["landmarks_mapped"] >= alone["landmarks_mapped"]
        and not among["contacts"]
        and among["surface_phantom_m"] < MOST_PHANTOM
        and among["sim_time_s"] <= MOST_TIME * alone["sim_time_s"]
    )


def main() -> None:
    """Run, print a row as each pair of missions ends, then of how many seeds all holds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=int, default=5)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=None)
    options, arguments = parser.parse_known_args()
    out = options.out or Path(tempfile.mkdtemp(prefix="people-"))
    out.mkdir(parents=True, exist_ok=True)

    print("".join(f"{head:>10}" for head in HEADS), flush=True)
    good, ratios = 0, []
    for seed in range(options.first_seed, options.first_seed + options.seeds):
        alone, among = (run(arguments, seed, people, out) for people in (0, options.people))
        ratios.append(among["sim_time_s"] / alone["sim_time_s"])
        good += holds(among, alone)
        row = [seed, among["outcome"], among["landmarks_mapped"], among["landmarks_reachable"], among["contacts"]]
        row += [among["contacts_received"], f"{among['surface_phantom_m']:.2f}", f"{among['sim_time_s']:.0f}"]
        row += [f"{alone['sim_time_s']:.0f}", f"{ratios[-1]:.2f}"]
        print("".join(f"{cell:>10}" for cell in row), flush=True)
    print(f"all holds of {good} of {len(ratios)}; time {sum(ratios) / len(ratios):.2f} times that without people")


if __name__ == "__main__":
    main()
