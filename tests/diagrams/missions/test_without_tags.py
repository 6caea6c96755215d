"""A mission in a building without tags speaks of walls: on the screen, in its table, its title and its exports."""

import re

import pytest

from tests.diagrams.rooms import room
from tfg_drake.diagrams.missions import run
from tfg_drake.diagrams.missions.summary_words import table_rows, title


@pytest.fixture(scope="module")
def mission(tmp_path_factory):
    scenario, lines = room(), []
    scenario.world.tags = []
    folder = tmp_path_factory.mktemp("bare") / "run"
    done = run.run_mission(scenario, name="bare", out_dir=folder, on_progress=lambda at: lines.append(at.line))
    return done, lines


def test_no_line_of_its_progress_speaks_of_tags(mission):
    _, lines = mission
    assert not [line for line in lines if re.search(r"\btags?\b", line)]
    assert re.search(r" observe  {9,} +0 m2 ", lines[1])
    assert re.search(r" [1-9]\d* walls? +\d+ m2 ", lines[-2])


def test_its_table_and_title_speak_of_walls(mission):
    summary = mission[0].summary
    rows = dict(table_rows(summary))
    assert "tags" not in rows
    assert rows["walls"] == f"{summary['walls_mapped']} mapped"
    assert summary["walls_mapped"] >= 4
    ended, mapped, error = title(summary).splitlines()
    assert ended.startswith("bare, tfg, seed 3: complete after ")
    assert re.fullmatch(rf"{summary['walls_mapped']} walls; [\d.]+ % of the surface within 5 cm", mapped)
    assert re.fullmatch(r"pose error 0\.\d{3} m mean from the first drive on, 0\.\d{4} rad mean", error)


def test_its_table_has_the_first_notes(mission):
    notes = [{"kind": "slip", "time_s": 10.0 * k or None, "text": f"note {k}"} for k in range(5)]
    rows = table_rows(mission[0].summary | {"notes": notes})
    at = [name for name, _ in rows].index("notes")
    told = [("notes", "note 0"), ("", "10 s: note 1"), ("", "20 s: note 2"), ("", "2 more in summary.json")]
    assert rows[at : at + 4] == told
    assert "notes" not in dict(table_rows(mission[0].summary | {"notes": []}))


def test_its_exports_speak_of_walls(mission, call, tmp_path):
    folder, count = mission[0].folder, mission[0].summary["walls_mapped"]
    for name in ("a.svg", "a.g2o", "a.yaml"):
        code, out, err = call("map", "export", folder, tmp_path / name)
        assert (code, err) == (0, "")
        assert f": {count} walls, " in out
    code, _, err = call("map", "export", folder, tmp_path / "a.csv")
    assert code == 2
    assert "has no tags; its walls go to another format" in err
