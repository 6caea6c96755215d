"""A Kobuki without its wire: what it does with commands, and what it says 50 times a second."""

from __future__ import annotations

import math

import numpy as np

from tfg_drake.config import RobotConfig
from tfg_drake.hardware.kobuki import codec as p
from tfg_drake.hardware.kobuki.odometry import GYRO_UNIT, METRES_PER_TICK, WHEEL_BASE, velocity
from tfg_drake.messages import FloatArray
from tfg_drake.simulation import differential_drive as drive

# Time between two feedback frames, s.
PERIOD = 0.02
# The base's own limits of speed, m/s, and turn rate, rad/s.
MAX_SPEED, MAX_TURN_RATE = 0.70, math.pi
# A full battery, 0.1 V.
FULL = 165
# What a base says besides in every frame, by ids and lengths of its sub-payloads: dock, cliff sensors' voltages,
# currents, samples of the gyro, expansion port.
_BESIDES = [p.Other(number, bytes(length)) for number, length in ((3, 3), (5, 6), (6, 2), (13, 14), (16, 16))]


class EmulatedBase:
    """The base among walls. It obeys its last command for ever: the firmware stops neither by itself nor at a bumper.

    state: of tfg_drake.simulation.differential_drive, the truth. distance: how far it has gone so far, m. outputs: the
    newest GeneralOutput's bits. sounds: numbers of the tunes it was told to play. bumper, wheel_drop, cliff, buttons,
    charger, battery, overcurrent: as in CoreSensors, to be set from outside; walls press the bumper besides. clock: s
    that its stamps are ahead of the time since it was switched on. turned: what the gyro has turned, rad. stuck: which
    of "gyro" and "encoders" say what they said when they got stuck, whatever it does; what they miss meanwhile is never
    said. firmware: the version that it says, (major, minor, patch).
    """

    def __init__(self, walls: FloatArray, start: FloatArray, robot: RobotConfig) -> None:
        """walls: (m, 4) in W, m. start: (3,) X_WS. robot: its radius and accelerations count; speeds are the base's."""
        self._walls = walls
        self._robot = RobotConfig(
            robot.radius, MAX_SPEED, MAX_TURN_RATE, robot.max_acceleration, robot.max_turn_acceleration
        )
        self.state = drive.initial_state(start, walls, self._robot)
        self.outputs = 0
        self.sounds: list[int] = []
        self.bumper = self.wheel_drop = self.cliff = self.buttons = self.charger = self.overcurrent = 0
        self.battery = FULL
        self.clock = 0.0
        self.stuck: set[str] = set()
        self.distance = 0.0
        self.firmware = (1, 1, 4)
        self._command = (0.0, 0.0)
        self.turned = 0.0
        # What the left and the right wheel have gone, m, and the gyro's rate, rad/s.
        self._wheels = [0.0, 0.0]
        self._turn_rate = 0.0
        self._answers: list[p.SubPayload] = []

    @property
    def time(self) -> float:
        """Time since it was switched on, s."""
        return float(self.state[drive.TIME])

    @property
    def pose(self) -> FloatArray:
        """The true pose X_WB (3,)."""
        pose: FloatArray = self.state[drive.X : drive.THETA + 1]
        return pose

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
                answers = {1: p.HardwareVersion(4, 0, 1), 2: p.FirmwareVersion(patch, minor, major)}
                answers[8] = p.UniqueId(1, 2, 3)
                self._answers += [answer for flag, answer in answers.items() if part.flags & flag]

    def step(self) -> None:
        """Moves on by one PERIOD."""
        before = self.pose
        self.state = drive.step(self.state, np.array(self._command), self._walls, self._robot, PERIOD)
        speed, turn_rate = float(self.state[drive.SPEED]), float(self.state[drive.TURN_RATE])
        if "encoders" not in self.stuck:
            self._wheels[0] += PERIOD * (speed - 0.5 * WHEEL_BASE * turn_rate)
            self._wheels[1] += PERIOD * (speed + 0.5 * WHEEL_BASE * turn_rate)
        if "gyro" not in self.stuck:
            self.turned += PERIOD * turn_rate
            self._turn_rate = turn_rate
        self.distance += math.hypot(*(self.pose - before)[:2])

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
