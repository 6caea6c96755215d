"""A sweep's missions on a Ray cluster: each in a process of its own, its folder brought back to where it was started.

The machines share no disk: a run's folder comes back as an archive. They need the same version of tfg_drake, and for
the same bits the same locked versions and model of CPU.
"""

from __future__ import annotations

import io
import logging
import os
import shutil
import signal
import socket
import tempfile
import threading
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from tfg_drake import __version__
from tfg_drake.comparison.runs import Run
from tfg_drake.diagrams.missions.mission import MissionRequest
from tfg_drake.diagrams.missions.sweep import POLL, SweepError, attempt, folder_of, run_of
from tfg_drake.io.extras import pip_install

# Number of new attempts at a mission whose worker or machine died.
RETRIES = 3
# Time to wait for a cluster's answer, s.
_PATIENCE = 5.0


def run_on_ray(tasks: Sequence[MissionRequest], out: Path, address: str, interrupted: threading.Event) -> Iterator[Run]:
    """Run the tasks on a cluster and yield each as it ends, as `sweep.run_local` does.

    address: "local" starts a cluster on this machine, one mission a core; anything else is a cluster's to join, such as
    "auto" or "head:6379". Raises SweepError without Ray or where there is no such cluster.
    """
    ray = connect(address)
    try:
        mission = ray.remote(num_cpus=1, max_calls=1, max_retries=RETRIES)(_mission)
        running = {mission.remote(task, __version__): task for task in tasks}
        while running and not interrupted.is_set():
            done, _ = ray.wait(list(running), num_returns=1, timeout=POLL)
            for reference in done:
                task = running.pop(reference)
                try:
                    archive, summary, failure = ray.get(reference)
                except ray.exceptions.RayError as error:
                    summary, failure = None, " ".join(f"{type(error).__name__}: {error}".split())[:200]
                else:
                    if archive:
                        _unpack(archive, folder_of(task, out))
                yield run_of(task, out, summary, failure)
        for reference in running:
            ray.cancel(reference, force=True)
    finally:
        ray.shutdown()


def connect(address: str) -> Any:
    """The module ray, connected to a cluster; raises SweepError."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # Ray reports no usage.
    logging.getLogger("ray").setLevel(logging.ERROR)
    try:
        import ray
    except ImportError:
        raise SweepError(f"--ray: Ray is not installed; {pip_install('ray')}") from None
    handler = signal.getsignal(signal.SIGTERM)
    try:
        _knock(address)
        dashboard = False if address == "local" else None
        ray.init(address=address, include_dashboard=dashboard, log_to_driver=False, logging_level=logging.ERROR)
    except (OSError, ValueError, RuntimeError) as error:
        reason = " ".join(str(error).split()).split(". ")[0]
        raise SweepError(f"--ray {address}: no cluster there ({reason}); start one with ray start --head") from None
    finally:
        signal.signal(signal.SIGTERM, handler)  # Ray's handler would end this process without a report.
    return ray


def _knock(address: str) -> None:
    """Raises OSError or ValueError where nobody listens at an address HOST:PORT; Ray itself would try for minutes."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if colon:
        socket.create_connection((host, int(port)), timeout=_PATIENCE).close()


def _mission(task: MissionRequest, version: str) -> tuple[bytes, dict[str, Any] | None, str]:
    """In a worker: one task. Its folder as an archive, its summary, its failure."""
    if version != __version__:
        return b"", None, f"a worker has tfg_drake {__version__}, not {version}; install the same on all"
    with tempfile.TemporaryDirectory(prefix="tfg-drake-") as folder:
        summary, failure = attempt(task, Path(folder))
        return _pack(Path(folder)), summary, failure


def _pack(folder: Path) -> bytes:
    """The files of a run's folder as a zip archive."""
    with tempfile.TemporaryDirectory(prefix="tfg-drake-") as beside:
        return Path(shutil.make_archive(f"{beside}/run", "zip", folder)).read_bytes()


def _unpack(archive: bytes, folder: Path) -> None:
    """The folder as it was packed, in place of what is there: whole or not at all."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}.") as beside:
        unpacked = Path(beside, folder.name)
        zipfile.ZipFile(io.BytesIO(archive)).extractall(unpacked)
        shutil.rmtree(folder, ignore_errors=True)
        unpacked.replace(folder)
