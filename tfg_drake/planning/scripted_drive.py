"""A predefined drive, place by place, such as that of the paper's human operator."""

from __future__ import annotations

import numpy as np

from tfg_drake.messages import FloatArray, GoalChoice, Path, TfgMap, replace
from tfg_drake.planning.goal_choice import empty_choice
from tfg_drake.planning.path import PATH_STEP, resample


def next_place(drive: FloatArray, stage: int, tfg: TfgMap) -> GoalChoice:
    """Return the goal of a stage: place number stage - 1 of the drive (n, 2), m in M, or the end with the map's
    verdict.

    The driver intended to see everything; open frontiers show that something was missed.
    """
    if stage <= len(drive):
        reason = f"Place {stage} of {len(drive)} of the drive is next."
        return replace(empty_choice(), stage=stage, node=stage - 1, p_MG=drive[stage - 1], reason=reason)
    return end_of_drive(stage, tfg)


def end_of_drive(stage: int, tfg: TfgMap) -> GoalChoice:
    """Return the goal of a stage after the drive: none, with the completeness according to the map."""
    left = float(tfg.frontier_length.sum())
    verdict = "complete" if left == 0.0 else "stuck"
    reason = (
        "The drive is over and no frontier is left."
        if left == 0.0
        else (f"The drive is over and {left:.1f} m of frontier are open.")
    )
    return replace(empty_choice(), stage=stage, verdict=verdict, reason=reason)


def straight_path(path_id: int, stage: int, X_MB: FloatArray, p_MG: FloatArray) -> Path:
    """Return the straight path from the robot X_MB (3,) to a place (2,), m in M."""
    return Path(path_id, stage, resample(np.stack([X_MB[:2], p_MG]), PATH_STEP))
