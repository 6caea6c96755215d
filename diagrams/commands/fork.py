"""`tfg-drake fork`: a run's other future, and how it differs from the one that was."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from tfg_drake.percent import percent

if TYPE_CHECKING:
    from tfg_drake.diagrams.missions.fork import Candidate

# So many candidates of the stage are shown.
SHOWN = 5

# What is compared: name, how to read it of a summary, its format.
_ROWS: tuple[tuple[str, Callable[[dict[str, Any]], Any], str], ...] = (
    ("time", lambda s: s["sim_time_s"], "{:.1f} s"),
    ("driven", lambda s: s["distance_m"], "{:.1f} m"),
    ("stages", lambda s: s["stages"], "{:.0f}"),
    ("position error", lambda s: s.get("position_error_moving_m", {}).get("mean"), "{:.4f} m"),
    ("heading error", lambda s: s["heading_error_rad"]["mean"], "{:.5f} rad"),
    ("map error", lambda s: s["landmark_rmse_m"], "{:.4f} m RMSE"),
    ("tags mapped", lambda s: s["landmarks_mapped"] if s.get("landmarks_reachable") else None, "{:.0f}"),
    ("walls mapped", lambda s: s.get("walls_mapped") or None, "{:.0f}"),
    ("surface within 5 cm", lambda s: _percent(s.get("surface_coverage_5cm")), "{:.2f} %"),
    ("area seen", lambda s: _percent(s["area_coverage"]), "{:.2f} %"),
    ("entropy", lambda s: s["landmark_entropy_nats"], "{:.1f} nats"),
)


def _percent(share: float | None) -> float | None:
    return None if share is None else percent(share, 2)


def difference_rows(before: dict[str, Any], after: dict[str, Any]) -> list[tuple[str, str, str, str]]:
    """Name, the run's value, the fork's and their difference, of all that both summaries have."""
    rows = [("", "run", "fork", "difference"), ("outcome", before["outcome"], after["outcome"], "")]
    for name, read, form in _ROWS:
        one, other = read(before), read(after)
        if one is not None and other is not None:
            unit = form.partition("}")
            difference = f"{unit[0].replace(':', ':+')}}}{unit[2]}".format(other - one) if other != one else "="
            rows.append((name, form.format(one), form.format(other), difference))
    return rows


def candidate_rows(candidates: Sequence[Candidate]) -> list[tuple[str, ...]]:
    """The stage's best candidates and the one that was chosen: number, place, gain and what it is made of (of known
    landmarks, of new ones, the price of the pose), nats, time to get there."""
    rows: list[tuple[str, ...]] = [("candidate", "x m", "y m", "gain", "known", "new", "price", "time s", "")]
    for number, one in enumerate(candidates, start=1):
        if number > SHOWN and not one.chosen:
            continue
        x, y = one.p_WG
        numbers = (one.gain, one.exploitation, one.exploration, one.pose_price, one.time)
        cells = [f"{value:.1f}" if math.isfinite(value) else "-" for value in numbers]
        rows.append((str(number), f"{x:.2f}", f"{y:.2f}", *cells, "chosen" if one.chosen else ""))
    return rows


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table: the first column to the left, numbers to the right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        "  ".join(
            [row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))]
        ).rstrip()
        for row in rows
    ]
