"""Makes the recorded mission anew that the page plays while the kernels compile: tfg_drake/cockpit/recorded.tfg.

    python benchmarks/recorded_mission.py

Of the mission's timeline it leaves out the end's card, and every other scan and pose, which halves the file: the page
draws the robot in between.
"""

from __future__ import annotations

import argparse
import collections
import struct
import tempfile
import zlib
from pathlib import Path

from timelines import read_timeline

from tfg_drake.cockpit.page import RECORDED
from tfg_drake.diagrams.missions.run import run_mission
from tfg_drake.diagrams.scenario import LoadScenario
from tfg_drake.io.files import write_atomic
from tfg_drake.storage.timeline import MAGIC, encoded

SCENARIO, SEED = "house", 3
# One of every n records of these layers is kept; of the others all are.
KEPT = {"scan": 2, "pose": 2, "truth": 2}


def thinned(timeline: Path) -> bytes:
    """A timeline's file with fewer records in one block, packed as small as zlib can."""
    seen: collections.Counter[str] = collections.Counter()
    records = []
    for record in read_timeline(timeline, whole=False):
        if record.layer != "end" and seen[record.layer] % KEPT.get(record.layer, 1) == 0:
            records.append(encoded(record.layer, record.time, record.arrays, record.told))
        seen[record.layer] += 1
    block = zlib.compress(b"".join(records), 9)
    return MAGIC + struct.pack("<I", len(block)) + block


def main() -> None:
    """Run the mission and write the file."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    scenario = LoadScenario(SCENARIO)
    scenario.seed = SEED
    with tempfile.TemporaryDirectory() as folder:
        run = run_mission(scenario, name=f"recorded: {SCENARIO}", out_dir=Path(folder))
        data = thinned(run.folder)
    write_atomic(RECORDED, data)
    print(f"{RECORDED}: {len(data) / 1e3:.0f} kB, {run.summary['sim_time_s']:.0f} s, {run.summary['outcome']}")


if __name__ == "__main__":
    main()
