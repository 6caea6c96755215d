"""What the Kobuki and its host say to each other: the sub-payloads, whole numbers in the wire's units.

Source: the vendor's driver kobuki_core 1.4.0 (packets/*.hpp, command.cpp) and the protocol appendix of its developer
guide; where they disagree, the driver's code. tfg_drake.hardware.kobuki.codec makes bytes of them,
tfg_drake.hardware.kobuki.odometry SI units. "Gains times 1000", "0.1 V" and so on is the unit of the number.
"""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class SubPayload:
    """One sub-payload of a frame; each kind is a frozen dataclass."""


# --- Host to base ---


@dataclasses.dataclass(frozen=True)
class BaseControl(SubPayload):
    """How to drive. speed: of the outer wheel, mm/s. radius: of the arc, mm; 0 straight ahead, 1 turn in place."""

    speed: int
    radius: int


@dataclasses.dataclass(frozen=True)
class Sound(SubPayload):
    """A tone. note: 1 / (f * 2.75e-6 s) for the frequency f. duration: ms."""

    note: int
    duration: int


@dataclasses.dataclass(frozen=True)
class SoundSequence(SubPayload):
    """A tune. number: 0 on, 1 off, 2 recharge, 3 button, 4 error, 5 cleaning starts, 6 cleaning ends."""

    number: int


@dataclasses.dataclass(frozen=True)
class RequestExtra(SubPayload):
    """Asks for what is not in every frame. flags: 1 hardware version, 2 firmware version, 8 unique id."""

    flags: int


@dataclasses.dataclass(frozen=True)
class GeneralOutput(SubPayload):
    """All outputs at once. bits: 0x000F digital, 0x00F0 power (3.3 V, 5 V, 12 V 5 A, 12 V 1.5 A), 0x0F00 the LEDs' (red
    1, green 1, red 2, green 2). Power bits of 0 cut the power of sensors that hang on them."""

    bits: int


@dataclasses.dataclass(frozen=True)
class SetGains(SubPayload):
    """Gains of the wheels' speed controller. kind: 0 the factory's, 1 the user's. p, i, d: gains times 1000."""

    kind: int
    p: int
    i: int
    d: int


@dataclasses.dataclass(frozen=True)
class GetGains(SubPayload):
    """Asks for the gains; the base answers with Gains."""

    unused: int = 0


# --- Base to host ---


@dataclasses.dataclass(frozen=True)
class CoreSensors(SubPayload):
    """What matters most, in every frame.

    stamp: ms, wraps at 65536. bumper: bits 1 right, 2 centre, 4 left. wheel_drop: bits 1 right, 2 left. cliff: bits as
    the bumper's. left_encoder, right_encoder: ticks, wrap at 65536. left_pwm, right_pwm: as the motors get it. buttons:
    bits 1, 2, 4. charger: 0 discharging, 2 full and 6 charging in the dock, 18 and 22 the same by the adapter. battery:
    0.1 V. overcurrent: bits 1 left, 2 right.
    """

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
class DockInfrared(SubPayload):
    """The dock's beams at three receivers, as bits: 1, 2, 4 near left, centre, right; 8, 16, 32 far centre, left,
    right."""

    right: int
    centre: int
    left: int


@dataclasses.dataclass(frozen=True)
class Inertia(SubPayload):
    """The gyro about the vertical axis. angle: 0.01 degrees, integrated by the base. rate: 0.01 degrees/s."""

    angle: int
    rate: int


@dataclasses.dataclass(frozen=True)
class CliffAdc(SubPayload):
    """The cliff sensors' raw voltages, 0 to 4095."""

    right: int
    centre: int
    left: int


@dataclasses.dataclass(frozen=True)
class Current(SubPayload):
    """The motors' currents, 10 mA."""

    left: int
    right: int


@dataclasses.dataclass(frozen=True)
class RawGyro(SubPayload):
    """Samples of the gyro since the frame before. frame_id: counts. samples: (x, y, z) of the chip's axes, 0.00875
    degrees/s; about the body's axes that is (-y, x, z)."""

    frame_id: int
    samples: tuple[tuple[int, int, int], ...]


@dataclasses.dataclass(frozen=True)
class GeneralInput(SubPayload):
    """The expansion port. digital: bits. analog_0 to analog_3: 0 to 4095."""

    digital: int
    analog_0: int
    analog_1: int
    analog_2: int
    analog_3: int


@dataclasses.dataclass(frozen=True)
class HardwareVersion(SubPayload):
    """Version of the board."""

    patch: int
    minor: int
    major: int


@dataclasses.dataclass(frozen=True)
class FirmwareVersion(SubPayload):
    """Version of the firmware."""

    patch: int
    minor: int
    major: int


@dataclasses.dataclass(frozen=True)
class UniqueId(SubPayload):
    """Three words that no other base has."""

    a: int
    b: int
    c: int


@dataclasses.dataclass(frozen=True)
class Gains(SubPayload):
    """Gains of the wheels' speed controller, as SetGains."""

    kind: int
    p: int
    i: int
    d: int
