"""Opening a serial port, and what to do where that fails."""

from __future__ import annotations

import dataclasses
import errno
import termios
from pathlib import Path
from typing import TYPE_CHECKING

from tfg_drake.hardware.device import DeviceError, imported

if TYPE_CHECKING:
    import serial


@dataclasses.dataclass(frozen=True)
class SerialDevice:
    """Device on a serial port. name: as used in a sentence. usb: vendor and product id of its USB converter."""

    name: str
    usb: str


_IN_USE = "in use by another program; end that one, or name another port"
_MENDS = {
    errno.ENOENT: "no such device; plug {name} in and switch it on, or name the port it has under /dev/serial/by-id",
    errno.EACCES: "permission denied; join the group dialout (sudo usermod -aG dialout $USER) and log in again, or add"
    " a udev rule for the device {usb}",
    errno.EAGAIN: _IN_USE,
    errno.EBUSY: _IN_USE,
    errno.EISDIR: "is a folder; name the serial port of {name}",
}


def check_port(path: str, device: SerialDevice) -> None:
    """Raise DeviceError if the port does not exist now; that may change until it is opened."""
    if not Path(path).exists():
        raise DeviceError(f"{path}: {_MENDS[errno.ENOENT].format_map(dataclasses.asdict(device))}")


def open_port(path: str, baud_rate: int, device: SerialDevice) -> serial.Serial:
    """Open the port in raw mode for exclusive use. Reading returns the received bytes and raises OSError if the line is
    cut; writing to its file descriptor never blocks.

    Bytes received before are discarded. Raises DeviceError.
    """
    pyserial = imported(path, "serial", "serial")
    try:
        port: serial.Serial = pyserial.Serial(path, baud_rate, timeout=0.0, exclusive=True)
        return port
    except (OSError, ValueError, termios.error) as error:
        # ValueError: the path is invalid; the last: the device disappears while it is being opened.
        mend = _MENDS.get(getattr(error, "errno", 0), "is no serial port that can be used; name that of {name}")
        raise DeviceError(f"{path}: {mend.format_map(dataclasses.asdict(device))}") from None
