"""Faults that a user can mend, in one line: the commands print it and end with exit code 2."""

# A greater angle, rad, was probably meant in degrees.
_TURN = 6.293


class BadInput(Exception):
    """The user's input cannot be used; the message is one line that names the culprit and the mend."""


class EstimateLost(Exception):
    """The estimate is no longer finite, or cannot be solved for; the message is one line that says since when. What was
    mapped before is kept."""


def not_radians(angle: float) -> str:
    """The complaint about an angle that is more than a turn in rad, so probably in degrees; "" where it is none."""
    return f"{angle:g} rad is more than a turn; write radians, not degrees" if abs(angle) > _TURN else ""
