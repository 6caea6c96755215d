"""What a newcomer sees: how soon the picture moves, how long it stands still, how long nothing is said, at what cost.

    python benchmarks/first_minute.py --out FILE
    python benchmarks/first_minute.py --out FILE --old PATH

Starts `tfg-drake explore paper --realtime-rate 8` from an empty cache of kernels, and from one that the installation's
`python -m tfg_drake.kernels` has filled, and looks on as a browser does. --old: the same for an older checkout at PATH,
whose installation compiled nothing. A row a trial is kept in FILE; what is there is not measured again.

`cpu of it` is what the installation's share costs. All is summed over the processes of a mission; of memory, what they
hold of files counts once, as they share it, and in the last column for each of them.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import re
import resource
import socket
import subprocess
import sys
import tempfile
import threading
import time
from itertools import pairwise
from pathlib import Path

HERE = Path(__file__).parents[1]
MISSION = ["explore", "paper", "--seed", "0", "--realtime-rate", "8", "--max-time", "90"]
# What asks the page's server for the timeline, which comes as it grows.
ASKING = b"GET /timeline?from=0 HTTP/1.0\r\nHost: localhost\r\n\r\n"
# Time between two looks at the memory, s.
SAMPLE = 0.2
COLUMNS = {
    "picture": "first picture, s",
    "stall": "longest stall, s",
    "silence": "longest silence, s",
    "cpu": "mission, CPU s",
    "install_cpu": "cpu of it, CPU s",
    "memory": "memory, MB",
    "every": "each its own, MB",
}


def watch(port: int, times: list[float]) -> None:
    """Notes when something new of the picture arrives, until there is no picture any more."""
    with socket.create_connection(("localhost", port)) as connection:
        connection.sendall(ASKING)
        connection.recv(1 << 20)  # that there will be something
        while connection.recv(1 << 20):
            times.append(time.monotonic())


def tree(pid: int) -> list[int]:
    """A process and those that it has started, and they."""
    found = [pid]
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text().split():
            found += tree(int(child))
    return found


def memory(pid: int) -> tuple[float, float]:
    """MB that a tree of processes holds, files once and for each."""
    own, files = [], []
    for one in tree(pid):
        status = dict(line.split(":", 1) for line in Path(f"/proc/{one}/status").read_text().splitlines())
        if "RssAnon" in status:
            own.append(int(status["RssAnon"].split()[0]) / 1024.0)
            files.append((int(status["RssFile"].split()[0]) + int(status["RssShmem"].split()[0])) / 1024.0)
    return sum(own) + max(files, default=0.0), sum(own) + sum(files)


def cpu() -> float:
    """CPU seconds of all processes that have ended."""
    spent = resource.getrusage(resource.RUSAGE_CHILDREN)
    return spent.ru_utime + spent.ru_stime


def trial(checkout: Path, installed: bool) -> dict[str, float]:
    """One start of the program."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"PYTHONPATH": str(checkout), "NUMBA_CACHE_DIR": f"{folder}/cache"}
        Path(folder, "cache").mkdir()
        before = cpu()
        if installed and (checkout / "tfg_drake" / "kernels.py").exists():
            warm = [sys.executable, "-m", "tfg_drake.kernels"]
            subprocess.run(warm, env=environment, cwd=folder, check=True, stdout=subprocess.DEVNULL)
        install_cpu = cpu() - before
        command = [sys.executable, "-m", "tfg_drake.diagrams.cli", *MISSION, "--out", f"{folder}/run"]
        start = time.monotonic()
        lines, pictures, peak = [start], list[float](), (0.0, 0.0)
        process = subprocess.Popen(command, env=environment, cwd=folder, stdout=subprocess.PIPE, text=True)

        def listen() -> None:
            assert process.stdout is not None
            for line in process.stdout:
                lines.append(time.monotonic())
                if found := re.search(r"page: http://localhost:(\d+)", line):
                    threading.Thread(target=watch, args=(int(found[1]), pictures), daemon=True).start()

        listener = threading.Thread(target=listen)
        listener.start()
        while process.poll() is None:
            with contextlib.suppress(OSError):  # A process has just ended.
                peak = tuple(map(max, peak, memory(process.pid)))
            time.sleep(SAMPLE)
        listener.join()
        lines.append(time.monotonic())
        return {
            "picture": pictures[0] - start,
            # The last one is that of the end, when all is written.
            "stall": max(after - one for one, after in pairwise(pictures[:-1])),
            "silence": max(after - one for one, after in pairwise(lines)),
            "cpu": cpu() - before - install_cpu,
            "install_cpu": install_cpu,
            "memory": peak[0],
            "every": peak[1],
        }


def main() -> None:
    """Measure what is missing, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="where the rows are kept")
    parser.add_argument("--old", type=Path, help="an older checkout")
    parser.add_argument("--trials", type=int, default=1)
    options = parser.parse_args()
    rows = [json.loads(line) for line in options.out.read_text().splitlines()] if options.out.exists() else []
    checkouts = {"new": HERE} | ({"old": options.old.resolve()} if options.old is not None else {})
    for number in range(options.trials):
        for name, checkout in checkouts.items():
            for cache in ("empty", "installed"):
                key = {"version": name, "cache": cache, "trial": number}
                if any(key.items() <= row.items() for row in rows) or (name == "old" and cache == "installed"):
                    continue
                rows.append(key | trial(checkout, cache == "installed"))
                with options.out.open("a") as file:
                    file.write(json.dumps(rows[-1]) + "\n")
    print("".join(f"{word:>18}" for word in ("version", "cache", *COLUMNS.values())))
    for row in rows:
        print(f"{row['version']:>18}{row['cache']:>18}" + "".join(f"{row[column]:18.1f}" for column in COLUMNS))


if __name__ == "__main__":
    main()
