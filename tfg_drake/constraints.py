"""Constraints of a scenario's values, beside their types in `config.py`: `Annotated[float, Bounds(0.0, 5.0)]`.

Each has fault(value): the complaint about a value that breaks it, "" where it holds. A number without any is not
negative, a whole number between 0 and MOST.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Any, NamedTuple

from tfg_drake.bad_input import not_radians

# The greatest whole number anywhere.
MOST = 2**31 - 1


class Bounds(NamedTuple):
    """A number's least value, where 0 itself is excluded, and its greatest."""

    least: float = -math.inf
    most: float = math.inf

    def fault(self, value: float) -> str:
        """The complaint about a value, "" for none."""
        if value < self.least or value == self.least == 0.0:
            relation = "greater than 0" if self.least == 0.0 else f"at least {self.least:g}"
        elif value > self.most:
            relation = f"at most {self.most:.6g}"
        else:
            return ""
        return f"must be {relation}, is {value:g}"


class NotNegative:
    """A number that is 0 or more."""

    def fault(self, value: float) -> str:
        """The complaint about a value, "" for none."""
        return f"must not be negative, is {value:g}" if value < 0.0 else ""


class Whole:
    """A whole number between 0 and MOST."""

    def fault(self, value: int) -> str:
        """The complaint about a value, "" for none."""
        return "" if 0 <= value <= MOST else f"must be between 0 and {MOST}, is {value}"


class Radians:
    """An angle of at most a turn, either way; rad."""

    def fault(self, value: float) -> str:
        """The complaint about a value, "" for none."""
        return not_radians(value)


class OneOf(NamedTuple):
    """A text that is one of a few."""

    names: tuple[str, ...]

    def fault(self, value: str) -> str:
        """The complaint about a value, "" for none."""
        return "" if value in self.names else f"must be one of {', '.join(self.names)}, is {value}"


class Numbers(NamedTuple):
    """A list of as many numbers as its form names, such as "[x, y]"; one that begins with "[] or" may be empty."""

    form: str

    def fault(self, value: Sequence[float]) -> str:
        """The complaint about a value, "" for none."""
        length = self.form.count(",") + 1
        if len(value) == length or (not value and self.form.startswith("[] or")):
            return ""
        return f"expected {length} numbers {self.form}, found {len(value)}"


# Default constraints of a number by its type.
USUAL: dict[type, tuple[Any, ...]] = {float: (NotNegative(),), int: (Whole(),)}

Signed = Annotated[float, Bounds()]
Positive = Annotated[float, Bounds(0.0)]
Share = Annotated[float, NotNegative(), Bounds(most=1.0)]
Angle = Annotated[float, Radians()]
AtLeastOne = Annotated[int, Whole(), Bounds(1.0)]
Point = Annotated[list[Signed], Numbers("[x, y]")]
Segment = Annotated[list[Signed], Numbers("[x0, y0, x1, y1]")]
Pose = Annotated[list[Signed], Numbers("[x, y, yaw]")]
KnownPose = Annotated[list[Signed], Numbers("[] or [x, y, yaw, deviation in m, in rad]")]
