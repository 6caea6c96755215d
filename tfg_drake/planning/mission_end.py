"""Why a mission ends where no candidate is worth going to."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tfg_drake.geometry.distance import clearance
from tfg_drake.messages import Roadmap, TfgMap
from tfg_drake.tfg.frontier import PUSH, ROOT

# The robot could drive straight up to the edge of a frontier from a place this near, m.
AT_HAND = 1.0
# Less live frontier than this is not worth a visit, m.
ENOUGH_FRONTIER = 0.24


def given_up_open(tfg: TfgMap, roadmap: Roadmap, need: float) -> float:
    """Length (m) of the frontier that was tried in vain though a robot that needs so much room (m) to every side could
    drive up to it and through.

    What it only ever saw through a crack does not keep the mission from being complete.
    """
    places = roadmap.points[roadmap.enterable]
    before = tfg.given_up + (PUSH + ROOT) * tfg.given_up_normal
    if not len(places) or not len(before):
        return 0.0
    near = cKDTree(places).query_ball_point(before, AT_HAND)
    point = np.repeat(np.arange(len(before)), [len(rows) for rows in near])
    ways = np.hstack([places[np.concatenate([np.array(rows, dtype=np.int64) for rows in near])], before[point]])
    reached = np.unique(point[clearance(ways, tfg.segments, need) >= need])
    through = np.hstack([before, tfg.given_up])[reached]
    return float(tfg.given_up_length[reached[clearance(through, tfg.segments, need) >= need]].sum())


def why_end(
    candidates: bool,
    narrow_gain: float,
    given_up_length: float,
    frontier_length: float,
    cut_off: bool,
    stop_gain: float,
) -> tuple[str, str]:
    """Verdict and reason where no candidate is worth going to.

    candidates: there are any. narrow_gain: nats, of the best place behind a passage that is too narrow for the robot's
    uncertainty. given_up_length: m of open frontier that was tried too often. frontier_length: m of live frontier,
    seen or not: what remains when nothing else does is closed to this robot. cut_off: the robot cannot get back to
    where it began.
    """
    if not candidates:
        return "stuck", "The robot cannot reach any other place."
    if cut_off and frontier_length >= ENOUGH_FRONTIER:
        left = f"{frontier_length:.1f} m of frontier are left"
        return "stuck", f"The robot cannot get back to where it began, and {left}."
    if narrow_gain > stop_gain:
        return "stuck", f"{narrow_gain:.1f} nats lie behind a passage too narrow for the uncertainty of the map."
    if given_up_length > 0.0:
        return "stuck", f"{given_up_length:.1f} m of open frontier were tried again and again in vain."
    but = f" but {frontier_length:.1f} m out of reach or not worth it," if frontier_length >= 0.05 else ""
    return "complete", f"No frontier is left{but} and no place promises more than {stop_gain:g} nats."
