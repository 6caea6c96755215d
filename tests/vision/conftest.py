"""Where recorded data may be."""

from pathlib import Path

import pytest

# Beside the project, where there is one; nothing of it is the project's own.
SHARED_DATA = Path(__file__).parents[3] / "shared" / "data"


@pytest.fixture(scope="session")
def shared_data():
    """A folder of recorded data by name; the test is skipped where it is not there."""

    def folder(name):
        path = SHARED_DATA / name
        if not path.is_dir():
            pytest.skip(f"no recorded data in {path}")
        return path

    return folder
