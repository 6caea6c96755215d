"""The planner: extends the roadmap at each stage, plans a path to the chosen goal, and monitors it."""

from __future__ import annotations

import dataclasses
import math
from typing import Annotated

import numpy as np

from tfg_drake.geometry.distance import point_distance
from tfg_drake.geometry.se2 import inverse, pose_at, transform
from tfg_drake.messages import (
    FloatArray,
    GoalChoice,
    IntArray,
    LaserScan,
    MapEstimate,
    MissionStatus,
    Path,
    PathStatus,
    PoseEstimate,
    Roadmap,
    TfgMap,
    message,
    replace,
)
from tfg_drake.planning.budget import leads_home
from tfg_drake.planning.candidates import apart_from_views, frontier_in_sight, places
from tfg_drake.planning.expected_view import expected_frontiers
from tfg_drake.planning.local import local, local_roadmap, planning_radius
from tfg_drake.planning.parameters import PlanningParameters
from tfg_drake.planning.path import path_is_free, plan_path, seen_past, unmapped_obstacles
from tfg_drake.planning.roadmap import (
    DRIVEN_STEP,
    RETURN_OFF,
    RoadmapState,
    empty_roadmap,
    extend,
    place_in_map,
)
from tfg_drake.planning.routes import roadmap_message, routes
from tfg_drake.slam import keyframe_graph
from tfg_drake.table import empty, take

# After this many unreachable goals in a row unmapped obstacles are forgotten, driven ways that a surface crosses are
# closed, and only what the robot would touch blocks a path, as small map errors seem to block narrow places.
BOLD_AFTER = 2
# Unmapped obstacles are kept for this many stages, or until a scan sees past them: they may be too small for the map,
# or walk away.
OBSTACLE_MEMORY = 10
# If obstacles bar every way the robot waits for PATIENCE, s. After a barred way the next one is searched ASK_AGAIN, s,
# later, as a person needs time to pass.
PATIENCE = 5.0
ASK_AGAIN = 1.0


@message
class PlannerState:
    """The planner's state.

    nodes: the roadmap of the whole map. part, estimate, tfg, roadmap: roadmap, map and TFG of its stage, and the
    routes, within the radius, m, that planning uses (see `tfg_drake.planning.local`). path, status: the planner's
    messages. replans: the mission's count when the path was planned. obstacles: (b, 4) segments met on the way that the
    map does not hold, m in the frames A of the views obstacle_view: (b,). scan_stamp: s, of the newest scan with which
    the path was checked, look_stamp: of the newest one with which the obstacles were. waiting_since: s, when every way
    to the goal was found barred by them, otherwise inf, asked: time of the last search for a way. driven: (d, 2) the
    robot's path at this stage, m in M, from the start of the newest view on; driven_before: m, until its end.
    """

    nodes: RoadmapState
    part: RoadmapState
    estimate: MapEstimate
    tfg: TfgMap
    roadmap: Roadmap
    path: Path
    replans: int
    obstacles: Annotated[FloatArray, "b", 4]
    obstacle_view: Annotated[IntArray, "b"]
    driven: Annotated[FloatArray, "d", 2]
    driven_before: float
    status: PathStatus = PathStatus(path_id=0, free=True)
    radius: float = math.inf
    scan_stamp: float = -math.inf
    look_stamp: float = -math.inf
    waiting_since: float = math.inf
    asked: float = -math.inf


def initial_state() -> PlannerState:
    """Return the state before the first view."""
    nodes = empty_roadmap()
    return empty(PlannerState, nodes=nodes, part=nodes, estimate=keyframe_graph.empty_map())


@dataclasses.dataclass(frozen=True)
class Now:
    """The newest messages, with the whole map, and the planner's parameters."""

    estimate: MapEstimate
    tfg: TfgMap
    pose: PoseEstimate
    goal: GoalChoice
    scan: LaserScan
    mission: MissionStatus
    parameters: PlanningParameters


# What the planner does at a look at the newest messages: the first of `extended`, `planned` and `watched` that changes
# anything of the state that `looked` returns. Each returns the same object where nothing is due.


def looked(state: PlannerState, now: Now) -> PlannerState:
    """Return the state without the obstacles that a new scan sees past."""
    if not len(state.obstacles) or now.scan.stamp <= state.look_stamp:
        return state
    met = obstacles_in_map(state, state.estimate)
    gone, _ = seen_past(met, now.scan, pose_at(now.pose, now.scan.stamp))
    return replace(take(state, b=~gone) if gone.any() else state, look_stamp=now.scan.stamp)


def extended(state: PlannerState, now: Now) -> PlannerState:
    """Return the state with the roadmap extended to a new stage of the map."""
    if now.tfg.stage <= state.nodes.stage:
        return state
    failures = now.mission.failures
    if failures >= BOLD_AFTER:
        state = take(state, b=np.zeros(len(state.obstacles), dtype=np.bool_))
    # Somebody who stood in a way driven has had time to go.
    return grow(state, now.estimate, now.tfg, now.parameters, in_vain=failures >= BOLD_AFTER)


def planned(state: PlannerState, now: Now) -> PlannerState:
    """Return the state with a path to the chosen goal, or without one while the standing robot has every way barred by
    obstacles."""
    goal, mission, pose = now.goal, now.mission, now.pose
    chosen = goal.stage == mission.stage == state.nodes.stage and goal.node >= 0
    is_barred = math.isfinite(state.waiting_since) or (mission.replans > 0 and _may_go(state))
    is_done = (state.path.stage, state.replans) == (mission.stage, mission.replans)
    if mission.phase == "plan" and chosen and not is_done and pose.stamp >= state.asked + ASK_AGAIN * is_barred:
        return _plan_or_wait(state, now)
    return state


def watched(state: PlannerState, now: Now) -> PlannerState:
    """Return the state after checking the path ahead and recording the robot's place."""
    pose, scan, mission = now.pose, now.scan, now.mission
    if mission.drives and state.status.free and scan.stamp > state.scan_stamp:
        bold = mission.failures >= BOLD_AFTER
        state = _watch(state, pose, scan, now.parameters.robot.radius, bold)
    if pose.stage != state.nodes.stage or not len(state.driven):
        return state
    if math.dist(pose.X_MB[:2].tolist(), state.driven[-1].tolist()) >= DRIVEN_STEP:
        state = replace(state, driven=np.vstack([state.driven, pose.X_MB[:2]]))
    return state


def _length(driven: FloatArray, p_MD: FloatArray) -> float:
    """Length, m, of the way driven (d, 2), m in M, from where one observation ended to where (2,) the next did.

    `driven` begins with the way during the last glance, which was counted then and is left out. Its last point lies at
    most a step before the end of the way; where it lies farther off, the robot was kidnapped, and a step is counted.
    """
    if not len(driven):
        return 0.0
    unnoted = min(DRIVEN_STEP, float(np.hypot(*(p_MD - driven[-1]))))
    return float(np.hypot(*np.diff(driven[1:], axis=0).T).sum()) + unnoted


def grow(
    state: PlannerState, estimate: MapEstimate, tfg: TfgMap, parameters: PlanningParameters, *, in_vain: bool = False
) -> PlannerState:
    """Return the state with the roadmap extended to the newest view of the whole map.

    in_vain: as of `extend`.
    """
    state = take(state, b=len(estimate.X_MA) - 1 - state.obstacle_view <= OBSTACLE_MEMORY)
    driven_before = state.driven_before + _length(state.driven, estimate.X_MD[:2])
    radius = planning_radius(estimate, parameters.explorer)
    estimate, tfg = local(estimate, tfg, radius, parameters.sensor.range)
    state = replace(state, driven_before=driven_before, radius=radius, estimate=estimate, tfg=tfg)
    nodes = extend(state.nodes, tfg, estimate, parameters, driven=state.driven, radius=radius, in_vain=in_vain)
    part, obstacles = local_roadmap(nodes, estimate, radius), obstacles_in_map(state, estimate)
    roadmap = make_roadmap(part, tfg, estimate, parameters, obstacles, driven_before)
    if len(obstacles) and not frontier_in_sight(roadmap, tfg, parameters.sensor):
        # Before the mission ends, what lies behind them is tried once more.
        cleared = take(state, b=np.zeros(len(state.obstacles), dtype=np.bool_))
        without = make_roadmap(part, tfg, estimate, parameters, cleared.obstacles, driven_before)
        comes_home = parameters.explorer.return_home and not leads_home(roadmap) and leads_home(without)
        is_shut_in = not len(places(roadmap, tfg, estimate.X_MD[:2]))
        if comes_home or is_shut_in or frontier_in_sight(without, tfg, parameters.sensor):
            state, roadmap = cleared, without
    return replace(
        state,
        nodes=nodes,
        part=part,
        roadmap=roadmap,
        # The robot drives on while it glances: that is part of its way, too.
        driven=np.vstack([estimate.X_MA[-1, :2], estimate.X_MD[:2]]),
        waiting_since=np.inf,
        asked=-np.inf,
    )


def make_roadmap(
    nodes: RoadmapState,
    tfg: TfgMap,
    estimate: MapEstimate,
    parameters: PlanningParameters,
    obstacles: FloatArray,
    driven: float,
) -> Roadmap:
    """Return the roadmap message for a robot at the map's departure pose: routes to the nodes, and frontiers in view.

    obstacles: (b, 4) segments met on the way, m in M. driven: m, so far.
    """
    ways, home = routes(nodes, tfg, estimate.X_MD, parameters, obstacles), None
    if parameters.explorer.return_home:
        home = routes(nodes, tfg, estimate.X_MA[0], parameters, obstacles)
    return with_frontiers(roadmap_message(nodes, ways, tfg, parameters, driven, home), estimate, tfg, parameters)


def with_frontiers(roadmap: Roadmap, estimate: MapEstimate, tfg: TfgMap, parameters: PlanningParameters) -> Roadmap:
    """Return the roadmap with the live frontiers that its nodes see beyond the scanner's least range."""
    asked = (roadmap.reachable | roadmap.enterable) & apart_from_views(roadmap.points, tfg, estimate.X_MD[:2])
    points = roadmap.points.compress(asked, axis=0)
    visible = expected_frontiers(points, tfg, parameters.sensor, parameters.least_range)
    visible = visible.spread(np.flatnonzero(asked), len(roadmap.points))
    return replace(roadmap, frontier_offsets=visible.offsets, frontier_index=visible.index)


def obstacles_in_map(state: PlannerState, estimate: MapEstimate) -> FloatArray:
    """Return the obstacles met on the way (b, 4), m in M."""
    ends = place_in_map(np.repeat(state.obstacle_view, 2), state.obstacles.reshape(-1, 2), estimate.X_MA)
    return ends.reshape(-1, 4)


def _plan_or_wait(state: PlannerState, now: Now) -> PlannerState:
    """Return the state with a path, or without one while the standing robot has every way barred by obstacles."""
    pose, scan = now.pose, now.scan
    after = _plan(state, now)
    if len(after.path.points) or now.mission.drives or not _may_go(state):
        return after
    _, in_view = seen_past(obstacles_in_map(state, state.estimate), scan, pose_at(pose, scan.stamp))
    if not in_view.all():
        # An obstacle out of sight may have gone; if not, the robot will see it on its way.
        state = take(state, b=in_view)
        after = _plan(state, now)
    since = min(state.waiting_since, pose.stamp)
    if len(after.path.points) or not len(state.obstacles) or pose.stamp >= since + PATIENCE:
        return after
    # The obstacle may walk away: wait.
    return replace(state, waiting_since=since, asked=pose.stamp)


def _plan(state: PlannerState, now: Now) -> PlannerState:
    pose, goal, mission, parameters = now.pose, now.goal, now.mission, now.parameters
    estimate, tfg, nodes = state.estimate, state.tfg, state.part
    if not state.roadmap.reaches(np.array([goal.node]), state.radius)[0]:
        # A way as long as that may be shorter outside.
        estimate, tfg, nodes = now.estimate, now.tfg, state.nodes
    is_new = pose.stage == estimate.stage
    X_MB, speed = (pose.X_MB, float(pose.speed[0])) if is_new else (estimate.X_MD, 0.0)
    obstacles = obstacles_in_map(state, estimate)
    node = int(np.searchsorted(nodes.ids, goal.node))
    if goal.node not in nodes.ids:
        raise ValueError(
            f"goal of stage {goal.stage}: there is no node {goal.node}; choose one of the roadmap's {len(nodes.ids)},"
            f" by its id: {nodes.ids[0]} to {nodes.ids[-1]}"
        )
    points = plan_path(nodes, estimate, tfg, X_MB, node, parameters, obstacles, speed)
    if _length(state.driven, X_MB[:2]) + np.hypot(*np.diff(points, axis=0).T).sum() > goal.longest_way:
        points = np.zeros((0, 2))
    path = Path(id=state.path.id + 1, stage=mission.stage, points=points)
    status = PathStatus(path_id=path.id, free=True)
    return replace(state, path=path, status=status, replans=mission.replans, waiting_since=np.inf, asked=pose.stamp)


def _may_go(state: PlannerState) -> bool:
    """Return whether any obstacle met on the way is not a mapped surface and so may move away."""
    if not len(state.obstacles):
        return False
    met = obstacles_in_map(state, state.estimate)
    return bool((point_distance(0.5 * (met[:, :2] + met[:, 2:]), state.tfg.segments) > RETURN_OFF).any())


def _watch(state: PlannerState, pose: PoseEstimate, scan: LaserScan, radius: float, bold: bool) -> PlannerState:
    estimate, segments = state.estimate, state.tfg.segments
    X_MS = pose_at(pose, scan.stamp)
    seen = replace(state, scan_stamp=scan.stamp)
    if path_is_free(state.path.points, scan, X_MS, radius, segments, bold=bold):
        return seen
    met = unmapped_obstacles(state.path.points, scan, X_MS, radius, segments)
    in_A = transform(inverse(estimate.X_MA[-1]), met.reshape(-1, 2)).reshape(-1, 4)
    return replace(
        seen,
        status=PathStatus(path_id=state.path.id, free=False),
        obstacles=np.vstack([state.obstacles, in_A]),
        obstacle_view=np.append(state.obstacle_view, np.full(len(in_A), len(estimate.X_MA) - 1)),
    )
