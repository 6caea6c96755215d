"""Forks that change nothing, at many stages of a mission: does each end as the original, to the bit?

python benchmarks/forks.py house --stages 20
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

import tfg_drake
from tfg_drake.diagrams.explorer import MapOfExplorer, StateOfExplorer
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import LoadScenario, MapFrame
from tfg_drake.mapfile.saved_map import save_map
from tfg_drake.messages import MissionStatus
from tfg_drake.slam.estimator import finished_map


def fork_is_same(folder: Path, stage: int, scratch: Path) -> bool:
    """Whether a fork of a run at a stage comes to the same end at the same time with the same map and true pose."""
    run = tfg_drake.load_run(folder)
    simulator = tfg_drake.fork(run, stage)
    diagram, root = simulator.get_system(), simulator.get_context()
    station, explorer = (diagram.GetSubsystemByName(name) for name in ("station", "explorer"))
    context = explorer.GetMyContextFromRoot(root)

    def status() -> MissionStatus:
        return explorer.GetOutputPort("mission").Eval(context)

    while status().phase != "done":
        simulator.AdvanceTo(np.floor(root.get_time()) + 1.0)
    state = finished_map(StateOfExplorer(explorer, context))
    scenario = LoadScenario(folder / "scenario.yaml")
    X_WS = np.array(scenario.world.start)
    save_map(scratch, MapOfExplorer(explorer, context, MapFrame(scenario, X_WS), state, scenario)[0])
    pose = station.GetOutputPort("truth.pose").Eval(station.GetMyContextFromRoot(root))[:3]
    return (
        scratch.read_bytes() == (folder / "map.npz").read_bytes()
        and (status().outcome, status().since) == (run.summary["outcome"], run.summary["sim_time_s"])
        and bool(np.hypot(*(pose[:2] - run.X_WB_true[-1, :2])) < 1e-8)  # as the text file of the run has it
    )


def main() -> None:
    """Explore once, then fork."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="house")
    parser.add_argument("--stages", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    scenario = LoadScenario(options.scenario)
    scenario.seed = options.seed
    with tempfile.TemporaryDirectory() as scratch:
        original = run_mission(scenario, out_dir=Path(scratch) / "run", record=False)
        last = original.summary["stages"]
        print(f"{options.scenario}: {original.summary['outcome']} after {last} stages", flush=True)
        same = 0
        stages = np.unique(np.linspace(1, last, options.stages).round().astype(int)).tolist()
        for stage in stages:
            equal = fork_is_same(original.folder, stage, Path(scratch) / "map.npz")
            same += equal
            print(f"stage {stage:3d}: {'the same' if equal else 'different'}", flush=True)
    print(f"{same} of {len(stages)} forks end as the original, to the bit")


if __name__ == "__main__":
    main()
