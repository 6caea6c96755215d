"""A drive that somebody else has thought out, place by place: the paper's human operator."""

from __future__ import annotations

import numpy as np

from tfg_drake.messages import FloatArray, GoalChoice, Path, TfgMap, replace
from tfg_drake.planning.goal_choice import empty_choice
from tfg_drake.planning.path import PATH_STEP, resample


def next_place(drive: FloatArray, stage: int, tfg: TfgMap) -> GoalChoice:
    """The goal of a stage: place number stage - 1 of the drive (n, 2), m in M, or the end, by the map's own account.

    Whoever drove thought to have seen everything; where the map has open frontiers left, it was not so.
    """
    if stage <= len(drive):
        reason = f"Place {stage} of {len(drive)} of the drive is next."
        return replace(empty_choice(), stage=stage, node=stage - 1, p_MG=drive[stage - 1], reason=reason)
    return end_of_drive(stage, tfg)


def end_of_drive(stage: int, tfg: TfgMap) -> GoalChoice:
    """The goal of a stage when the drive is over: none, and how complete the map is by its own account."""
    left = float(tfg.frontier_length.sum())
    verdict = "complete" if left == 0.0 else "stuck"
    reason = (
        "The drive is over and no frontier is left."
        if left == 0.0
        else (f"The drive is over and {left:.1f} m of frontier are open.")
    )
    return replace(empty_choice(), stage=stage, verdict=verdict, reason=reason)


def straight_path(path_id: int, stage: int, X_MB: FloatArray, p_MG: FloatArray) -> Path:
    """The straight way from the robot X_MB (3,) to a place (2,), m in M."""
    return Path(path_id, stage, resample(np.stack([X_MB[:2], p_MG]), PATH_STEP))
