"""An emulated base behind a path that stays, as udev's /dev/kobuki does."""

import pytest

from tfg_drake.hardware.kobuki.emulator import Emulator


class Socket:
    """Where a base is plugged in. path: stays the same. emulator: the base that is plugged in."""

    def __init__(self, path):
        self.path, self.emulator = path, None

    def plug(self):
        self.emulator = Emulator()
        self.path.symlink_to(self.emulator.device)
        self.emulator.start()
        return self.emulator

    def unplug(self):
        self.path.unlink()
        self.emulator.close()
        self.emulator = None


@pytest.fixture
def usb(tmp_path):
    """A Socket with a base in it."""
    usb = Socket(tmp_path / "kobuki")
    usb.plug()
    yield usb
    if usb.emulator is not None:
        usb.unplug()
