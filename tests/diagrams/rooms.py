"""Rooms of 6 x 4 m that tests explore, and what a machine's speed and load may change of a run."""

from tfg_drake.diagrams.scenario import ApplyWorldFile, LoadScenario

ROOM = """
seed: 3
world:
  start: [2, 1.5, 0.3]
  walls: [[0, 0, 6, 0], [6, 0, 6, 4], [6, 4, 0, 4], [0, 4, 0, 0]]
"""
# With a wall that leaves a passage.
DIVIDED = ROOM.replace("[0, 4, 0, 0]]", "[0, 4, 0, 0], [3, 2.2, 3, 4]]")
# Shorter first looks than there is time for.
SHORT_LOOK = "explorer: {first_look: 8, first_turns: 3}\n"
QUICK_LOOK = "explorer: {first_look: 2, first_turns: 1}\n"

# Three rooms in a row.
ROOMS = """
seed: 3
world:
  start: [2, 1.5, 0.3]
  walls: [[0, 0, 9, 0], [9, 0, 9, 4], [9, 4, 0, 4], [0, 4, 0, 0], [3, 2.2, 3, 4], [6, 0, 6, 2.6]]
explorer: {first_look: 2, first_turns: 1}
"""

MACHINE = {"wall_time_s", "cpu_time_s", "real_time_factor", "estimator_cpu_s", "planner_cpu_s", "simulator_cpu_s"}
MACHINE |= {"peak_rss_bytes", "stage_ms"}


def tagged(text):
    """The scenario of a YAML text, with a tag every metre."""
    return ApplyWorldFile(LoadScenario(data=text), tag_spacing=1.0)


def room():
    """The divided room, after a quick look: mapped within 21 s by five views, the first at 7.625 s."""
    return tagged(DIVIDED + QUICK_LOOK)


def lasting(summary):
    """What one seed gives again on any machine."""
    return {key: value for key, value in summary.items() if key not in MACHINE}
