"""What is said where a port cannot be opened."""

import errno
import re
import sys

import pytest
import serial

from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.kobuki.driver import KOBUKI
from tfg_drake.hardware.serial_port import open_port
from tfg_drake.io.extras import pip_install


def test_without_pyserial(monkeypatch, emulator):
    monkeypatch.setitem(sys.modules, "serial", None)
    with pytest.raises(DeviceError, match=re.escape(f": serial is not installed: {pip_install('serial')}")):
        open_port(emulator.device, 115200, KOBUKI)


def test_a_port_is_ours_alone(emulator):
    with (
        open_port(emulator.device, 115200, KOBUKI),
        pytest.raises(DeviceError, match="kobuki: in use by another program; end that one"),
    ):
        open_port(emulator.device, 115200, KOBUKI)


def test_a_file_is_no_port(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(DeviceError, match="file: is no serial port that can be used; name that of the base"):
        open_port(str(tmp_path / "file"), 115200, KOBUKI)


def test_no_permission(monkeypatch):
    def refuse(*_, **__):
        raise serial.SerialException(errno.EACCES, "could not open port")

    monkeypatch.setattr(serial, "Serial", refuse)
    with pytest.raises(
        DeviceError, match=r"^/dev/kobuki: permission denied; join the group dialout \(sudo .* 0403:6001"
    ):
        open_port("/dev/kobuki", 115200, KOBUKI)
