"""The openings that a mission leaves: edges of free space that are no surface, and the rooms that may lie behind."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from tfg_drake.diagrams.missions.mission import Mission
from tfg_drake.geometry.se2 import transform
from tfg_drake.messages import Roadmap
from tfg_drake.planning.mission_end import UNSEEN
from tfg_drake.planning.openings import NOT_WORTH, WHY, find_openings
from tfg_drake.planning.undiscovered import AREAS, undiscovered

# So many openings are named on a screen and on the page, those with the most unknown behind them; all are counted.
ON_SCREEN, ON_PAGE = 3, 20


def left_open(mission: Mission) -> dict[str, Any]:
    """The summary's `openings`, those with the most unknown behind them first, and `undiscovered`; both null for a
    method without a TFG."""
    tfg, pose, roadmap = mission.tfg, mission.pose, None
    if tfg is not None and tfg.stage:
        roadmap = mission.look_for("roadmap", Roadmap)
    if tfg is None or roadmap is None or pose is None:
        return {"openings": None, "undiscovered": None}
    found = find_openings(tfg, roadmap, pose.X_MB[:2], mission.scenario.robot, mission.scenario.view)
    why = [UNSEEN if row == NOT_WORTH and mission.outcome != "complete" else WHY[row] for row in found.why]
    places, missing = transform(mission.X_WM, found.p).round(2), found.missing.round(2)
    openings = [
        {
            "p_WO": places[i].tolist(),
            "width_m": round(float(found.width[i]), 2),
            "why": why[i],
            "missing_m": float(missing[i]) or None,
            "unknown_m2": round(float(found.unknown[i]), 1),
        }
        for i in np.lexsort((-found.width, -found.unknown))
    ]
    probability = undiscovered(found).round(4).tolist()
    rooms = [{"area_m2": area, "probability": p} for area, p in zip(AREAS, probability, strict=True)]
    return {"openings": openings, "undiscovered": rooms}


def left_open_rows(summary: dict[str, Any], named: int = ON_SCREEN) -> list[tuple[str, str]]:
    """The same in words, as rows of a table, a name, or "", and a value; so many openings are named."""
    openings, rooms = summary.get("openings"), summary.get("undiscovered")
    if openings is None or rooms is None:
        return []
    counts = Counter(one["why"] for one in openings)
    rows = [("left open", ", ".join(f"{count} {why}" for why, count in counts.most_common()) or "nothing")]
    for one in openings[:named]:
        (x, y), lacks = one["p_WO"], f" by {one['missing_m']:.2f} m to either side" if one["missing_m"] else ""
        behind = f"{one['unknown_m2']:.0f} m2 unknown behind"
        rows.append(("", f"{one['width_m']:.1f} m wide at ({x:.1f}, {y:.1f}), {behind}: {one['why']}{lacks}"))
    stated = ", ".join(f"{one['probability']:.2f} of {one['area_m2']:g} m2" for one in rooms)
    return [*rows, ("unseen room", f"probability that there is one to enter, at least so large: {stated}")]
