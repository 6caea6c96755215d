"""Makes the tables of docs/results.md anew, all by the code that is here.

    python benchmarks/results.py --data FOLDER
    python benchmarks/results.py --tables offices flat --data FOLDER
    python benchmarks/results.py --tables missions --rows house paper_real --seeds 3 --dry

A table is what one benchmark prints after its last empty line, below the command and the commit; the tables missions
and deviations are made here, a row a world. All runs are in --out, which has the commit in its name unless it is given:
what is there is not run again, so that a run that was ended goes on. FOLDER has recordings and floors that are not the
project's; tables that need it stay as they are without it. A table goes to docs/tables, and from there into the
document. --dry prints the tables and leaves both alone.
"""

from __future__ import annotations

import argparse
import json
import shlex
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import reality

BENCHMARKS = Path(__file__).parent
DOCUMENT = BENCHMARKS.parent / "docs" / "results.md"
TABLES = DOCUMENT.parent / "tables"
DATA = "DATA"
# Arguments of the benchmarks that print a table, several by " + ", and the CPU minutes that it takes; DATA stands for
# --data.
PRINTED: dict[str, tuple[str, int]] = {
    "relations": (f"relations.py {DATA}/radish --methods walls --out relations.jsonl", 6),
    "regions": (f"relation_regions.py {DATA}/radish regions", 10),
    "mapex": (f"mapex.py {DATA}/mapex --methods nearest exact", 70),
    "stated": (
        'consistency.py --seeds 3 + tag_spacing.py --rows "paper, 1" "paper, none" --seeds 3 + look_alikes.py --seeds 1'
        ' + offices.py --rows offices + offices.py --rows "people, glass" --seeds 10',
        100,
    ),
    "found": (
        f"relocation.py --world {DATA}/maps/flat.yaml --starts 8 --seeds 5 --time 60 --out flat"
        " + relocation.py house paper --starts 8 --time 60 --out relocation"
        " + relocation.py offices --offices 5 --starts 2 --time 60 --out offices",
        40,
    ),
    "pieces": (f"located_pieces.py {DATA}/radish regions --pieces 100", 30),
    "sessions": ("sessions.py", 8),
    "kills": ("kills.py", 20),
}
# The rows of either table: scenario and number of seeds. All missions together take 54 CPU-minutes.
MISSIONS = {"paper": 20, "corridor": 6, "house": 10, "paper_real": 10, "house_real": 30}
DEVIATIONS = [row for row in reality.ROWS if row != reality.BELIEVED]
SEEDS = 6
HEADER = (
    "| world | seeds | complete | contacts | mapped (worst) | time | distance | position (worst) | heading"
    " | landmark RMSE (worst tag) | NEES of landmarks, departures, online poses | speed |"
)


def command(row: str, seed: int, folder: Path) -> list[str]:
    """The command of one mission of a row."""
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
    """The document with a table from the mark of its name to the next empty line."""
    mark = f"<!-- {name}: made by benchmarks/results.py -->\n"
    before, found, rest = text.partition(mark)
    if not found:
        raise SystemExit(f"{DOCUMENT}: has no mark {mark.strip()}")
    _, _, after = rest.partition("\n\n")
    return f"{before}{mark}{table}\n{after}"


def printed(name: str, data: Path | None, out: Path) -> str | None:
    """A table that a benchmark prints, with its command and version; None where it needs data that is not there, or
    fails."""
    lines: list[str] = []
    for arguments in PRINTED[name][0].split(" + "):
        if data is None and DATA in arguments:
            print(f"{name}: needs --data", flush=True)
            return None
        script, *rest = shlex.split(arguments.replace(DATA, str(data and data.resolve())))
        out.mkdir(parents=True, exist_ok=True)
        done = subprocess.run(
            [sys.executable, str(BENCHMARKS / script), *rest], cwd=out, stdout=subprocess.PIPE, text=True, check=False
        )
        if done.returncode:
            print(f"{name}: exit code {done.returncode}", flush=True)
            return None
        table = done.stdout.rstrip().rsplit("\n\n", 1)[-1].splitlines()
        # Columns of the same names are named once.
        lines += [f"$ python benchmarks/{arguments}  # {version()}", *(one for one in table if one not in lines)]
    return "\n".join(["```", *lines, "```", ""])


def of_missions(name: str, options: argparse.Namespace) -> str | None:
    """The table of whole missions, or that of worlds that are not as believed; None where no row of it is wanted."""
    lines = {}
    with ThreadPoolExecutor(options.jobs) as pool:
        for row in [row for row in (MISSIONS if name == "missions" else DEVIATIONS) if row in options.rows]:
            seeds = range(options.seeds or MISSIONS.get(row, SEEDS))
            runs = [one for one in pool.map(lambda seed, row=row: run(row, seed, options.out), seeds) if one]
            if runs:
                lines[row] = line(row, runs)
    ruled = "|" + "---|" * (HEADER.count("|") - 1)
    header = HEADER.replace("world", f"world (`{version()}`)")
    return "\n".join([header, ruled, *lines.values(), ""]) if lines else None


def main() -> None:
    """Run what is missing and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", nargs="+", choices=["missions", "deviations", *PRINTED], help="These alone.")
    parser.add_argument("--data", type=Path)
    parser.add_argument("--rows", nargs="+", choices=[*MISSIONS, *DEVIATIONS], default=[*MISSIONS, *DEVIATIONS])
    parser.add_argument("--seeds", type=int, help="Of each row, instead of its own number.")
    parser.add_argument("--jobs", type=int, default=2, help="Missions at a time.")
    parser.add_argument("--out", type=Path, default=Path("runs") / f"results-{version().split(',')[0]}")
    parser.add_argument("--dry", action="store_true", help="Print the tables only.")
    options = parser.parse_args()

    wanted, made = options.tables or ["missions", "deviations", *PRINTED], {}
    for name in wanted:
        table = printed(name, options.data, options.out) if name in PRINTED else of_missions(name, options)
        if table is not None:
            print(table, flush=True)
            made[name] = table
    if made and not options.dry:
        TABLES.mkdir(exist_ok=True)
        for name, table in made.items():
            (TABLES / f"{name}.md").write_text(table)
            DOCUMENT.write_text(replaced(DOCUMENT.read_text(), name, table))


if __name__ == "__main__":
    main()
