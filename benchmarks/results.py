"""Makes the tables of docs/results.md anew, all by the code that is here.

    python benchmarks/results.py --data FOLDER
    python benchmarks/results.py --tables found floors --data FOLDER
    python benchmarks/results.py --tables missions --rows house paper_real --seeds 3 --dry

A table is what benchmarks print after their last empty line, below their commands and the commit, or a row a world of
missions that are run here. All runs are in --out, which has the commit in its name unless it is given: what is there is
not run again, so that a run that was ended goes on. FOLDER has recordings and floors that are not the project's; tables
that need it stay as they are without it. A table goes to docs/tables, and from there into the document. --dry prints
the tables and leaves both alone. At the end: the CPU hours that each table has taken so far.
"""

from __future__ import annotations

import argparse
import functools
import json
import resource
import shlex
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import offices
import reality

BENCHMARKS = Path(__file__).parent
DOCUMENT = BENCHMARKS.parent / "docs" / "results.md"
TABLES = DOCUMENT.parent / "tables"
# Placeholders in arguments: the folder of --data, the office plan of a seed, and the seed's deviation from the model.
DATA, PLAN, DEVIATION = "DATA", "PLAN", "DEVIATION"
# Arguments of the benchmarks that print a table, several by " + ".
PRINTED: dict[str, str] = {
    "relations": f"relations.py {DATA}/radish --methods walls --out relations.jsonl",
    "mapex": f"mapex.py {DATA}/mapex --methods nearest exact tour --out mapex.jsonl"
    f" + mapex.py {DATA}/mapex --methods ours --out mapex_ours.jsonl",
    "regret": "regret.py --seeds 2 --out regret --tours tours",
    "stated": "offices.py --rows offices --out stated.jsonl"
    " + offices.py --rows 'people, glass' --seeds 10 --out stated.jsonl + look_alikes.py --seeds 3 --out stated.jsonl",
    "logs": f"relation_regions.py {DATA}/radish regions + located_pieces.py {DATA}/radish regions --pieces 100",
    "undiscovered": "undiscovered.py --out undiscovered.jsonl",
    "found": f"relocation.py --world {DATA}/maps/flat.yaml --starts 8 --seeds 5 --time 60 --out flat"
    " + relocation.py house paper --starts 8 --time 60 --out relocation"
    " + relocation.py offices --offices 5 --starts 2 --time 60 --out offices"
    " + relocation.py offices --offices 5 --starts 2 --time 60 --later --out later"
    " + relocation.py house --map flat/flat-map --starts 10 --out other",
    "sessions": "sessions.py",
    "carried": "disturbances.py carry --scenario house house_real paper --seeds 20 --out carried.jsonl",
    "faults": "kills.py --out kills + recording_mutations.py --first 300 --seeds 100 --rows mutations.jsonl"
    " + recording_mutations.py --good --first 300 --seeds 30 --rows good.jsonl"
    " + approaches.py --count 3000 --at wall end edge behind",
    "robots": "real_mission.py kobuki ros2 without_ros without_tags --simulated 0 --out robots",
    "sizes": "planning_map_size.py --stages 4 + map_size.py --goals 8",
}


class Row(NamedTuple):
    """Missions of a table: their name, the arguments of `tfg-drake explore`, and the seeds."""

    name: str
    arguments: str
    seeds: range


UNTAGGED = "--tag-spacing none --max-time 3600"
# Our method, and the one that it is compared with.
METHOD, OTHER = "tfg", "grid-nearest"
MISSIONS: dict[str, list[Row]] = {
    "explored": [
        Row("`house`", f"house {UNTAGGED}", range(40, 50)),
        Row("`paper`", f"paper {UNTAGGED}", range(40, 46)),
        Row("office plans", f"paper_real --world {PLAN} {UNTAGGED}", range(8)),
        Row("`house`, tags", "house --max-time 3600", range(40, 46)),
        Row("`paper`, tags", "paper --max-time 3600", range(40, 43)),
    ],
    "missions": [
        Row(f"`{world}`", f"{world} --max-time 3600", range(seeds))
        for world, seeds in {"paper": 10, "corridor": 4, "house": 10, "paper_real": 6, "house_real": 10}.items()
    ],
    "deviations": [Row("`paper`, one of eleven deviations", f"paper {DEVIATION} --max-time 3600", range(33))],
    "floors": [
        Row(f"`{name}`, {size}", f"--world {DATA}/maps/{file} --tag-spacing none --max-time 10000", range(2))
        for name, size, file in (
            ("LGRC1", "111 x 34 m", "LGRC1.vectormap.txt --start=50,29.8,0"),
            ("NSHA", "63 x 43 m", "NSHA.vectormap.txt --start=20,24,0"),
            ("building_31", "35 x 32 m", "building_31.yaml --start=-17,4,0"),
            ("GDC3", "88 x 56 m", "GDC3.vectormap.txt"),
        )
    ],
}
Summary = dict[str, Any]
Cell = tuple[str, Callable[[list[Summary]], str]]


def values(runs: list[Summary], *keys: str) -> list[float]:
    """A field of summary.json of each run, nan where it is None."""
    found: list = list(runs)
    for key in keys:
        found = [one[key] for one in found]
    return [float("nan") if one is None else one for one in found]


def mean(digits: int, *keys: str) -> Callable[[list[Summary]], str]:
    """The mean of a field over the runs that have it, - where none has."""

    def read(runs: list[Summary]) -> str:
        known = [value for value in values(runs, *keys) if np.isfinite(value)]
        return f"{np.mean(known):.{digits}f}" if known else "-"

    return read


def mean_and_worst(digits: int, *keys: str, worst: tuple[str, ...] = ()) -> Callable[[list[Summary]], str]:
    """The mean, and the largest of that field or of another."""
    return lambda runs: f"{mean(digits, *keys)(runs)} ({np.nanmax(values(runs, *(worst or keys))):.{digits}f})"


def count(runs: list[Summary]) -> str:
    return f"{sum(one['outcome'] == 'complete' for one in runs)} of {len(runs)}"


COMMON: list[Cell] = [
    ("complete", count),
    ("contacts", lambda runs: str(sum(one["contacts"] for one in runs))),
    ("explored s", mean(0, "explored_s")),
    ("way m", mean(0, "distance_m")),
    ("position m (worst mission)", mean_and_worst(3, "position_error_m", "mean")),
    ("heading rad", mean(4, "heading_error_rad", "mean")),
    ("NEES online (worst)", mean_and_worst(2, "online_pose_anees")),
]
CPU: Cell = ("CPU s", mean(0, "cpu_time_s"))
TAGS: list[Cell] = [
    ("mapped %", lambda runs: f"{100 * min(a['landmarks_mapped'] / a['landmarks_reachable'] for a in runs):.1f}"),
    ("RMSE m (worst tag)", mean_and_worst(3, "landmark_rmse_m", worst=("landmark_error_max_m",))),
    ("NEES of tags", mean(2, "landmark_nees")),
]
NEES = COMMON[-1]
EXPLORED = "explored"
CELLS: dict[str, list[Cell]] = {
    EXPLORED: [
        ("complete", count),
        ("explored s", mean(0, "explored_s")),
        ("99 % seen s", mean(0, "area_seen_s")),
        ("position m", mean(3, "position_error_m", "mean")),
        ("surface within 5 cm, %", lambda runs: f"{100 * np.mean(values(runs, 'surface_coverage_5cm')):.1f}"),
        CPU,
    ],
    "missions": [*COMMON, *TAGS, CPU],
    "deviations": [*COMMON, *TAGS],
    "floors": [
        *COMMON[:3],
        (
            "position m (worst instant)",
            mean_and_worst(2, "position_error_m", "mean", worst=("position_error_m", "max")),
        ),
        NEES,
        ("share of the time for the last hundredth", lambda runs: f"{np.nanmean(_last(runs)):.2f}"),
        CPU,
        ("memory GB", lambda runs: f"{max(values(runs, 'peak_rss_bytes')) / 1e9:.2f}"),
    ],
}


def _last(runs: list[Summary]) -> np.ndarray:
    """The share of the time until explored that the last hundredth of the area has taken."""
    return 1.0 - np.array(values(runs, "area_seen_s")) / np.array(values(runs, "explored_s"))


def run(arguments: list[str], folder: Path) -> Summary | None:
    """summary.json of one mission, run where it is not there yet or was interrupted; None of one that left none."""
    path = folder / "summary.json"
    if not path.exists() or json.loads(path.read_text())["outcome"] == "interrupted":
        command = [sys.executable, "-m", "tfg_drake.diagrams.cli", "explore", *arguments, "--headless", "--out", folder]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        print(f"{folder}: {'done' if path.exists() else done.stderr.strip()[-200:]}", flush=True)
    return json.loads(path.read_text()) if path.exists() else None


def runs_of(row: Row, options: argparse.Namespace, method: str = METHOD) -> list[Summary]:
    """Summaries of the missions of a row that left one."""

    def one(seed: int) -> Summary | None:
        arguments = row.arguments
        if PLAN in arguments:
            plan = options.out / "plans" / f"{seed}.yaml"
            offices.write(seed, plan)
            arguments = arguments.replace(PLAN, str(plan))
        deviations = [name for name in reality.ROWS if name != reality.BELIEVED]
        settings = reality.settings(deviations[seed % len(deviations)], seed)
        arguments = arguments.replace(DEVIATION, " ".join(f"--set {one}" for one in settings))
        line = shlex.split(arguments.replace(DATA, str(options.data and options.data.resolve())))
        line += ["--seed", str(seed), "--method", method]
        name = "".join(letter if letter.isalnum() else "_" for letter in row.name).strip("_")
        return run(line, options.out / method / name / str(seed))

    with ThreadPoolExecutor(options.jobs) as pool:
        return [summary for summary in pool.map(one, row.seeds[: options.seeds]) if summary]


def of_missions(name: str, options: argparse.Namespace) -> str | None:
    """A table of whole missions, a row a world; None where no row of it is wanted, or its data is not there."""
    columns = [(METHOD, head, read) for head, read in CELLS[name]]
    if name == EXPLORED:
        columns += [(METHOD, *NEES), *((OTHER, head, read) for head, read in CELLS[name])]
    heads = [
        f"`results.py --tables {name}`, `{version()}`",
        "seeds",
        *(f"{method}: {head}" if method == OTHER else head for method, head, _ in columns),
    ]
    heads += ["over"] * (name == EXPLORED)
    lines = []
    for row in MISSIONS[name]:
        if (options.rows and row.name.strip("`") not in options.rows) or (DATA in row.arguments and not options.data):
            continue
        runs = {method: runs_of(row, options, method) for method in dict.fromkeys(method for method, *_ in columns)}
        if not all(runs.values()):
            continue
        seeds = row.seeds[: options.seeds]
        cells = [row.name, f"{seeds[0]} to {seeds[-1]}", *(read(runs[method]) for method, _, read in columns)]
        if name == EXPLORED:
            ours, theirs = ({one["seed"]: one["explored_s"] or 0.0 for one in some} for some in runs.values())
            both = [seed for seed in ours if ours[seed] and theirs.get(seed)]
            cells.append(
                f"{sum(ours[seed] for seed in both) / sum(theirs[seed] for seed in both):.2f}" if both else "-"
            )
        lines.append("| " + " | ".join(cells) + " |")
    if not lines:
        return None
    return "\n".join([f"| {' | '.join(heads)} |", "|" + "---|" * len(heads), *lines, ""])


@functools.cache
def version() -> str:
    """The last commit that changed more than documents, and whether it is what runs."""
    code = ["--", ".", ":!docs", ":!*.md"]
    root = DOCUMENT.parents[1]
    commit = subprocess.run(
        ["git", "log", "-1", "--format=%h", *code], cwd=root, capture_output=True, text=True, check=True
    )
    changed = subprocess.run(
        ["git", "status", "--porcelain", "-uno", *code], cwd=root, capture_output=True, text=True, check=True
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
    tables: dict[str, list[str]] = {}
    for arguments in PRINTED[name].split(" + "):
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
        tables[arguments] = done.stdout.rstrip().rsplit("\n\n", 1)[-1].strip("\n").splitlines()
    if all(len(table) == 1 for table in tables.values()):
        return "\n".join([*(f"- `{arguments}`, `{version()}`: {line}." for arguments, (line,) in tables.items()), ""])
    lines: list[str] = []
    for arguments, table in tables.items():
        # Columns of the same names are named once.
        lines += [f"$ python benchmarks/{arguments}  # {version()}", *(one for one in table if one not in lines)]
    return "\n".join(["```", *lines, "```", ""])


def add_hours(out: Path, name: str, seconds: float) -> None:
    """Adds to the CPU seconds that a table has taken so far, and prints all of them."""
    path = out / "cpu_seconds.json"
    taken = json.loads(path.read_text()) if path.exists() else {}
    taken[name] = taken.get(name, 0.0) + seconds
    out.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(taken, indent=1))
    print(f"{name}: {taken[name] / 3600:.2f} CPU hours; {sum(taken.values()) / 3600:.2f} in all so far", flush=True)


def cpu_seconds() -> float:
    """CPU time of all processes that were waited for."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Run what is missing and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    tables = [*MISSIONS, *PRINTED]
    parser.add_argument("--tables", nargs="+", choices=tables, default=tables, help="These alone.")
    parser.add_argument("--data", type=Path)
    parser.add_argument("--rows", nargs="+", help="These rows of tables of missions alone.")
    parser.add_argument("--seeds", type=int, help="Of each row of missions at most.")
    parser.add_argument("--jobs", type=int, default=2, help="Missions at a time.")
    parser.add_argument("--out", type=Path, default=Path("runs") / f"results-{version().split(',')[0]}")
    parser.add_argument("--dry", action="store_true", help="Print the tables only.")
    options = parser.parse_args()
    options.out = options.out.resolve()

    for name in options.tables:
        before = cpu_seconds()
        table = printed(name, options.data, options.out) if name in PRINTED else of_missions(name, options)
        add_hours(options.out, name, cpu_seconds() - before)
        if table is None:
            continue
        print(table, flush=True)
        if not options.dry:
            TABLES.mkdir(exist_ok=True)
            (TABLES / f"{name}.md").write_text(table)
            DOCUMENT.write_text(replaced(DOCUMENT.read_text(), name, table))


if __name__ == "__main__":
    main()
