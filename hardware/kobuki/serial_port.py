"""Opening the Kobuki's serial port, and what to do where that fails."""

from __future__ import annotations

import errno
import termios
from typing import TYPE_CHECKING

from tfg_drake.hardware.device import DeviceError
from tfg_drake.hardware.kobuki.codec import BAUD_RATE

if TYPE_CHECKING:
    import serial

_MENDS = {
    errno.ENOENT: "no such device; plug the base in and switch it on, or name the port it has under /dev/serial/by-id",
    errno.EACCES: "permission denied; join the group dialout (sudo usermod -aG dialout $USER) and log in again, or add"
    " a udev rule for the device 0403:6001",
    errno.EAGAIN: "in use by another program; end that one, or name another port",
    errno.EBUSY: "in use by another program; end that one, or name another port",
    errno.EISDIR: "is a folder; name the base's serial port",
}


def open_port(path: str) -> serial.Serial:
    """The port, raw and at the base's baud rate, ours alone; reading and writing its file descriptor never blocks.

    What it had received before is thrown away. Raises DeviceError.
    """
    try:
        import serial
    except ModuleNotFoundError:
        raise DeviceError("the package pyserial is missing: pip install -e '.[kobuki]'") from None
    try:
        return serial.Serial(path, BAUD_RATE, timeout=0.0, exclusive=True)
    except (OSError, termios.error) as error:
        # The second where the device goes away while it is being opened.
        mend = _MENDS.get(getattr(error, "errno", 0), "is no serial port that can be used; name the base's")
        raise DeviceError(f"{path}: {mend}") from None
