"""Parsed YAML becomes dataclasses, by annotations and the constraints in them."""

import dataclasses
from typing import Annotated, ClassVar

import pytest

from tfg_drake import config
from tfg_drake.constraints import Bounds, Numbers, OneOf, Radians, Share, Whole
from tfg_drake.typed_tree import Misfit, read


@dataclasses.dataclass
class Wheel:
    example: ClassVar[str] = "a wheel as {radius: 0.1}, m"

    radius: Annotated[float, Bounds(0.0, 0.5)]
    kind: Annotated[str, OneOf(("rubber", "steel"))] = "rubber"
    grip: Share | None = None


@dataclasses.dataclass
class Cart:
    count: Annotated[int, Whole(), Bounds(1.0)] = 4
    load: float = 0.0
    turned: Annotated[float, Radians()] = 0.0
    corners: list[Annotated[list[float], Numbers("[x, y]")]] = dataclasses.field(default_factory=list)
    wheels: list[Wheel] = dataclasses.field(default_factory=list)
    spare: Wheel = dataclasses.field(default_factory=lambda: Wheel(0.2))


def test_keys_are_merged_lists_replaced_and_whole_numbers_made_numbers():
    before = Cart(count=3, corners=[[1.0, 2.0]], spare=Wheel(0.3, "steel"))
    cart = read({"load": 2, "corners": [[0, 1], [2, 3]], "spare": {"grip": 1}}, Cart, default=before)
    assert cart == Cart(count=3, load=2.0, corners=[[0.0, 1.0], [2.0, 3.0]], spare=Wheel(0.3, "steel", 1.0))
    assert isinstance(cart.load, float)
    assert before.corners == [[1.0, 2.0]]
    assert read({"wheels": [{"radius": 0.1, "grip": None}]}, Cart) == Cart(wheels=[Wheel(0.1)])


@pytest.mark.parametrize(
    ("tree", "told"),
    [
        ([], ": expected a section of keys, found a list"),
        ({"count": 0}, "count: must be at least 1, is 0"),
        ({"count": True}, "count: expected a whole number, found a yes/no value (True)"),
        ({"load": -1}, "load: must not be negative, is -1"),
        ({"turned": 7}, "turned: 7 rad is more than a turn; write radians, not degrees"),
        ({"corners": [[0, 1], [2]]}, "corners[1]: expected 2 numbers [x, y], found 1"),
        ({"spare": {"radius": 0.6}}, "spare.radius: must be at most 0.5, is 0.6"),
        ({"spare": {"grip": 1.5}}, "spare.grip: must be at most 1, is 1.5"),
        ({"spare": {"kind": "wood"}}, "spare.kind: must be one of rubber, steel, is wood"),
        ({"wheels": [{"kind": "steel"}]}, "wheels[0].radius: missing; write a wheel as {radius: 0.1}, m"),
        ({"wheels": [{"radios": 1}]}, "wheels[0].radios: unknown key; did you mean radius?"),
    ],
)
def test_what_does_not_fit_is_told_with_its_place(tree, told):
    with pytest.raises(Misfit) as caught:
        read(tree, Cart)
    assert str(caught.value) == told


def test_the_comments_of_parameters_are_in_their_docstrings():
    assert "\n\nrange, least_range: Greatest and least range, m; a depth" in str(config.ScanConfig.__doc__)
    assert "\nmap; 0: exactly known." in str(config.TagSensorConfig.__doc__)
    assert "Ablations" not in str(config.ExplorerConfig.__doc__)
