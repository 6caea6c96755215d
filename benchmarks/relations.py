"""SLAM on raw laser logs, by relations between poses that were checked by hand (see `datasets/relations.py`).

    python benchmarks/relations.py DATA --out relations.jsonl --methods walls,grid,karto --logs aces,intel,fr079

DATA holds Radish's logs NAME.clf.bz2 and beside them NAME.relations.gz. A row a log and method goes to the file as soon
as it is there, and those that are in it are not run again; at the end all of them are printed: mean and standard
deviation of the errors, m and degrees, and CPU time, s.

walls and grid are `tfg-drake slam LOG --relations FILE`, in a process of its own. karto is OpenKarto's matcher and
loops as the packages karto-scanmatcher and yag-slam have them, which are no part of the project:

    pip install karto-scanmatcher==1.0.0 yag-slam==0.3.0

It gets the same odometry, and its settings are those of eight that were best on aces by these relations.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import math
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from tfg_drake.datasets.recording import Recording
from tfg_drake.datasets.relations import read_relations, relation_errors
from tfg_drake.geometry import se2
from tfg_drake.hardware.recordings import load_dataset
from tfg_drake.messages import FloatArray, LaserScan
from tfg_drake.slam.shared import SCANNER_X, SCANNER_Y

LOGS = ("aces", "intel", "fr079")
METHODS = ("walls", "grid", "karto")
# Published errors, m and degrees: Hess et al., ICRA 2016, and Kuemmerle et al., Autonomous Robots 2009.
PUBLISHED = {
    "Cartographer": {"aces": "0.0375 0.373", "intel": "0.0229 0.453", "fr079": "0.0452 0.538"},
    "Graph Mapping": {"aces": "0.044 0.4", "intel": "0.031 1.3", "fr079": "0.056 0.6"},
    "Graph FLIRT": {"intel": "0.02 0.3", "fr079": "0.06 0.8"},
    "GMapping": {"aces": "0.060", "intel": "0.070", "fr079": "0.061"},
}
# Karto: a node every NODE_STEP, m, or NODE_TURN, rad. BUFFER: number of scans to match with. LOOP_DISTANCE: radius of
# the loop search, m. LOOP_RESPONSE: least response of a loop. KARTO_RANGE: longest ray used, m.
NODE_STEP, NODE_TURN = 0.2, 0.1
BUFFER, LOOP_DISTANCE, LOOP_RESPONSE = 30, 8.0, 0.6
KARTO_RANGE = 12.0


def by_command(log: Path, relations: Path, method: str) -> dict[str, Any]:
    """The summary of `tfg-drake slam`."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "tfg_drake.diagrams.cli", "slam", str(log), "--method", method]
        options = ["--relations", str(relations), "--out", folder]
        subprocess.run([*command, *options], check=True, stdout=subprocess.DEVNULL)
        summary = json.loads((Path(folder) / "summary.json").read_text(encoding="utf-8"))
    return {**summary["relations"], "cpu_time_s": summary["cpu_time_s"]}


def by_karto(log: Recording) -> FloatArray:
    """The scanner (n, 3) at all scans: Karto's nodes, and between them by odometry."""
    from yag_slam.graph_slam import GraphSlam
    from yag_slam.models import LocalizedRangeScan
    from yag_slam.scan_matching import Scan2DMatcherCpp

    X_BS = np.array([log.prior.mean[SCANNER_X], log.prior.mean[SCANNER_Y], 0.0])
    X_OS = se2.compose(np.array([one.X_OB for one in log.odometry]), X_BS)
    # Without verbose it takes loops whose fine response is too low.
    slam = GraphSlam(
        Scan2DMatcherCpp({}),
        Scan2DMatcherCpp({}, loop=True),
        scan_buffer_len=BUFFER,
        loop_search_dist=LOOP_DISTANCE,
        min_response_fine=LOOP_RESPONSE,
        verbose=True,
    )
    step = min(float(np.diff(scan.angles).min()) for scan in log.scans if len(scan.angles) > 1)
    first = min(float(scan.angles[0]) for scan in log.scans if len(scan.angles))
    last = max(float(scan.angles[-1]) for scan in log.scans if len(scan.angles))
    nodes: list[int] = []
    of_node = np.zeros(len(log.scans), dtype=np.int64)
    for k, scan in enumerate(log.scans):
        moved = se2.between(X_OS[nodes[-1]], X_OS[k]) if nodes else np.full(3, math.inf)
        if math.hypot(moved[0], moved[1]) >= NODE_STEP or abs(moved[2]) >= NODE_TURN:
            ranges = _all_rays(scan, first, step, round((last - first) / step) + 1)
            node = LocalizedRangeScan(ranges, first, last, step, 0.1, 80.0, KARTO_RANGE, *X_OS[k].tolist())
            with contextlib.redirect_stdout(None):
                slam.process_scan(node)
            nodes.append(k)
        of_node[k] = len(nodes) - 1
    poses = [vertex.obj.corrected_pose for vertex in slam.graph.vertices]
    X_WN = np.array([(pose.x, pose.y, pose.euler[-1]) for pose in poses])
    return np.asarray(se2.compose(X_WN[of_node], se2.between(X_OS[np.array(nodes)[of_node]], X_OS)))


def _all_rays(scan: LaserScan, first: float, step: float, count: int) -> list[float]:
    """Ranges of rays at equal angles, 0 where there was no return."""
    ranges = np.zeros(count)
    ranges[np.round((scan.angles - first) / step).astype(int)] = np.where(np.isfinite(scan.ranges), scan.ranges, 0.0)
    return ranges.tolist()


def row(data: Path, name: str, method: str) -> dict[str, Any]:
    """The errors of a method on a log."""
    path, relations = data / f"{name}.clf.bz2", data / f"{name}.relations.gz"
    if method != "karto":
        return by_command(path, relations, method)
    log = load_dataset(path)
    assert isinstance(log, Recording)
    start = time.process_time()
    X_WS = by_karto(log)
    cpu = time.process_time() - start
    stamps = np.array([scan.stamp for scan in log.scans])
    return {**relation_errors(stamps, X_WS, read_relations(relations), log.told_stamps), "cpu_time_s": cpu}


def table(rows: list[dict[str, Any]]) -> str:
    """All rows, one a line, beside what is published."""
    others = "".join(f"{name:>16}" for name in PUBLISHED)
    lines = [f"{'log':<8}{'method':<8}{'relations':>10}{'m':>18}{'degrees':>18}{'CPU s':>8}{others}"]
    for one in rows:
        metres, degrees = (f"{one[of]['mean']:.4f} +- {one[of]['std']:.4f}" for of in ("translation_m", "rotation_deg"))
        lines.append(
            f"{one['log']:<8}{one['method']:<8}{one['count']:>10}{metres:>18}{degrees:>18}{one['cpu_time_s']:>8.0f}"
            + "".join(f"{told.get(one['log'], ''):>16}" for told in PUBLISHED.values())
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    parser.add_argument("--out", type=Path, default=Path("relations.jsonl"))
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--logs", default=",".join(LOGS))
    options = parser.parse_args()
    text = options.out.read_text(encoding="utf-8") if options.out.is_file() else ""
    rows = [json.loads(line) for line in text.splitlines()]
    done = {(one["log"], one["method"]) for one in rows}
    for name in options.logs.split(","):
        for method in options.methods.split(","):
            if (name, method) in done:
                continue
            rows.append({"log": name, "method": method, **row(options.data, name, method)})
            with options.out.open("a", encoding="utf-8") as file:
                file.write(json.dumps(rows[-1]) + "\n")
    print("\n" + table(rows))


if __name__ == "__main__":
    main()
