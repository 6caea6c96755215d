"""An emulated base."""

import pytest

from tfg_drake.hardware.emulation.emulator import Emulator


@pytest.fixture
def emulator():
    with Emulator() as emulator:
        yield emulator
