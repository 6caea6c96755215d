"""One run of a comparison as the others of this folder see it, and all of them as a table."""

from __future__ import annotations

import csv
import dataclasses
import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tfg_drake.messages import FloatArray


@dataclasses.dataclass(frozen=True)
class Run:
    """One method on one seed.

    folder: as `tfg-drake explore` leaves it. summary: the contents of its summary.json, None where the run failed, that
    is ended without one. failure: one line that says why, "" otherwise.
    """

    method: str
    seed: int
    folder: Path
    summary: dict[str, Any] | None
    failure: str = ""

    @property
    def outcome(self) -> str:
        """The mission's outcome, "failed" where the run did not get that far."""
        return self.summary["outcome"] if self.summary is not None else "failed"

    @property
    def reason(self) -> str:
        """Why it ended so, one line."""
        return self.summary["reason"] if self.summary is not None else self.failure

    @property
    def counts(self) -> bool:
        """True if its figures are of a mission that went to its end; a fault's are of a part of one."""
        return self.outcome not in ("failed", "fault")


def of_shared_seeds(runs: Sequence[Run], methods: Sequence[str]) -> list[Run]:
    """The runs, also failed ones, of the seeds that all methods with a run have."""
    seeds = [{run.seed for run in runs if run.method == method} for method in methods]
    shared = set.intersection(*filter(None, seeds)) if runs else set()
    return [run for run in runs if run.seed in shared]


def values(runs: Sequence[Run], method: str, read: Callable[[dict[str, Any]], float | None]) -> dict[int, float]:
    """A figure of one method's runs by seed, of the runs that count and have it."""
    found = {run.seed: read(run.summary) for run in runs if run.method == method and run.counts and run.summary}
    return {seed: float(value) for seed, value in sorted(found.items()) if value is not None and np.isfinite(value)}


def sample(runs: Sequence[Run], method: str, read: Callable[[dict[str, Any]], float | None]) -> FloatArray:
    """The same as an array (n,), in the order of the seeds."""
    return np.array(list(values(runs, method, read).values()))


def paired(first: dict[int, float], other: dict[int, float]) -> tuple[FloatArray, FloatArray]:
    """The figures (n,) and (n,) of two methods on the seeds that both have, in the order of the seeds."""
    seeds = sorted(first.keys() & other.keys())
    return np.array([first[seed] for seed in seeds]), np.array([other[seed] for seed in seeds])


def flatten(summary: dict[str, Any]) -> dict[str, Any]:
    """A summary without nesting: {"a": {"b": 1}} becomes {"a.b": 1}."""
    flat: dict[str, Any] = {}
    for key, value in summary.items():
        if isinstance(value, dict):
            flat |= {f"{key}.{name}": item for name, item in flatten(value).items()}
        else:
            flat[key] = value
    return flat


def to_csv(runs: Sequence[Run]) -> str:
    """All runs, a row each under a line of names; empty where a run has no such figure, or none at all."""
    rows = []
    for run in runs:
        flat = flatten(run.summary or {"outcome": run.outcome, "reason": run.reason})
        whose = {"method": run.method, "seed": run.seed}  # first, and the sweep's own words
        rows.append(whose | flat | whose)
    names = list(dict.fromkeys(name for row in sorted(rows, key=len, reverse=True) for name in row))
    text = io.StringIO()
    writer = csv.DictWriter(text, names, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
