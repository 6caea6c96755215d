"""How one run of a mission differs from another: the table that a fork is told by."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tfg_drake.percent import percent

# Compared quantities: name, its reader from a summary, its format.
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
