"""Makes the tables of whole missions in docs/results.md anew, all rows by the code that is here.

    python benchmarks/results.py
    python benchmarks/results.py --rows house paper_real --seeds 3 --dry

Each mission is a process of its own, and kept in a folder of its own (--out, row, seed; unless it is given, --out has
the commit in its name): what is there is not run again, so that a run that was ended goes on. A row that has fewer
missions than it should says so by its number of seeds. --dry prints the tables and leaves the document alone.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import reality

DOCUMENT = Path(__file__).parents[1] / "docs" / "results.md"
# The rows of either table: scenario and number of seeds. All missions together take 54 CPU-minutes.
MISSIONS = {"paper": 20, "corridor": 6, "house": 10, "paper_real": 10, "house_real": 30}
DEVIATIONS = [row for row in reality.ROWS if row != reality.BELIEVED]
SEEDS = 6
HEADER = (
    "| world | seeds | complete | contacts | mapped (worst) | time | distance | position (worst) | heading"
    " | landmark RMSE (worst tag) | NEES of landmarks, departures, online poses | speed |"
)


def command(row: str, seed: int, folder: Path) -> list[str]:
    """What runs one mission of a row."""
    scenario = row if row in MISSIONS else "paper"
    line = [sys.executable, "-m", "tfg_drake.diagrams.cli", "explore", scenario, "--headless"]
    line += ["--seed", str(seed), "--out", str(folder), "--max-time", "3600"]
    for setting in reality.settings(row, seed) if row in reality.ROWS else []:
        line += ["--set", setting]
    return line


def run(row: str, seed: int, out: Path) -> dict | None:
    """summary.json of one mission, run where it is not there yet; None of one that left none."""
    folder = out / row.replace(" ", "_").replace(",", "") / f"seed-{seed}"
    path = folder / "summary.json"
    if not path.exists():
        done = subprocess.run(command(row, seed, folder), capture_output=True, text=True, check=False)
        print(f"{row}, seed {seed}: {'done' if path.exists() else done.stderr.strip()[-200:]}", flush=True)
    return json.loads(path.read_text()) if path.exists() else None


def line(row: str, runs: list[dict]) -> str:
    """A row of a table."""

    def mean(*keys: str) -> float:
        values: list = list(runs)
        for key in keys:
            values = [value[key] for value in values]
        return float(np.mean(values))

    mapped = min(s["landmarks_mapped"] / s["landmarks_reachable"] for s in runs)
    name = f"`{row}`" if row in MISSIONS else row
    cells = [
        name,
        str(len(runs)),
        str(sum(s["outcome"] == "complete" for s in runs)),
        str(sum(s["contacts"] for s in runs)),
        f"{100.0 * mapped:.1f} %",
        f"{mean('sim_time_s'):.0f} s",
        f"{mean('distance_m'):.0f} m",
        f"{mean('position_error_m', 'mean'):.3f} m ({max(s['position_error_m']['mean'] for s in runs):.3f} m)",
        f"{mean('heading_error_rad', 'mean'):.4f} rad",
        f"{mean('landmark_rmse_m'):.3f} m ({max(s['landmark_error_max_m'] for s in runs):.2f} m)",
        ", ".join(f"{mean(name):.2f}" for name in ("landmark_nees", "pose_anees", "online_pose_anees")),
        f"{np.mean([s['sim_time_s'] / s['cpu_time_s'] for s in runs]):.0f}",
    ]
    return "| " + " | ".join(cells) + " |"


def version() -> str:
    """The commit that is checked out, and whether it is what runs."""
    here = DOCUMENT.parent
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=here, capture_output=True, text=True, check=True
    )
    changed = subprocess.run(
        ["git", "status", "--porcelain", "-uno"], cwd=here, capture_output=True, text=True, check=True
    )
    return commit.stdout.strip() + (", with changes" if changed.stdout.strip() else "")


def replaced(text: str, name: str, table: str) -> str:
    """The document with a table between the marks of its name."""
    begin, end = f"<!-- {name}: made by benchmarks/results.py -->\n", f"<!-- end of {name} -->"
    before, _, rest = text.partition(begin)
    _, _, after = rest.partition(end)
    if not after:
        raise SystemExit(f"{DOCUMENT}: has no marks {begin.strip()} and {end}")
    return f"{before}{begin}{table}\n{end}{after}"


def main() -> None:
    """Run what is missing and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", nargs="+", choices=[*MISSIONS, *DEVIATIONS], default=[*MISSIONS, *DEVIATIONS])
    parser.add_argument("--seeds", type=int, help="Of each row, instead of its own number.")
    parser.add_argument("--jobs", type=int, default=2, help="Missions at a time.")
    parser.add_argument("--out", type=Path, default=Path("runs") / f"results-{version().split(',')[0]}")
    parser.add_argument("--dry", action="store_true", help="Print the tables only.")
    options = parser.parse_args()

    lines = {}
    with ThreadPoolExecutor(options.jobs) as pool:
        for row in options.rows:
            seeds = range(options.seeds or MISSIONS.get(row, SEEDS))
            runs = [one for one in pool.map(lambda seed, row=row: run(row, seed, options.out), seeds) if one]
            if runs:
                lines[row] = line(row, runs)
    text = DOCUMENT.read_text()
    for name, rows in (("missions", list(MISSIONS)), ("deviations", DEVIATIONS)):
        ruled = "|" + "---|" * (HEADER.count("|") - 1)
        made = [lines[row] for row in rows if row in lines]
        table = "\n".join([f"Version `{version()}`.\n", HEADER, ruled, *made, ""])
        print(table, flush=True)
        if made and not options.dry:
            text = replaced(text, name, table)
    if not options.dry:
        DOCUMENT.write_text(text)


if __name__ == "__main__":
    main()
