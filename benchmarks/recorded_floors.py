"""The estimator of this checkout and of an older one on the same recorded missions: landmark error and CPU time.

    python benchmarks/recorded_floors.py FOLDER --against OLDER --world maps/LGRC1.vectormap.txt --seeds 3

Missions that FOLDER does not hold yet are driven first, by the older checkout's explorer (--recorder: another's), and
their ports recorded, with the times at which turns and glances began and ended. Both estimators then get the same
messages and the same turns. A row an estimator and mission goes to FOLDER/rows.jsonl; a second call goes on from there.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parents[1]


def record(world: str, seed: int, out: Path) -> None:
    """Drive one mission and keep, beside its folder's files, when its turns began and ended."""
    from tfg_drake.diagrams.cli import main
    from tfg_drake.systems import slam_estimator as shell

    turns: list[tuple[str, float]] = []

    def noted(name, function):
        def call(state, stamp, **options):
            turns.append((name, stamp))
            return function(state, stamp, **options)

        return call

    shell.begin_turn, shell.end_turn = noted("begin", shell.begin_turn), noted("end", shell.end_turn)
    place = ["--world", world, "--tag-spacing", "1"] if Path(world).exists() else [world]
    sys.argv = ["tfg-drake", "explore", *place, "--seed", str(seed), "--headless", "--max-time", "15000"]
    sys.argv += ["--out", str(out)]
    try:
        main()
    except SystemExit as end:
        if end.code:
            raise
    (out / "turns.json").write_text(json.dumps(turns))


def replay(folder: Path) -> dict[str, float]:
    """A row of the estimator that is imported, on one recorded mission."""
    import numpy as np
    from threadpoolctl import threadpool_limits

    from tfg_drake.comparison import metrics
    from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld
    from tfg_drake.geometry import se2
    from tfg_drake.slam import estimator
    from tfg_drake.slam.estimator_state import initial_state
    from tfg_drake.storage.port_recording import read_recording

    scenario = LoadScenario(filename=folder / "scenario.yaml")
    recording = read_recording(folder)
    turns = iter([*json.loads((folder / "turns.json").read_text()), ("", float("inf"))])
    world = MakeWorld(scenario.world)
    state = initial_state(scenario.odometry, scenario.explorer.path_keyframe_period)
    name, stamp = next(turns)
    taken, slowest = -float("inf"), 0.0
    with threadpool_limits(limits=1):
        began = time.process_time()
        for tick in range(int(recording.end_time * 16) + 1):
            now = tick / 16
            since = time.process_time()
            odometry = recording.at("base.odometry", now)
            detections = recording.at("tags.detections", now)
            state = estimator.process_scan(state, recording.at("scan.ranges", now))
            state = estimator.process_odometry(state, odometry)
            if detections.stamp > taken:
                state, taken = estimator.process_detections(state, detections), detections.stamp
            if odometry.stamp == stamp:
                state = (estimator.begin_turn if name == "begin" else estimator.end_turn)(state, stamp)
                name, stamp = next(turns)
            slowest = max(slowest, time.process_time() - since)
        spent = time.process_time() - began
        estimate = estimator.finished_map(state).map
    row_of = {int(tag): row for row, tag in enumerate(world.tag_ids)}
    known = [i for i, tag in enumerate(estimate.ids.tolist()) if tag in row_of]
    truth = se2.transform(se2.inverse(world.start), world.p_WT[[row_of[int(estimate.ids[i])] for i in known]])
    p_ML = estimate.p_ML[known]
    rows = (2 * np.array(known)[:, None] + [0, 1]).ravel()
    joint = len(estimate.local) == len(estimate.ids)
    nees = metrics.landmark_nees(p_ML, truth, estimate.covariance[np.ix_(rows, rows)]) if joint else float("nan")
    return {
        "landmarks": len(known),
        "rmse": float(metrics.landmark_rmse(p_ML, truth)),
        "aligned": float(metrics.landmark_rmse_aligned(p_ML, truth)),
        "nees": float(nees),
        "cpu": spent,
        "slowest": slowest,
        "duration": recording.end_time,
    }


def in_checkout(checkout: Path, *arguments: str) -> str:
    """The output of this file run with a checkout's code."""
    environment = os.environ | {"PYTHONPATH": str(checkout), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, __file__, *arguments],
        env=environment,
        cwd=checkout,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return done.stdout


def main() -> None:
    """Record what is missing, replay what has no row, print all rows and their ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--against", type=Path, help="the older checkout")
    parser.add_argument("--world", action="append", default=[], help="a map, or a scenario's name")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--recorder", type=Path, help="the checkout whose explorer drives; the older one by default")
    parser.add_argument("--record", nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--replay", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    folder = options.folder.resolve()
    if options.record:
        record(options.record[0], int(options.record[1]), folder)
        return
    if options.replay:
        print("ROW", json.dumps(replay(folder)))
        return

    checkouts = [HERE] + ([options.against.resolve()] if options.against else [])
    missions = []
    for seed in range(options.seeds):
        for world in options.world:
            place = str(Path(world).resolve()) if Path(world).exists() else world
            mission = folder / f"{Path(world).name.split('.')[0]}-{seed}"
            if not (mission / "turns.json").exists():
                in_checkout(options.recorder or checkouts[-1], str(mission), "--record", place, str(seed))
            missions.append(mission)
    kept = folder / "rows.jsonl"
    rows = [json.loads(line) for line in kept.read_text().splitlines()] if kept.exists() else []
    for mission in missions:
        for checkout in checkouts:
            key = {"mission": mission.name, "checkout": str(checkout), "version": _version(checkout)}
            if any(key.items() <= row.items() for row in rows):
                continue
            output = in_checkout(checkout, str(mission), "--replay")
            row = key | json.loads(output.split("ROW", 1)[1])
            rows.append(row)
            with kept.open("a") as file:
                file.write(json.dumps(row) + "\n")
            shown = "  ".join(f"{name} {value:.4g}" for name, value in row.items() if isinstance(value, float))
            print(f"{mission.name}  {checkout.name} {row['version']}  {shown}", flush=True)
    ratios = {name: [] for name in ("rmse", "aligned", "cpu")}
    for mission in missions:
        new, old = (
            [row for row in rows if row["mission"] == mission.name and row["checkout"] == str(one)]
            for one in (checkouts[0], checkouts[-1])
        )
        if new and old and len(checkouts) == 2:
            for name, values in ratios.items():
                values.append(new[-1][name] / old[-1][name])
    for name, values in ratios.items():
        if values:
            print(f"{name}: new / old {sum(values) / len(values):.3f} in the mean, {max(values):.3f} at worst")


def _version(checkout: Path) -> str:
    command = ["git", "-C", str(checkout), "describe", "--always", "--dirty"]
    return subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()


if __name__ == "__main__":
    main()
