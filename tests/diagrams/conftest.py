"""A room to explore, and a mission in one."""

import pytest

from tests.diagrams.rooms import QUICK_LOOK, ROOM
from tests.diagrams.rooms import room as divided_room
from tfg_drake.diagrams.missions import run


@pytest.fixture(autouse=True)
def _compiled(compiled):
    """No command waits for kernels."""


@pytest.fixture(scope="module", autouse=True)
def _coarse(coarse_figures):
    """Every mission draws its figure."""


@pytest.fixture
def room(tmp_path):
    """The path of a scenario: a bare room, mapped within 8 s."""
    path = tmp_path / "room.yaml"
    path.write_text(ROOM + QUICK_LOOK)
    return str(path)


@pytest.fixture(scope="session")
def finished(tmp_path_factory, compiled):
    """A mission in the divided room, recorded and run to its end."""
    return run.run_mission(divided_room(), name="room", out_dir=tmp_path_factory.mktemp("finished"))
