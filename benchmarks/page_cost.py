"""What the picture costs the explorer: CPU time of missions with an open page, recorded without one, and not recorded.

    python benchmarks/page_cost.py
    python benchmarks/page_cost.py --world floor.vectormap.txt --tag-spacing 1 --max-time 600 --rate 1

The same mission three ways, one after the other, --repeat times. A row a way: CPU milliseconds of the mission's program
a simulated second, least of all repetitions, and the ratio to a mission that is not recorded. What looks at the page
reads all that the server tells, in a process of its own. Recording is all of it: timeline, ports and map on the disk.
"""

from __future__ import annotations

import argparse
import contextlib
import subprocess
import sys
import tempfile
from pathlib import Path

from tfg_drake.cockpit.server import Cockpit
from tfg_drake.diagrams.missions.run import explore, viewer_script
from tfg_drake.diagrams.scenario import ApplyWorldFile, FindScenario, LoadScenario, Scenario

READER = "import sys, urllib.request as u; r = u.urlopen(sys.argv[1] + 'timeline?from=0')\nwhile r.read1(): pass"
WAYS = ("not recorded", "recorded", "with a page")


def spent(scenario: Scenario, way: str, max_time: float, rate: float) -> float:
    """CPU ms a simulated second."""
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        cockpit = None
        if way == "with a page":
            cockpit = stack.enter_context(Cockpit(viewer_script(), "mission", rate=rate))
            reader = subprocess.Popen([sys.executable, "-c", READER, cockpit.address.partition("?")[0]])
            stack.callback(reader.wait)
            stack.callback(reader.terminate)
        given = {"max_time": max_time, "realtime_rate": rate, "out_dir": Path(folder) / "run"}
        summary = explore(scenario, cockpit=cockpit, record=way != "not recorded", **given).summary
    return 1e3 * float(summary["cpu_time_s"] / summary["sim_time_s"])


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="paper")
    parser.add_argument("--world", type=Path)
    parser.add_argument("--tag-spacing", type=float)
    parser.add_argument("--max-time", type=float, default=300.0, help="simulated s")
    parser.add_argument("--rate", type=float, default=8.0, help="speed of the clock, times real time; 0 for no limit")
    parser.add_argument("--repeat", type=int, default=3)
    options = parser.parse_args()
    scenario = LoadScenario(FindScenario(options.scenario))
    if options.world is not None:
        scenario = ApplyWorldFile(scenario, options.world, options.tag_spacing, None)
    explore(scenario, max_time=40.0, record=False, out_dir=Path(tempfile.mkdtemp()) / "run")  # Kernels are loaded.
    figures: dict[str, list[float]] = {way: [] for way in WAYS}
    for _ in range(options.repeat):
        for way in WAYS:
            figures[way].append(spent(scenario, way, options.max_time, options.rate))
            print(f"{way:<14}{figures[way][-1]:8.1f} ms a simulated s", file=sys.stderr, flush=True)
    for way in WAYS:
        print(f"{way:<14}{min(figures[way]):8.1f} ms a simulated s{min(figures[way]) / min(figures[WAYS[0]]):7.3f}")


if __name__ == "__main__":
    main()
