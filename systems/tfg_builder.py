"""The TFG builder: surfaces, free space and frontiers of every goal, placed by the newest map."""

from __future__ import annotations

import math

import numpy as np
from pydrake.common.value import AbstractValue
from pydrake.systems.framework import Context, EventStatus, LeafSystem, State

from tfg_drake.config import ExplorerConfig, RobotConfig, ScanConfig, TagSensorConfig
from tfg_drake.cpu_meter import metered
from tfg_drake.messages import LaserScan, MapEstimate, MissionStatus, PoseEstimate, TfgMap, message
from tfg_drake.systems.ports import (
    declare_message_input,
    declare_message_output,
    eval_message,
    set_state_message,
    state_message,
)
from tfg_drake.tfg.graph import (
    Sightings,
    TfgGraph,
    empty_graph,
    empty_map,
    no_sightings,
    note_sightings,
    resolve,
    update,
)
from tfg_drake.tfg.panorama import build_panorama


@message
class _Buffer:
    """Since the last goal: the scans of the running turn and the tags sighted on the way."""

    scans: tuple[LaserScan, ...]
    sightings: Sightings


class TfgBuilder(LeafSystem):
    """Collects the scans of a turn in place and adds them to the graph when the map has the turn's goal.

    .. pydrake_system::

        name: TfgBuilder
        input_ports:
        - scan
        - map
        - pose
        - mission
        output_ports:
        - tfg

    tfg.stage follows map.stage one goal at a time. A map that is more than one stage ahead raises ValueError: a goal
    was missed.
    """

    def __init__(self, tags: TagSensorConfig, scan: ScanConfig, robot: RobotConfig, explorer: ExplorerConfig):
        super().__init__()
        self._tags, self._robot, self._explorer = tags, robot, explorer
        self._scan = declare_message_input(self, "scan")
        self._map = declare_message_input(self, "map")
        self._pose = declare_message_input(self, "pose")
        self._mission = declare_message_input(self, "mission")
        self._buffer = self.DeclareAbstractState(AbstractValue.Make(_Buffer((), no_sightings())))
        self._graph = self.DeclareAbstractState(AbstractValue.Make(empty_graph()))
        self._tfg = self.DeclareAbstractState(AbstractValue.Make(empty_map()))
        declare_message_output(
            self,
            "tfg",
            lambda context: state_message(context, self._tfg, TfgMap),
            {self.abstract_state_ticket(self._tfg)},
        )
        # Often enough to see every scan, and a power of two: 1/16 s at 10 Hz.
        period = 2.0 ** -math.ceil(math.log2(1.25 * scan.rate))
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._Update)

    def graph(self, context: Context) -> TfgGraph:
        """The graph, in the builder's own context, in the coordinates of its landmarks and goals."""
        return state_message(context, self._graph, TfgGraph)

    @metered("tfg_builder")
    def _Update(self, context: Context, state: State) -> EventStatus:
        graph = state_message(context, self._graph, TfgGraph)
        estimate = eval_message(self._map, context, MapEstimate)
        if estimate.stage > graph.stage:
            self._AddGoal(context, state, graph, estimate)
            return EventStatus.Succeeded()
        buffer = state_message(context, self._buffer, _Buffer)
        collected = self._Collect(context, buffer)
        if collected is buffer:
            return EventStatus.DidNothing()
        set_state_message(state, self._buffer, collected)
        return EventStatus.Succeeded()

    def _Collect(self, context: Context, buffer: _Buffer) -> _Buffer:
        sightings = note_sightings(buffer.sightings, eval_message(self._pose, context, PoseEstimate))
        scans = buffer.scans
        if eval_message(self._mission, context, MissionStatus).phase == "observe":
            scan = eval_message(self._scan, context, LaserScan)
            if np.isfinite(scan.stamp) and (not scans or scan.stamp > scans[-1].stamp):
                scans = (*scans, scan)
        if scans is buffer.scans and sightings is buffer.sightings:
            return buffer
        return _Buffer(scans, sightings)

    def _AddGoal(self, context: Context, state: State, graph: TfgGraph, estimate: MapEstimate) -> None:
        buffer = state_message(context, self._buffer, _Buffer)
        panorama = build_panorama(buffer.scans, estimate.observation.stamps, estimate.observation.X_AB)
        graph = update(graph, estimate, panorama, buffer.sightings, self._tags, self._robot, self._explorer)
        set_state_message(state, self._graph, graph)
        set_state_message(state, self._tfg, resolve(graph, estimate, self._robot, self._explorer))
        set_state_message(state, self._buffer, _Buffer((), no_sightings()))
