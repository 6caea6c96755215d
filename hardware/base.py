"""A robot's base as a system."""

from __future__ import annotations

import dataclasses
import logging
import math

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from tfg_drake.hardware.device import HOPELESS, WAITING, BaseState, DeviceError
from tfg_drake.hardware.remarks import Spells, watched
from tfg_drake.hardware.robot_devices import STALE, RobotDevices
from tfg_drake.messages import Hazards, Odometry, message, replace
from tfg_drake.notes import take_note
from tfg_drake.slam import scan_matching
from tfg_drake.slam.first_look import Message, held_against_odometry, off_by_way, remedies
from tfg_drake.systems.ports import COMMAND_PERIOD, MessageInputs, MessageState, number

# Accumulated turn, rad, after which scans and tags are compared with odometry: after a turn and a half their faults are
# significant.
FIRST_TURN = 3.0 * math.pi
# Distance, m, driven after that turn until the scanner's yaw is compared with odometry.
FIRST_WAY = 1.5
CONTRADICT = (
    "scans and odometry contradict each other for a while, the map may not hold: see whether the wheels slip, the "
    "scanner is frozen or its mount has moved"
)

_log = logging.getLogger("tfg_drake.hardware")


@message
class _BaseState:
    """hazards: the newest. tried: the last `enable` that was tried. enabled: the base may move, as far as its device
    allows. waiting: the message that is stale, "" for none. begun: time of the first update, s. since: last time at
    which no message was stale, s. told: the conditions of the remarks. heard: messages during the first turn, then on
    the first way; turned, driven: these are over. scans: the continuous comparison of scans with odometry."""

    hazards: Hazards
    tried: float = 0.0
    enabled: bool = False
    waiting: str = ""
    begun: float = math.inf
    since: float = 0.0
    told: Spells = dataclasses.field(default_factory=dict)
    heard: tuple[Message, ...] = ()
    turned: bool = False
    driven: bool = False
    scans: scan_matching.Watch = dataclasses.field(default_factory=scan_matching.Watch)


class HardwareBase(LeafSystem):
    """Sends velocities to a device and outputs its messages, stamped in the station's time; logs remarks on base and
    sensors, see tfg_drake.hardware.remarks.

    .. pydrake_system::

        name: HardwareBase
        input_ports:
        - velocity
        - enable
        - detections
        - scan
        output_ports:
        - odometry
        - hazards
        - enabled

    velocity: forward speed (m/s) and turn rate (rad/s). enable: 0 (also unconnected): stand; every other number enables
    the base once, until it stops by itself. detections, scan: messages, checked for their age and against odometry.
    enabled: 1 while the base may move and no message is stale.

    After FIRST_TURN the turns by tags and by scans are compared with odometry: if their sign or scale differs, or the
    scanner's clock is wrong, the base stands until it is enabled anew; likewise after FIRST_WAY if the scanner's yaw is
    not the stated one. Scans are compared with odometry all the time; a long contradiction is noted.

    Raises DeviceError in a simulation when the robot is lost for good.
    """

    def __init__(self, devices: RobotDevices) -> None:
        """devices: their base has sent odometry."""
        super().__init__()
        self.devices = devices
        self._device, self._clock = devices.base, devices.clock
        self._velocity = self.DeclareVectorInputPort("velocity", 2)
        self._enable = self.DeclareVectorInputPort("enable", 1)
        self._inputs = MessageInputs(self, "detections", "scan")
        begin = replace(self._device.first(Odometry), stamp=0.0, V_B=np.zeros(2), at_rest=True)
        self._odometry = MessageState(self, begin, self._Hear)
        self._state = MessageState(self, _BaseState(Hazards(0.0, 0, 0, 0)), self._Drive, COMMAND_PERIOD)
        self.DeclareStateOutputPort("odometry", self._odometry.index)
        self._state.declare_outputs(self, "hazards")
        self._state.declare_numbers(self, enabled=lambda now: now.enabled and not now.waiting)

    def _Hear(self, context: Context, before: Odometry) -> Odometry:
        now = context.get_time()
        heard = self._device.take(Odometry, self._clock.host(now, now))
        if not heard:
            return before
        stamp = max(0.0, self._clock.station(heard[-1].stamp, now))
        # At rest only if all messages since the previous update say so.
        return replace(heard[-1], stamp=stamp, at_rest=all(one.at_rest for one in heard))

    def _Drive(self, context: Context, before: _BaseState) -> _BaseState:
        time = context.get_time()
        now = self._Enabled(self._Waiting(before, context), context)
        hazards = [now.hazards, *self._device.take(Hazards, self._clock.host(time, time))]
        if len(hazards) > 1:
            now = replace(now, hazards=replace(hazards[-1], stamp=self._clock.station(hazards[-1].stamp, time)))
        velocity = self._velocity.Eval(context) if now.enabled and not now.waiting else np.zeros(2)
        # Stamped with the host's time at which it is due: if the station is late, the base ignores an old command.
        self._device.command(float(velocity[0]), float(velocity[1]), self._clock.host(time, time))
        now = self._Checked(now, context)
        scans, contradict = scan_matching.watched(now.scans, self._odometry(context), self._inputs(context, "scan"))
        if contradict:
            take_note("contradiction", time, CONTRADICT)
        told, lines = watched(now.told, hazards, self._device.newest(BaseState), time)
        for line in lines:
            _log.warning("%.2f s: %s", time, line)
        for line in self.devices.take_remarks():
            take_note("sensor", time, line)
        return replace(now, told=told, scans=scans)

    def _Enabled(self, before: _BaseState, context: Context) -> _BaseState:
        """Return the state after enabling or stopping the device as requested, and after stops of its own."""
        time = context.get_time()
        wanted = number(self._enable, context, 0.0)
        if wanted == 0.0:
            if before.enabled:
                self._device.lock("stopped by the operator")
            return replace(before, tried=0.0, enabled=False)
        if wanted != before.tried:
            try:
                self._device.enable()
            except DeviceError as error:
                _log.warning("%.2f s: %s", time, error)
                return replace(before, tried=wanted, enabled=False)
            _log.info("%.2f s: enabled", time)
            return replace(before, tried=wanted, enabled=True)
        if before.enabled and (reason := self._device.locked):
            _log.warning("%.2f s: the base stands until it is enabled anew: %s", time, reason)
            return replace(before, enabled=False)
        return before

    def _Checked(self, before: _BaseState, context: Context) -> _BaseState:
        """Return the state after comparing the sensors with odometry, once after the first turn and once after the
        first way; a fault locks the device."""
        if before.driven or not before.enabled or not self.devices.checked:
            return before
        said: list[Message] = [self._odometry(context), *self._inputs.each(context, "scan", "detections")]
        known = {(type(one), one.stamp) for one in before.heard}
        heard = (*before.heard, *(one for one in said if (type(one), one.stamp) not in known))[-WAITING:]
        x, y, heading = np.array([one.X_OB for one in heard if isinstance(one, Odometry)]).T
        if before.turned:
            moved, enough, how = np.hypot(np.diff(x), np.diff(y)), FIRST_WAY, "has driven"
        else:
            moved, enough, how = np.abs(np.diff(np.unwrap(heading))), FIRST_TURN, "turned"
        if moved.sum() < enough:
            return replace(before, heard=heard)
        if before.turned:
            wrong = off_by_way(heard)
            if wrong is None:
                return replace(before, heard=())
        else:
            tags, scan = held_against_odometry(heard)
            # The lag of the tags is no fault: the camera's clock offset is estimated with the map.
            wrong = remedies(replace(tags, lag=0.0), scan)
        if wrong:
            self._device.lock(wrong[0])
        else:
            seen = "scan" if self.devices.tags is None or before.turned else "scan, tags"
            _log.info("%.2f s: %s and odometry agree on how it %s", context.get_time(), seen, how)
        return replace(before, heard=(), turned=True, driven=before.turned)

    def _Waiting(self, before: _BaseState, context: Context) -> _BaseState:
        """Return the state with the name of the stale message. Raises DeviceError if one is stale for HOPELESS s."""
        now = context.get_time()
        if before.begun > now:
            before = replace(before, begun=now, since=now)
        stamps = {"odometry": self._odometry(context).stamp, "scan": self._inputs(context, "scan").stamp}
        if self.devices.tags is not None:
            stamps["tags"] = self._inputs(context, "detections").stamp
        stale = [name for name, stamp in stamps.items() if not now - max(before.begun, stamp) <= STALE[name]]
        if not stale:
            if before.waiting:
                _log.info("%.2f s: %s again", now, before.waiting)
            return replace(before, waiting="", since=now)
        if now - before.since > HOPELESS:
            reason = self._device.locked if stale[0] == "odometry" else None
            raise DeviceError(f"no {stale[0]} for {HOPELESS:.0f} s: {reason or 'its source is silent'}")
        if before.waiting != stale[0]:
            _log.warning("%.2f s: the base stands: no %s for more than %g s", now, stale[0], STALE[stale[0]])
        return replace(before, waiting=stale[0])
