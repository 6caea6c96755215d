"""Another follower: turns to the next point of the path that is not near, then drives there."""

import numpy as np
from pydrake.systems.framework import LeafSystem

import tfg_drake
from tfg_drake.messages import FloatArray, FollowerStatus, message, replace
from tfg_drake.systems.ports import MessageInputs, MessageState

NEAR, AT_END, AHEAD, PATIENCE = 0.2, 0.05, 0.4, 3.0  # m, m, rad, s


@message
class State:
    """status: what is output. command: (2,) m/s and rad/s. next: the point of the path to drive to. since: s, begin of
    the turn, heading: rad, turned: rad so far. obeyed: s, when the robot last did not stand against its command."""

    status: FollowerStatus
    command: FloatArray
    next: int = 0
    since: float = -1.0
    heading: float = 0.0
    turned: float = 0.0
    obeyed: float = 0.0


class PointFollower(LeafSystem):
    """Inputs pose, path, mission; outputs velocity_commanded, a vector, and follower_status, a FollowerStatus."""

    def __init__(self, robot, turn_rate):
        super().__init__()
        self.robot, self.turn_rate = robot, turn_rate
        self.inputs = MessageInputs(self, "pose", "path", "mission")
        self.state = MessageState(self, State(FollowerStatus(0.0, -1, False, False), np.zeros(2)), self.update)
        self.state.declare_outputs(self, follower_status=lambda now: now.status)
        calc = lambda context, output: output.SetFromVector(self.state(context).command)  # noqa: E731
        self.DeclareVectorOutputPort("velocity_commanded", 2, calc, self.state.tickets)

    def update(self, context, now):
        """The state after the one before; asked 16 times a second."""
        pose, path, mission = self.inputs.each(context)
        time, status, command = context.get_time(), replace(now.status, stamp=context.get_time()), np.zeros(2)
        if mission.phase == "observe":
            if now.since != mission.since:
                now = replace(now, since=mission.since, heading=pose.X_MB[2], turned=0.0)
            turned = now.turned + wrapped(pose.X_MB[2] - now.heading)
            now = replace(now, turned=turned, heading=pose.X_MB[2])
            status = replace(status, turn_done=turned >= 2.0 * np.pi)
            command = np.array([0.0, 0.0 if status.turn_done else self.turn_rate])
        elif mission.drives:
            if path.id != status.path_id:
                now, status = replace(now, next=0), replace(status, path_id=path.id, arrived=False)
            last, p_MB = len(path.points) - 1, pose.X_MB[:2]
            while now.next < last and np.hypot(*(path.points[now.next] - p_MB)) < NEAR:
                now = replace(now, next=now.next + 1)
            left = float(np.hypot(*np.diff(np.vstack([p_MB, path.points[now.next :]]), axis=0).T).sum())
            status = replace(status, arrived=status.arrived or left < AT_END, left=left)
            if not status.arrived:
                command = self.towards(path.points[now.next] - p_MB, pose.X_MB[2], left)
        stands = np.abs(pose.speed).max() < 0.01 < np.abs(command).max()
        obeyed = now.obeyed if stands else time
        status = replace(status, stalled=time - obeyed > PATIENCE)
        return replace(now, status=status, command=command, obeyed=obeyed)

    def towards(self, way, heading, left):
        """Speed and turn rate (2,) to a point that lies so far (2,) away, m in M, on a path with so much left, m."""
        off = wrapped(np.arctan2(way[1], way[0]) - heading)
        speed = min(self.robot.max_speed, left) if abs(off) < AHEAD else 0.0
        return np.array([speed, np.clip(2.0 * off, -self.turn_rate, self.turn_rate)])


def wrapped(angle):
    """The angle between -pi and pi, rad."""
    return float((angle + np.pi) % (2.0 * np.pi) - np.pi)


def MakePointFollower(scenario):
    """A factory, as `follower=` of tfg_drake.explore takes one."""
    return PointFollower(scenario.robot, scenario.explorer.turn_rate)


if __name__ == "__main__":
    for name, follower in {"as it is": None, "point by point": MakePointFollower}.items():
        print(f"{name}: {tfg_drake.explore('house', follower=follower, until=300.0)}")
