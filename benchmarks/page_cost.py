"""Cost of picture and page: CPU time of a mission, and the shares of timeline and server in it.

    python benchmarks/page_cost.py
    python benchmarks/page_cost.py --world floor.vectormap.txt --tag-spacing 1 --max-time 600

The same mission twice: nobody looks on, and then a page does: a process that reads all that the server tells. A row a
mission: CPU milliseconds a simulated second, of them those that write the timeline and those of the server's threads,
and both together over all the rest. Shares of one run are told, as they hardly depend on what else the machine does.
"""

from __future__ import annotations

import argparse
import contextlib
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from unittest import mock

from pydrake.systems.framework import Context, EventStatus

from tfg_drake.cockpit.server import Cockpit
from tfg_drake.diagrams.missions.run import run_mission, viewer_script
from tfg_drake.diagrams.scenario import ApplyWorldFile, FindScenario, LoadScenario, Scenario
from tfg_drake.systems.timeline_recorder import TimelineRecorder

READER = "import sys, urllib.request as u; r = u.urlopen(sys.argv[1] + 'timeline?from=0')\nwhile r.read1(): pass"


def measured(scenario: Scenario, watched: bool, max_time: float, rate: float) -> tuple[float, float, float]:
    """CPU ms a simulated second: of all, of the timeline, of the server."""
    timeline, write = 0.0, TimelineRecorder._Write

    def timed(recorder: TimelineRecorder, everything: bool, context: Context) -> EventStatus:
        nonlocal timeline
        start = time.thread_time()
        status = write(recorder, everything, context)
        timeline += time.thread_time() - start
        return status

    with contextlib.ExitStack() as stack:
        stack.enter_context(mock.patch.object(TimelineRecorder, "_Write", timed))
        folder, cockpit = Path(stack.enter_context(tempfile.TemporaryDirectory())), None
        if watched:
            cockpit = stack.enter_context(Cockpit(viewer_script(), "mission", rate=rate))
            reader = subprocess.Popen([sys.executable, "-c", READER, cockpit.address.partition("?")[0]])
            stack.callback(reader.wait)
            stack.callback(reader.terminate)
        before, own = time.process_time(), time.thread_time()
        given = {"max_time": max_time, "realtime_rate": rate, "out_dir": folder / "run", "cockpit": cockpit}
        summary = run_mission(scenario, **given).summary
        spent, own = time.process_time() - before, time.thread_time() - own
    each = 1e3 / summary["sim_time_s"]
    return each * spent, each * timeline, each * (spent - own)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="paper")
    parser.add_argument("--world", type=Path)
    parser.add_argument("--tag-spacing", type=float)
    parser.add_argument("--max-time", type=float, default=300.0, help="simulated s")
    parser.add_argument("--rate", type=float, default=0.0, help="speed of the clock, times real time; 0 for no limit")
    options = parser.parse_args()
    scenario = LoadScenario(FindScenario(options.scenario))
    if options.world is not None:
        scenario = ApplyWorldFile(scenario, options.world, options.tag_spacing, None)
    print(f"{'':14}{'all, ms/s':>12}{'timeline':>12}{'server':>12}{'over the rest':>15}")
    for name, watched in (("nobody looks", False), ("with a page", True)):
        spent, timeline, server = measured(scenario, watched, options.max_time, options.rate)
        share = (timeline + server) / (spent - timeline - server)
        print(f"{name:14}{spent:12.1f}{timeline:12.2f}{server:12.2f}{share:15.3f}", flush=True)


if __name__ == "__main__":
    main()
