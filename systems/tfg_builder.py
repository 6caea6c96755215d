"""The TFG builder: adds surfaces, free space and frontiers of every view and places them by the newest map."""

from __future__ import annotations

import math

import numpy as np
from pydrake.systems.framework import Context, LeafSystem

from tfg_drake.config import ExplorerConfig, RobotConfig, ScanConfig, TagSensorConfig
from tfg_drake.messages import FloatArray, LaserScan, MapEstimate, TfgMap, message, replace
from tfg_drake.systems.cpu_meter import metered
from tfg_drake.systems.ports import MessageInputs, MessageState
from tfg_drake.table import empty
from tfg_drake.tfg.feature_graph import TfgGraph
from tfg_drake.tfg.graph import empty_map, resolve, update
from tfg_drake.tfg.panorama import build_panorama

# Greatest number of scans of a glance: all count as taken at its start, although the robot moves.
GLANCE_SCANS = 3


@message
class _BuilderState:
    """The graph, the graph resolved in the newest map, and the scans of the current turn."""

    graph: TfgGraph
    tfg: TfgMap
    scans: tuple[LaserScan, ...]


class TfgBuilder(LeafSystem):
    """Collects the scans of a turn or glance and adds them to the graph when it is in the map.

    .. pydrake_system::

        name: TfgBuilder
        input_ports:
        - scan
        - map
        - landmarks
        - mission
        output_ports:
        - tfg
        - tfg_graph

    scan: LaserScan, map: MapEstimate, mission: MissionStatus. landmarks: MapEstimate of tags and walls, optional:
    without it surfaces are anchored to views only. tfg: TfgMap, in M. tfg_graph: TfgGraph in the coordinates of its
    walls and views, for saving the map.

    tfg.stage follows map.stage one view at a time. A map that is more than one stage ahead raises ValueError, as a view
    was missed.
    """

    def __init__(
        self,
        tags: TagSensorConfig,
        scan: ScanConfig,
        robot: RobotConfig,
        explorer: ExplorerConfig,
        keep_out: FloatArray | None = None,
    ):
        """keep_out: (k, 4) segments that fill the keep-out areas, m in M; None for none."""
        super().__init__()
        self._tags, self._robot, self._explorer = tags, robot, explorer
        self._keep_out = np.zeros((0, 4)) if keep_out is None else keep_out
        self._inputs = MessageInputs(self, "scan", "map", "landmarks", "mission")
        # Short enough to see every scan, and a power of two: 1/16 s at 10 Hz.
        period = 2.0 ** -math.ceil(math.log2(1.25 * scan.rate))
        # One value: Drake copies every abstract state at every event of any system.
        state = MessageState(self, _BuilderState(empty(TfgGraph), empty_map(), ()), self._Update, period)
        state.declare_outputs(self, "tfg", tfg_graph=lambda now: now.graph)

    def _Update(self, context: Context, now: _BuilderState) -> _BuilderState:
        estimate, mission = self._inputs.each(context, "map", "mission")
        if estimate.stage > now.graph.stage:
            landmarks = self._inputs.optional(context, "landmarks")
            return self._AddView(now, landmarks or estimate, mission.moving)
        return self._Collect(context, now, mission.phase)

    def _Collect(self, context: Context, now: _BuilderState, phase: str) -> _BuilderState:
        if phase == "observe" or (phase == "glance" and len(now.scans) < GLANCE_SCANS):
            scan = self._inputs(context, "scan")
            if math.isfinite(scan.stamp) and (not now.scans or scan.stamp > now.scans[-1].stamp):
                return replace(now, scans=(*now.scans, scan))
        return now

    @metered("tfg")
    def _AddView(self, now: _BuilderState, estimate: MapEstimate, glance: bool) -> _BuilderState:
        panorama = build_panorama(now.scans, estimate.observation.stamps, estimate.observation.X_AB)
        graph = update(now.graph, estimate, panorama, self._tags, self._robot, self._explorer, glance=glance)
        tfg = replace(resolve(graph, estimate, self._robot, self._explorer), keep_out=self._keep_out)
        return _BuilderState(graph, tfg, ())
