"""Whole runs of the program."""

import pytest


@pytest.fixture(autouse=True)
def _compiled(compiled):
    """No command waits for kernels."""


@pytest.fixture(scope="module", autouse=True)
def _coarse(coarse_figures):
    """Every mission draws its figure."""
