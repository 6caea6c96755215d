"""Runs a mission to its end: how fast it goes, who may hold it meanwhile, when it is over, and how far it is."""

from __future__ import annotations

import dataclasses
import logging
import math
import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from tfg_drake.bad_input import EstimateLost
from tfg_drake.diagrams.interruption import NAMES, Interruption
from tfg_drake.diagrams.missions.mission import STEP, Mission
from tfg_drake.geometry.star import covered_area
from tfg_drake.grid.frontier import FREE, classify
from tfg_drake.mapfile.summary import landmark_counts
from tfg_drake.mission.sequence import NOT_ENABLED
from tfg_drake.storage.checkpoint import CheckpointError

if TYPE_CHECKING:
    from tfg_drake.cockpit.clock import Clock

# Period of the checks of a real robot's mission and of a page's requests, s: simulated time, wall time while the clock
# is held.
WATCHED_STEP = 0.125
# Greatest share of the wall time spent on computing the seen area, which takes a tenth of a second in a large building.
AREA_SHARE = 0.02

_log = logging.getLogger("tfg_drake.run")


@dataclasses.dataclass(frozen=True)
class Progress:
    """The progress of a mission: simulated and wall time (s), phase, views in the map, landmarks in the map as they are
    told, such as "3 tags", area seen (m^2), error of the estimated position (m), nan where the truth is not known;
    outcome: "" until it has ended."""

    time: float
    wall_time: float
    phase: str
    stage: int
    landmarks: str
    area: float
    position_error: float
    outcome: str = ""

    @property
    def line(self) -> str:
        """It on one line of a terminal of 80 columns; what is done now where the mission has ended."""
        if self.outcome:
            # In a building of thousands of tags the last solve takes half a minute.
            return f"{self.time:6.1f} s  {self.outcome}: solving the whole map, writing the run's files"
        where = f"{self.time:6.1f} s  stage {self.stage:3d} {self.phase:8s}"
        speed = self.time / max(self.wall_time, 1e-9)
        error = "" if math.isnan(self.position_error) else f"  error {100.0 * self.position_error:5.1f} cm"
        return f"{where}{self.landmarks:>9} {self.area:5.0f} m2{error}  {speed:4.1f} x real time"


class MissionRunner:
    """Takes one mission through `run`, which may be called once."""

    def __init__(self, mission: Mission, interrupted: threading.Event) -> None:
        """interrupted: ends the mission when set."""
        self._mission, self._request, self._interrupted = mission, mission.request, interrupted
        self._clock_version = -1  # version of the page's clock that the simulator has
        self._area, self._next_area = 0.0, 0.0

    def run(
        self, write: Callable[[str], object] = lambda _line: None, keep: Callable[[bool], None] | None = None
    ) -> None:
        """Simulate until the mission ends, and note its outcome and the reason. write: as for `Mission.begin`. keep:
        called now and then, to keep what there is, with True where it must be kept now; what it or `write` raises ends
        the mission. Raises CheckpointError where there is nothing to go on from."""
        mission, request = self._mission, self._request
        keep, step = keep or (lambda _now: None), WATCHED_STEP if mission.robot.real else STEP
        try:
            mission.begin(write)
            keep(True)
            mission.simulator.set_target_realtime_rate(1.0 if mission.robot.real else request.realtime_rate)
            while not self._ended():
                boundary = step * (math.floor(mission.time / step) + 1.0)
                mission.advance(min(boundary, request.max_time, mission.robot.end_time), self._stop)
                keep(False)
                self._tell()
            if not mission.terminated:
                keep(True)
                # A mission that ends by itself has handled all events of its last instant. One that is ended from
                # outside handles them here, so that a replay of its recording gives the same result.
                mission.simulator.AdvancePendingEvents()
                mission.observe()
            mission.say(f"{mission.outcome.replace('_', ' ')}: solving the whole map")
            mission.show()
        except CheckpointError:  # There is no mission.
            raise
        except (Exception, SystemExit) as error:  # Drake's failed assertions come as SystemExit.
            first_line = next(iter(str(error).strip().splitlines()), "no message")
            mission.outcome, mission.failure = "fault", error
            mission.reason = f"{type(error).__name__} at {mission.time:.2f} s: {first_line}"
            if isinstance(error, EstimateLost):
                mission.reason = first_line
            _log.exception("the mission failed at %.3f s", mission.time)
        finally:
            mission.robot.close()
        mission.account()
        if mission.built:
            self._tell()

    def _stop(self) -> float:
        """Return the time up to which to simulate before the next call, s, -inf after an interrupt; obeys the page's
        clock, which may be held or change its rate. These instants do not change the mission."""
        page, time = self._request.cockpit, self._mission.time
        if page is not None and page.clock is not None:
            self._obey(page.clock)
        if self._interrupted.is_set():
            return -math.inf
        is_watched = page is not None and page.clock is not None and page.watched
        return WATCHED_STEP * (math.floor(time / WATCHED_STEP) + 1.0) if is_watched else math.inf

    def _obey(self, clock: Clock) -> None:
        """Set the simulator's rate to that of the page's clock, and wait while the clock is held."""
        mission = self._mission
        clock.at_stage(mission.stage_now())
        if clock.version == self._clock_version:
            return
        if clock.held:
            mission.record_now()
            while clock.held and not self._interrupted.wait(WATCHED_STEP):
                pass
        self._clock_version = clock.version
        mission.simulator.set_target_realtime_rate(clock.rate)
        mission.forgive_delay()

    def _ended(self) -> bool:
        mission, outcome, reason = self._mission, "", ""
        if empty := mission.robot.empty(mission.explorer.HasInputPort("recall")):
            x, y, _ = mission.estimated_poses()[1][-1]
            outcome, reason = "battery", f"{empty}: the robot stands at ({x:.2f}, {y:.2f}) m."
        elif mission.status.phase == "done":
            outcome, reason = mission.status.outcome, mission.status.reason
            if mission.apart and outcome in ("complete", "stuck"):
                outcome, reason = "apart", f"It has not found itself in the map that it began with: {reason}"
            elif mission.adrift and outcome in ("complete", "stuck"):
                outcome, reason = "apart", f"It does not know where it is in what it mapped before: {reason}"
        elif self._interrupted.is_set():
            by = f" by {NAMES[self._interrupted.number]}" if isinstance(self._interrupted, Interruption) else ""
            outcome, reason = "interrupted", f"interrupted{by} at {mission.time:.0f} s"
        elif mission.time >= self._request.max_time:
            outcome, reason = "time_limit", f"the time limit of {self._request.max_time:g} s was reached"
        elif mission.time >= mission.robot.end_time:
            outcome, reason = "time_limit", "the recording has ended"
        mission.outcome, mission.reason = outcome, reason
        return bool(outcome)

    def _tell(self) -> None:
        """Says how far the mission is, to whoever asked."""
        if self._request.on_progress is None:
            return
        mission, wall_time = self._mission, time.monotonic() - self._mission.wall_start
        if mission.outcome or wall_time >= self._next_area:
            began, self._area = time.monotonic(), _seen_area(mission)
            self._next_area = wall_time + (time.monotonic() - began) / AREA_SHARE
        status = mission.status
        self._request.on_progress(
            Progress(
                mission.end_time,
                wall_time,
                "waits" if status.reason == NOT_ENABLED else status.phase,
                status.stage,
                _landmarks(mission),
                self._area,
                mission.position_error(),
                mission.outcome,
            )
        )


def _landmarks(mission: Mission) -> str:
    """The tags in the map or, where there is none, the walls; nothing before there are any."""
    tags = len(mission.map.ids) if mission.map is not None else 0
    return landmark_counts(tags, 0 if tags else mission.walls) if tags or mission.walls else ""


def _seen_area(mission: Mission) -> float:
    """How much of the floor is known to be free, m^2."""
    if mission.tfg is not None:
        return covered_area(mission.tfg.star_offsets, mission.tfg.star_vertices, cell=0.25)
    if mission.grid is not None:
        return float(np.count_nonzero(classify(mission.grid) == FREE)) * mission.grid.resolution**2
    return 0.0
