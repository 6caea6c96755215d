"""A Kobuki on a pseudo-terminal, in real time: a stand-in for the base that needs no base; and orders to it as lines of
text, see docs/kobuki_emulator.md."""

from __future__ import annotations

import collections
import dataclasses
import json
import math
import random
import time
from typing import Any

import numpy as np

from tfg_drake.config import RobotConfig, ScanConfig, TagSensorConfig
from tfg_drake.hardware.device import WAITING, Button
from tfg_drake.hardware.emulation.emulated_device import EmulatedDevice, PseudoTerminal
from tfg_drake.hardware.emulation.emulated_robot import EmulatedRobot
from tfg_drake.hardware.emulation.sensor_faults import sensor_fault
from tfg_drake.hardware.emulation.sensor_socket import SensorSocket
from tfg_drake.hardware.kobuki import codec as p
from tfg_drake.hardware.kobuki.odometry import GYRO_UNIT, METRES_PER_TICK, WHEEL_BASE, velocity
from tfg_drake.hardware.socket_sensors import sensor_line
from tfg_drake.messages import FloatArray
from tfg_drake.mission.operation import Side
from tfg_drake.simulation import differential_drive as drive
from tfg_drake.world.world import World, bare_world

# The base's own limits of speed, m/s, and turn rate, rad/s.
MAX_SPEED, MAX_TURN_RATE = 0.70, math.pi
# Voltage of a full battery, 0.1 V.
FULL = 165
# Other sub-payloads of every frame by id and length: dock, voltages of the cliff sensors, currents, samples of the
# gyro, expansion port.
_BESIDES = [p.Other(number, bytes(length)) for number, length in ((3, 3), (5, 6), (6, 2), (13, 14), (16, 16))]
# Delay of frames that are sent late on purpose, s.
DELAY = 0.2


class EmulatedBase(EmulatedRobot):
    """The base among walls. It obeys its last command for ever: the firmware stops neither by itself nor at a bumper.

    outputs: the newest GeneralOutput's bits. sounds: numbers of the tunes it was told to play. bumper, wheel_drop,
    cliff, buttons, charger, battery, overcurrent: as in CoreSensors, to be set from outside; walls press the bumper,
    too. clock: lead of its stamps over the time since it was switched on, s. turned: angle of the gyro, rad. stuck:
    those of "gyro" and "encoders" whose values stay; the motion meanwhile is never reported. firmware: the reported
    version, (major, minor, patch).
    """

    def __init__(self, world: World, robot: RobotConfig | None = None, *sensors: Any) -> None:
        """robot: its radius and accelerations count; speeds are the base's. sensors: as of EmulatedRobot."""
        robot = robot or RobotConfig()
        own = dataclasses.replace(robot, max_speed=MAX_SPEED, max_turn_rate=MAX_TURN_RATE)
        super().__init__(world, own, *sensors)
        self.outputs = 0
        self.sounds: list[int] = []
        self.bumper = self.wheel_drop = self.cliff = self.buttons = self.charger = self.overcurrent = 0
        self.battery = FULL
        self.clock = 0.0
        self.stuck: set[str] = set()
        self.firmware = (1, 1, 4)
        self._command = (0.0, 0.0)
        self.turned = 0.0
        # Travel of the left and the right wheel, m, and the gyro's rate, rad/s.
        self._wheels = [0.0, 0.0]
        self._turn_rate = 0.0
        self._answers: list[p.SubPayload] = []

    @property
    def time(self) -> float:
        """Time since it was switched on, s."""
        return float(self.state[drive.TIME])

    def obey(self, part: p.SubPayload) -> None:
        """Takes one command; answers come with the next frame."""
        match part:
            case p.BaseControl():
                self._command = velocity(part)
            case p.GeneralOutput():
                self.outputs = part.bits
            case p.SoundSequence():
                self.sounds.append(part.number)
            case p.RequestExtra():
                major, minor, patch = self.firmware
                answers: dict[int, p.SubPayload] = {
                    p.Extra.HARDWARE: p.HardwareVersion(4, 0, 1),
                    p.Extra.FIRMWARE: p.FirmwareVersion(patch, minor, major),
                    p.Extra.UNIQUE_ID: p.UniqueId(1, 2, 3),
                }
                self._answers += [answer for flag, answer in answers.items() if part.flags & flag]

    def step(self) -> None:
        """Moves on by the time of one frame."""
        self.move(self._command, p.PERIOD)
        speed, turn_rate = float(self.state[drive.SPEED]), float(self.state[drive.TURN_RATE])
        if "encoders" not in self.stuck:
            self._wheels[0] += p.PERIOD * (speed - 0.5 * WHEEL_BASE * turn_rate)
            self._wheels[1] += p.PERIOD * (speed + 0.5 * WHEEL_BASE * turn_rate)
        if "gyro" not in self.stuck:
            self.turned += p.PERIOD * turn_rate
            self._turn_rate = turn_rate

    def feedback(self) -> list[p.SubPayload]:
        """The sub-payloads of one frame: the streamed ones, then the answers to requests."""
        left, right = (round(distance / METRES_PER_TICK) % 65536 for distance in self._wheels)
        angle = (round(self.turned / GYRO_UNIT) + 18000) % 36000 - 18000
        answers, self._answers = self._answers, []
        return [
            p.CoreSensors(
                stamp=round(1000.0 * (self.time + self.clock)) % 65536,
                bumper=int(self.state[drive.BUMPER]) | self.bumper,
                wheel_drop=self.wheel_drop,
                cliff=self.cliff,
                left_encoder=left,
                right_encoder=right,
                left_pwm=0,
                right_pwm=0,
                buttons=self.buttons,
                charger=self.charger,
                battery=self.battery,
                overcurrent=self.overcurrent,
            ),
            p.Inertia(angle, round(self._turn_rate / GYRO_UNIT)),
            *_BESIDES,
            *answers,
        ]


def empty_plane() -> World:
    """A world without walls and tags; the robot starts at the origin."""
    return bare_world(np.zeros((0, 4)), np.zeros(3))


class Emulator(EmulatedDevice):
    """The base, switched on from `with` or start() until close(). Without its cable it goes on with what it was told
    last.

    sensors: address (host, port) of the socket with tags and scans. base: the base itself, with the truth, and what is
    wrong with its tags and scans. commands:
    what a driver told the wheels, newest last: (time, p.BaseControl), the time when it was read, s of time.monotonic().
    corrupt, lost, late: shares of frames that leave with a byte changed, not at all, or DELAY late with their old
    stamp. silent: it says nothing, but obeys.

    Stamps of tags and scans are s of time.monotonic(), too. There are no stamps of frames but the base's own.
    """

    def __init__(
        self,
        world: World | None = None,
        robot: RobotConfig | None = None,
        tags: TagSensorConfig | None = None,
        scanner: ScanConfig | None = None,
        seed: int = 0,
    ) -> None:
        """world: an empty plane where there is none. seed: of the sensors' noise and of the corrupted bytes."""
        self._chance = random.Random(seed)
        self.base = EmulatedBase(world or empty_plane(), robot, tags, scanner, seed)
        self.commands: collections.deque[tuple[float, p.BaseControl]] = collections.deque(maxlen=WAITING)
        self.corrupt = self.lost = self.late = 0.0
        self.silent = False
        # Late frames, each with the time at which it is due, s of the base's time.
        self._late: collections.deque[tuple[float, bytearray]] = collections.deque()
        self._deframer = p.Deframer()
        self._begin = 0.0
        self._socket = SensorSocket()
        self.sensors = self._socket.address
        super().__init__("kobuki")

    def _switch_on(self) -> None:
        self.base.step()
        self._sense(time.monotonic(), -1.0)
        self._begin = time.monotonic() - self.base.time

    def unplug(self) -> None:
        """Pulls the cable; half a frame that has come is forgotten."""
        super().unplug()
        self._deframer = p.Deframer()

    def carry(self, X_WB: FloatArray) -> None:
        """Puts the base elsewhere, at X_WB (3,); its wheels and gyro notice nothing."""
        with self._lock:
            state = self.base.state.copy()
            state[drive.X : drive.THETA + 1] = X_WB
            self.base.state = state

    def report(self) -> dict[str, object]:
        """The truth, as EmulatedRobot has it."""
        with self._lock:
            return self.base.truth(self._begin + self.base.time)

    def close(self) -> None:
        """Switches the base off, pulls the cable and closes the socket."""
        super().close()
        self._socket.close()

    def _run(self) -> None:
        while not self._stop.wait(max(0.0, self._begin + self.base.time + p.PERIOD - time.monotonic())):
            with self._lock:
                before = self.base.time
                if self._line is not None:
                    self._listen(self._line)
                self.base.step()
                if self._line is not None:
                    self._speak(self._line)
            self._sense(self._begin, before)

    def _listen(self, line: PseudoTerminal) -> None:
        for payload in self._deframer.feed(line.read()):
            for part in p.decode(payload, p.COMMANDS):
                self.base.obey(part)
                if isinstance(part, p.BaseControl):
                    self.commands.append((time.monotonic(), part))

    def _speak(self, line: PseudoTerminal) -> None:
        frame = bytearray(p.encode(*self.base.feedback()))
        if self._chance.random() < self.corrupt:
            frame[self._chance.randrange(len(frame))] ^= self._chance.randrange(1, 256)
        if self._chance.random() < self.late:
            self._late.append((self.base.time + DELAY, frame))
        elif not self.silent and self._chance.random() >= self.lost:
            line.write(frame)
        while self._late and self._late[0][0] <= self.base.time:
            _, frame = self._late.popleft()
            line.write(frame)

    def _sense(self, begin: float, before: float) -> None:
        """Tags and a scan, each when another of its periods is over since `before`, s."""
        base, now = self.base, self.base.time
        for sensor, told in ((base.tags, base.told_tags), (base.scanner, base.told_scan)):
            due = _count(now, sensor.rate) > _count(before, sensor.rate)
            if due and (message := told(base.pose, begin + now)) is not None:
                self._socket.send(sensor_line(message))


def _count(now: float, rate: float) -> int:
    """Periods of a rate (Hz) that are over."""
    return int(now * rate + 1e-6)


def order(emulator: Emulator, line: str) -> str | None:
    """Does what a line says; the answer, where it asks for one. Raises ValueError where it says nothing known."""
    base, words = emulator.base, line.split()
    try:
        match words:
            case []:
                pass
            case ["silent", "on" | "off" as state]:
                emulator.silent = state == "on"
            case ["tags" | "scan" as sensor, "well"]:
                base.faults.pop(sensor, None)
            case ["tags" | "scan" as sensor, name, *numbers] if all(math.isfinite(float(one)) for one in numbers):
                base.faults[sensor] = sensor_fault(sensor, name, [float(one) for one in numbers])
            case ["corrupt" | "lost" | "late" as what, share] if 0.0 <= float(share) <= 1.0:
                setattr(emulator, what, float(share))
            case ["unplug"]:
                emulator.unplug()
            case ["plug"]:
                emulator.plug()
            case ["press" | "release" as verb, "bumper", side]:
                base.bumper = _changed(base.bumper, Side[side.upper()], verb == "press")
            case ["press" | "release" as verb, "button", button]:
                base.buttons = _changed(base.buttons, Button[f"B{button}"], verb == "press")
            case ["open" | "close" as verb, "cliff", side]:
                base.cliff = _changed(base.cliff, Side[side.upper()], verb == "open")
            case ["drop" | "raise" as verb, "wheel", *side]:
                wheels = p.Wheel[" ".join(side).upper()] if side else p.Wheel.LEFT | p.Wheel.RIGHT
                base.wheel_drop = _changed(base.wheel_drop, wheels, verb == "drop")
            case ["battery", volts] if 0.0 <= float(volts) <= 25.5:
                base.battery = round(10.0 * float(volts))
            case ["dock" | "undock" as verb]:
                base.charger = p.Charger.CONNECTED | p.Charger.CHARGING if verb == "dock" else 0
            case ["overcurrent", "none"]:
                base.overcurrent = 0
            case ["overcurrent", "both"]:
                base.overcurrent = p.Motor.LEFT | p.Motor.RIGHT
            case ["overcurrent", wheel]:
                base.overcurrent = p.Motor[wheel.upper()]
            case ["clock", ahead] if math.isfinite(float(ahead)):
                base.clock += float(ahead)
            case ["carry", pose]:
                X_WB = np.array([float(one) for one in pose.split(",")])
                if X_WB.shape != (3,) or not np.isfinite(X_WB).all():
                    raise ValueError
                emulator.carry(X_WB)
            case ["stick", "gyro" | "encoders" as sensor]:
                base.stuck.add(sensor)
            case ["free", "gyro" | "encoders" as sensor]:
                base.stuck.discard(sensor)
            case ["report"]:
                return json.dumps(emulator.report())
            case _:
                raise ValueError
    except (KeyError, ValueError):
        raise ValueError(f"no order {line.strip()!r}; docs/kobuki_emulator.md lists those that there are") from None
    return None


def _changed(bits: int, which: int, on: bool) -> int:
    return int(bits | which if on else bits & ~which)
