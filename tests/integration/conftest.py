"""Whole runs of the program."""

import pytest


@pytest.fixture(autouse=True)
def _compiled(compiled):
    """No command waits for kernels."""
