"""What is left open in words."""

from tfg_drake.diagrams.missions.summary_words import left_open_rows

ROOMS = [{"area_m2": area, "probability": p} for area, p in ((1.0, 0.5), (4.0, 0.256), (10.0, 0.0))]


def opening(x, why, missing=None):
    return {"p_WO": [x, -2.0], "width_m": 0.4, "why": why, "missing_m": missing, "unknown_m2": 12.3}


def test_a_method_without_a_map_of_free_space_says_nothing():
    assert left_open_rows({"openings": None, "undiscovered": None}) == []
    assert left_open_rows({}) == []


def test_nothing_left_is_told():
    assert left_open_rows({"openings": [], "undiscovered": ROOMS}) == [
        ("left open", "nothing"),
        (
            "unseen room",
            "probability that there is one to enter, at least so large: 0.50 of 1 m2, 0.26 of 4 m2, 0.00 of 10 m2",
        ),
    ]


def test_reasons_are_counted_and_the_first_openings_named():
    openings = [opening(1.0, "too narrow for the robot", 0.031), *(opening(x, "tried in vain") for x in (-0.04, 3.0))]
    rows = left_open_rows({"openings": openings, "undiscovered": ROOMS}, named=2)
    assert rows[:3] == [
        ("left open", "2 tried in vain, 1 too narrow for the robot"),
        (
            "",
            "0.4 m wide at (1.0, -2.0), 12 m2 unknown within 4 m: the way there is too narrow for the robot by 0.03 m"
            " to either side",
        ),
        ("", "0.4 m wide at (0.0, -2.0), 12 m2 unknown within 4 m: tried in vain"),
    ]
    assert [name for name, _ in rows[3:]] == ["unseen room"]
