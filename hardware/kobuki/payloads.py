"""Sub-payloads between the Kobuki and its host: whole numbers in the wire's units.

Source: the vendor's driver kobuki_core 1.4.0 (packets/*.hpp, command.cpp) and the protocol appendix of its developer
guide; where they disagree, the driver's code. tfg_drake.hardware.kobuki.codec makes bytes of them,
tfg_drake.hardware.kobuki.odometry SI units. "0.1 V" and so on is the unit of the number. What else a base says, of its
dock, its motors' currents or its expansion port, nobody here reads.
"""

from __future__ import annotations

import dataclasses
from struct import Struct
from typing import ClassVar


@dataclasses.dataclass(frozen=True)
class SubPayload:
    """One sub-payload of a frame; each kind is a frozen dataclass. DATA: how its fields stand in bytes."""

    DATA: ClassVar[Struct]


@dataclasses.dataclass(frozen=True)
class Other(SubPayload):
    """One that nobody here reads. number: its id. content: its bytes."""

    number: int
    content: bytes


# --- Host to base ---


@dataclasses.dataclass(frozen=True)
class BaseControl(SubPayload):
    """How to drive. speed: of the outer wheel, mm/s. radius: of the arc, mm; 0 straight ahead, 1 turn in place."""

    DATA = Struct("<hh")
    speed: int
    radius: int


@dataclasses.dataclass(frozen=True)
class SoundSequence(SubPayload):
    """A tune. number: 0 on, 1 off, 2 recharge, 3 button, 4 error, 5 cleaning starts, 6 cleaning ends."""

    DATA = Struct("<B")
    number: int


@dataclasses.dataclass(frozen=True)
class RequestExtra(SubPayload):
    """Asks for what is not in every frame. flags: 1 hardware version, 2 firmware version, 8 unique id."""

    DATA = Struct("<H")
    flags: int


@dataclasses.dataclass(frozen=True)
class GeneralOutput(SubPayload):
    """All outputs at once. bits: 0x000F digital, 0x00F0 power (3.3 V, 5 V, 12 V 5 A, 12 V 1.5 A), 0x0F00 the LEDs' (red
    1, green 1, red 2, green 2). Power bits of 0 cut the power of sensors that hang on them."""

    DATA = Struct("<H")
    bits: int


# --- Base to host ---


@dataclasses.dataclass(frozen=True)
class CoreSensors(SubPayload):
    """Core sensor data, in every frame.

    stamp: ms, wraps at 65536. bumper: bits 1 right, 2 centre, 4 left. wheel_drop: bits 1 right, 2 left. cliff: bits as
    the bumper's. left_encoder, right_encoder: ticks, wrap at 65536. left_pwm, right_pwm: as the motors get it. buttons:
    bits 1, 2, 4. charger: 0 discharging, 2 full and 6 charging in the dock, 18 and 22 the same by the adapter. battery:
    0.1 V. overcurrent: bits 1 left, 2 right.
    """

    DATA = Struct("<HBBBHHbbBBBB")
    stamp: int
    bumper: int
    wheel_drop: int
    cliff: int
    left_encoder: int
    right_encoder: int
    left_pwm: int
    right_pwm: int
    buttons: int
    charger: int
    battery: int
    overcurrent: int


@dataclasses.dataclass(frozen=True)
class Inertia(SubPayload):
    """The gyro about the vertical axis. angle: 0.01 degrees, integrated by the base. rate: 0.01 degrees/s."""

    DATA = Struct("<hh3x")
    angle: int
    rate: int


@dataclasses.dataclass(frozen=True)
class HardwareVersion(SubPayload):
    """Version of the board."""

    DATA = Struct("<BBBx")
    patch: int
    minor: int
    major: int


@dataclasses.dataclass(frozen=True)
class FirmwareVersion(SubPayload):
    """Version of the firmware."""

    DATA = Struct("<BBBx")
    patch: int
    minor: int
    major: int


@dataclasses.dataclass(frozen=True)
class UniqueId(SubPayload):
    """Three words that no other base has."""

    DATA = Struct("<III")
    a: int
    b: int
    c: int
