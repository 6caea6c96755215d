"""The filter between any controller and the base."""

from __future__ import annotations

import logging
import math

import numpy as np
from pydrake.systems.framework import Context, DiscreteValues, LeafSystem

from tfg_drake.config import RobotConfig, SafetyConfig, ScanConfig
from tfg_drake.geometry.motion import advance
from tfg_drake.geometry.se2 import pose_at
from tfg_drake.messages import FloatArray, LaserScan, replace
from tfg_drake.mission.operation import stopped_by
from tfg_drake.safety.keep_out import walled
from tfg_drake.safety.scan_watch import ScanWatch, no_watch, watched
from tfg_drake.safety.velocity_filter import (
    MOST_REFLEXES,
    PRESSED,
    REFLEXES,
    SPEED,
    STATE_SIZE,
    filter_command,
    held,
    stopped,
)
from tfg_drake.simulation.laser_scanner import no_scan
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import COMMAND_PERIOD, MessageInputs, MessageState, number

# Number of consecutive scans, about two seconds, after which a base that stands despite a command reports the reason.
_HELD_SCANS = 20
# The reported obstacle lies at most _NEAR, m, beyond the stop distance: range noise plus the braking distance.
_NEAR = 0.1
_BLOCKED = "something stands in its way; it may turn on the spot, and goes on when its way is free"

_KEPT_OUT = "an area of explorer.keep_out is in its way; it may turn on the spot, or be led elsewhere"

_log = logging.getLogger("tfg_drake.hardware")


class SafetyFilter(LeafSystem):
    """Limits the velocity command to a safe one, see tfg_drake.safety. An unconnected command is zero.

    .. pydrake_system::

        name: SafetyFilter
        input_ports:
        - velocity_commanded
        - hazards
        - scan
        - odometry
        - enable
        - pose
        output_ports:
        - velocity
        - enabled
        - scan_believed

    velocity_commanded, velocity: forward speed (m/s) and turn rate (rad/s). hazards, scan, odometry: messages. enable,
    enabled: vectors of size 1; the base stands while enable is 0; unconnected it is 1. pose: PoseEstimate, by which the
    base keeps out of keep-out areas as if walls surrounded them; unconnected it does not. scan_believed: the newest
    accepted scan; a scanner that repeats its scan counts as silent.
    """

    def __init__(
        self,
        robot: RobotConfig,
        safety: SafetyConfig,
        scan: ScanConfig,
        keep_out: FloatArray | None = None,
        *,
        locks: bool = True,
    ):
        """keep_out: (k, 4) segments that fill the keep-out areas, m in M; None for none. locks: after a cliff or a
        wheel drop a connected `enable` must change its number before the base moves, as with a real robot's
        watchdog."""
        super().__init__()
        self._locks, self._keep_out = locks, keep_out
        self._robot, self._safety, self._scanner = robot, safety, scan
        self._command = self.DeclareVectorInputPort("velocity_commanded", 2)
        self._inputs = MessageInputs(self, "hazards", "scan", "odometry", "pose")
        self._enable = self.DeclareVectorInputPort("enable", 1)
        # The filter's state; its outputs: the velocity, and whether the base may move; and the number of the `enable`
        # that a cliff or a wheel drop has invalidated.
        initial = np.zeros(STATE_SIZE), np.zeros(2), np.ones(1), np.zeros(1)
        self._state, velocity, self._enabled, self._spent = (self.DeclareDiscreteState(values) for values in initial)
        # Updated at the rate of odometry, which is higher than that of scans.
        self._watch = MessageState(self, no_watch(no_scan(scan)), self._Watch)
        self.DeclarePeriodicDiscreteUpdateEvent(COMMAND_PERIOD, 0.0, self._Filter)
        self.DeclareStateOutputPort("velocity", velocity)
        self.DeclareStateOutputPort("enabled", self._enabled)
        self._watch.declare_outputs(self, scan_believed=lambda now: now.believed)

    @metered("safety_filter")
    def _Filter(self, context: Context, update: DiscreteValues) -> None:
        wanted = number(self._enable, context, math.inf)
        spent = self._Spent(context, wanted)
        enabled = wanted not in (0.0, spent)
        before = self._State(context)
        after = self._Filtered(context) if enabled else stopped(before, self._robot, COMMAND_PERIOD)
        if before[REFLEXES] <= MOST_REFLEXES < after[REFLEXES]:
            _log.warning("%.2f s: the base stands: %s", context.get_time(), PRESSED)
        for group, value in enumerate((after, after[:2], [enabled], [spent])):
            update.set_value(group, value)

    def _Spent(self, context: Context, wanted: float) -> float:
        """Return the newest `enable` that a hazard has invalidated; wanted: the current one, 0: none, inf:
        unconnected."""
        before = float(context.get_discrete_state(self._spent).value()[0])
        if not self._locks or wanted in (0.0, math.inf):
            return before
        reason = stopped_by(self._inputs(context, "hazards"))
        if reason is None:
            return before
        if wanted != before:
            _log.warning("%.2f s: the base stands until it is enabled anew: %s", context.get_time(), reason)
        return wanted

    def _Filtered(self, context: Context) -> FloatArray:
        command = self._command.Eval(context) if self._command.HasValue(context) else np.zeros(2)
        hazards = self._inputs(context, "hazards")
        scan, watch = self._Barred(context), self._watch(context)
        state, now, odometry = self._State(context), context.get_time(), self._inputs(context, "odometry")
        return filter_command(
            state, now, command, hazards, scan, watch, odometry, self._robot, self._safety, COMMAND_PERIOD
        )

    def _Barred(self, context: Context) -> LaserScan:
        """Return the newest scan as if walls surrounded the keep-out areas."""
        scan: LaserScan = self._inputs(context, "scan")
        if self._keep_out is None or not len(self._keep_out) or not len(scan.ranges):
            return scan
        pose = self._inputs.optional(context, "pose")
        return scan if pose is None else walled(scan, pose_at(pose, scan.stamp), self._keep_out)

    def _State(self, context: Context) -> FloatArray:
        state: FloatArray = context.get_discrete_state(self._state).value()
        return state

    @metered("safety_filter")
    def _Watch(self, context: Context, before: ScanWatch) -> ScanWatch:
        scan = self._inputs(context, "scan")
        if not scan.stamp > before.newest:
            return before
        odometry = self._inputs(context, "odometry")
        X_OB = advance(odometry.X_OB, odometry.V_B[0], odometry.V_B[1], scan.stamp - odometry.stamp)
        size, barred = (self._robot.radius, self._scanner.least_range), self._Barred(context)
        after = watched(before, scan, X_OB, odometry.at_rest, *size, barred)
        if after.doubt != before.doubt:
            now = context.get_time()
            if after.doubt:
                _log.warning("%.2f s: the base stands: %s", now, after.doubt)
            else:
                _log.info("%.2f s: the scan is believed again", now)
        wanted = self._Wanted(context)
        if abs(wanted) > 0.0 and not after.doubt:
            after = replace(after, held=before.held + 1)
            if after.held == _HELD_SCANS:
                told = held(after, X_OB, wanted, self._robot, self._safety) or _BLOCKED
                if self._Meets(scan, wanted):
                    told = _BLOCKED
                elif self._Meets(barred, wanted):
                    told = _KEPT_OUT
                _log.warning("%.2f s: the base stands: %s", context.get_time(), told)
        return after

    def _Meets(self, scan: LaserScan, speed: float) -> bool:
        """Return True if the scan shows an obstacle that keeps a standing base from starting."""
        ahead = scan.angles if speed > 0.0 else scan.angles - math.pi
        x, y = scan.ranges * np.cos(ahead), scan.ranges * np.sin(ahead)
        reach = self._robot.radius + self._safety.stop_distance + _NEAR
        return bool(np.any((x > 0.0) & (x < reach) & (np.abs(y) < self._robot.radius + self._safety.side_margin)))

    def _Wanted(self, context: Context) -> float:
        """Return the commanded speed, m/s, while the base stands without a hazard, otherwise 0."""
        hazards, enabled = self._inputs(context, "hazards"), context.get_discrete_state(self._enabled)
        kept = hazards.bumper or stopped_by(hazards) is not None or enabled.value()[0] == 0.0
        stands = self._State(context)[SPEED] == 0.0 and not kept
        return number(self._command, context, 0.0) if stands else 0.0
