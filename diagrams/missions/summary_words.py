"""A run's summary in words, as the closing table on a screen and the figure's title have it."""

from __future__ import annotations

from collections import Counter
from typing import Any

from tfg_drake.percent import percent
from tfg_drake.planning.openings import REACH

# Greatest number of openings, or notes, on a terminal, and of openings on the page: those with the most unknown behind
# them. All are counted.
ON_SCREEN, ON_PAGE = 3, 20


def told(value: float | None, form: str) -> str:
    """Return a number in a format such as "{:.3f} m", "-" if it is unknown."""
    return "-" if value is None else form.format(value)


def _place(p: list[float]) -> str:
    x, y = (round(one, 1) + 0.0 for one in p)  # no -0.0
    return f"({x:.1f}, {y:.1f})"


def map_error(summary: dict[str, Any]) -> str:
    """Return words on the errors of the tags."""
    rmse, aligned = summary["landmark_rmse_m"], summary["landmark_rmse_aligned_m"]
    return f"map error {told(rmse, '{:.3f} m')} RMSE ({told(aligned, '{:.3f} m')} aligned)"


def pose_error(summary: dict[str, Any]) -> tuple[str, str, str]:
    """Return words on the pose errors: of positions, mean and greatest, and of headings, mean."""
    position, heading = summary["position_error_moving_m"] or {}, summary["heading_error_rad"] or {}
    mean, most = told(position.get("mean"), "{:.3f} m"), told(position.get("max"), "{:.3f} m")
    return f"{mean} mean from the first drive on,", f"{most} max;", f"{told(heading.get('mean'), '{:.4f} rad')} mean"


def table_rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """The closing table: name and value, "-" where there is none."""
    mapped, present, walls = (summary[name] for name in ("landmarks_mapped", "landmarks_reachable", "walls_mapped"))
    tags = told(mapped, "{} mapped")
    if mapped is not None and present:
        tags += f" of {present} reachable, {map_error(summary)}"
    if doubtful := summary["landmarks_doubtful"]:
        tags += f"; doubtful: {', '.join(map(str, doubtful))}"
    rows = [
        ("outcome", f"{summary['outcome']}: {summary['reason']}"),
        ("time", f"{summary['sim_time_s']:.1f} s, {told(summary['real_time_factor'], '{:.1f}')} x real time"),
        ("driven", f"{told(summary['distance_m'], '{:.1f} m')}, {summary['stages']} stages"),
    ]
    if mapped or present or doubtful:
        rows.append(("tags", tags))
    elif not walls:
        rows.append(("landmarks", "none mapped" if mapped == 0 else "-"))
    if walls:
        rows.append(("walls", f"{walls} mapped"))
    known, error, coverage, safety = "-", "-", "-", "-"
    if least := summary["least_known"]:
        known = f"known to {least['deviation_m']:.3f} m or better (1 sigma); least at {_place(least['p_WL'])}"
    if (summary["position_error_moving_m"] or {}).get("mean") is not None:
        error = " ".join(pose_error(summary))
    if summary["surface_coverage_5cm"] is not None:
        shares = {"area": summary["area_coverage"], "surface within 5 cm": summary["surface_coverage_5cm"]}
        coverage = ", ".join(
            f"{percent(share):.1f} % of the {what}" for what, share in shares.items() if share is not None
        )
    if summary["contacts"] is not None:
        caused = f"{summary['contacts']} by the robot, {summary['contacts_received']} by others"
        safety = f"contacts: {caused}; least clearance {told(summary['min_clearance_m'], '{:.2f} m')}"
    rows += [("map", known), ("pose error", error), ("coverage", coverage), ("safety", safety)]
    if changes := summary["changes"]:
        rows.append(("known map", _changed(changes)))
    return [*rows, *note_rows(summary.get("notes") or []), *left_open_rows(summary)]


def note_rows(notes: list[dict[str, Any]]) -> list[tuple[str, str]]:
    """The first notes, as rows of a table: a name, or "", and a value."""
    texts = [("" if one["time_s"] is None else f"{one['time_s']:.0f} s: ") + one["text"] for one in notes[:ON_SCREEN]]
    if len(notes) > ON_SCREEN:
        texts.append(f"{len(notes) - ON_SCREEN} more in summary.json")
    return [("" if row else "notes", text) for row, text in enumerate(texts)]


def _changed(changes: dict[str, Any]) -> str:
    from tfg_drake.mapfile import changes as mapfile_changes

    if changes["found_at_s"] is None:
        return "the robot has not found itself in it, and has mapped apart; map merge may join the two"
    return f"the robot found itself at {changes['found_at_s']:.0f} s; changed since: {mapfile_changes.told(changes)}"


def left_open_rows(summary: dict[str, Any], named: int = ON_SCREEN) -> list[tuple[str, str]]:
    """Return rows of a table, a name or "" and a value, on the openings left; named: the number named at most."""
    openings, rooms = summary.get("openings"), summary.get("undiscovered")
    if openings is None or rooms is None:
        return []
    counts = Counter(one["why"] for one in openings)
    rows = [("left open", ", ".join(f"{count} {why}" for why, count in counts.most_common()) or "nothing")]
    for one in openings[:named]:
        behind, why = f"{one['unknown_m2']:.0f} m2 unknown within {REACH:g} m", one["why"]
        if one["missing_m"]:
            why = f"the way there is {why} by {one['missing_m']:.2f} m to either side"
        rows.append(("", f"{one['width_m']:.1f} m wide at {_place(one['p_WO'])}, {behind}: {why}"))
    stated = ", ".join(f"{one['probability']:.2f} of {one['area_m2']:g} m2" for one in rooms)
    return [*rows, ("unseen room", f"probability that there is one to enter, at least so large: {stated}")]


def title(summary: dict[str, Any]) -> str:
    """The title of the run's figure."""
    parts, error = [], ""
    mapped, reachable = summary["landmarks_mapped"], summary["landmarks_reachable"]
    if mapped is not None and reachable:
        parts.append(f"{mapped} of {reachable} tags, {map_error(summary)}")
    elif mapped or summary["walls_mapped"]:
        parts.append(f"{mapped} tags" if mapped else f"{summary['walls_mapped']} walls")
    if (share := summary["surface_coverage_5cm"]) is not None:
        parts.append(f"{percent(share):.1f} % of the surface within 5 cm")
    if summary["contacts"] is not None:
        position, _, heading = pose_error(summary)
        error = f"pose error {position} {heading}"
    ended = f"{summary['outcome'].replace('_', ' ')} after {summary['sim_time_s']:.1f} s"
    return (
        f"{summary['scenario']}, {summary['method']}, seed {summary['seed']}: {ended}, {summary['distance_m']:.1f} m,"
        f" {summary['stages']} stages\n{'; '.join(parts)}\n{error}"
    ).rstrip()
