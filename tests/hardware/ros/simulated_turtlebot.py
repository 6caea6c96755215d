"""A TurtleBot 4 in the scenario `house`, by the simulator's dynamics and sensor models, without noise.

It speaks dictionaries in the form of ROS messages; the scripts beside it put them on a transport. It has no watchdog
of its own: it keeps the velocity it was last told, so a stop is the driver's doing.
"""

import math
import time

import numpy as np

from tfg_drake.config import OdometryConfig, RobotConfig, ScanConfig, TagSensorConfig
from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld
from tfg_drake.geometry import se2
from tfg_drake.hardware.ros import conversions
from tfg_drake.hardware.ros.preset import Scanner
from tfg_drake.simulation import differential_drive, laser_scanner, odometry, tag_sensor

PERIOD = 1.0 / 32.0
ROBOT = RobotConfig(max_acceleration=0.9)
SCANNER = Scanner(x=-0.04, yaw=0.5 * math.pi)
SCAN = ScanConfig(field_of_view=2.0 * math.pi, resolution=math.pi / 180.0)
TAGS = TagSensorConfig(range=5.0)
X_BS = np.array([SCANNER.x, SCANNER.y, SCANNER.yaw])


def house():
    """The world it stands in."""
    return MakeWorld(LoadScenario("house").world)


class SimulatedTurtlebot:
    """Stepped by whoever owns it; every time is the host's monotonic clock, s."""

    def __init__(self):
        self.world = house()
        self.base = differential_drive.initial_state(self.world.start, self.world.walls, ROBOT)
        self.wheels = odometry.initial_state(self.world.start)
        self.command = (0.0, 0.0)
        self.silent = False
        self.clock = time.time() - time.monotonic()  # the robot's ROS clock minus the host's
        self.steps = 0
        # What it was told and when; when it last turned its wheels, and last told its odometry; its poses X_WB.
        self.commands, self.moved, self.told, self.poses = [], -math.inf, -math.inf, []

    def drive(self, twist):
        """Takes a command in, Twist or TwistStamped."""
        twist = twist.get("twist", twist)
        self.command = (twist["linear"]["x"], twist["angular"]["z"])
        self.commands.append((time.monotonic(), *self.command))

    def step(self):
        """One period on; the messages to publish, by topic key."""
        now = time.monotonic()
        self.base = differential_drive.step(self.base, np.array(self.command), self.world.walls, ROBOT, PERIOD)
        X_WB, velocity = self.base[1:4], self.base[4:6]
        if velocity.any():
            self.moved = now
        self.steps += 1
        pose, zero = np.array([*X_WB, *velocity]), np.zeros(3)
        stamp = self.steps * PERIOD
        self.wheels = odometry.integrate(self.wheels, stamp, pose, zero, np.zeros(2), OdometryConfig())
        self.poses.append((now, X_WB))
        header = {"stamp": self._stamp(now), "frame_id": "odom"}
        messages = {}
        if not self.silent:
            messages["odometry"] = _odometry(header, odometry.message(self.wheels))
            self.told = now
        if self.steps % 3 == 0:
            angles = laser_scanner.ray_angles(SCAN)
            scan = laser_scanner.scan(
                self.world.walls, se2.compose(X_WB, X_BS), 0.0, angles, np.zeros(len(angles)), SCAN
            )
            messages["scan"] = _scan(header | {"frame_id": "rplidar_link"}, scan)
            zeros = np.zeros((len(self.world.tag_ids), tag_sensor.NOISE_PER_TAG))
            messages["detections"] = _cloud(header, tag_sensor.detect(self.world, X_WB, 0.0, zeros, TAGS))
        return messages

    def order(self, name, value):
        """What a test asks for: ("silent", bool), ("jump", s), ("report", None); else only the time, s."""
        if name == "silent":
            self.silent = value
        elif name == "jump":
            self.clock += value
        elif name == "report":
            return {"commands": self.commands, "moved": self.moved, "told": self.told, "poses": self.poses}
        return time.monotonic()

    def _stamp(self, now):
        seconds = math.floor(now + self.clock)
        return {"sec": seconds, "nanosec": int(1e9 * (now + self.clock - seconds))}


def serve(connection, publish, spin, port=None, cut=None):
    """Runs the robot in real time until the connection closes; publish(key, message), spin(duration).

    port: what the other end is told to connect to. cut: loses the connections, asked for by the order "cut".
    """
    robot = SimulatedTurtlebot()
    for _ in range(3):
        robot.step()  # compiles what is to be compiled
    connection.send(port)
    due = time.monotonic()
    while True:
        due = max(due + PERIOD, time.monotonic() - 5 * PERIOD)  # a loaded machine: late, but not for ever
        for key, message in robot.step().items():
            publish(key, message)
        for twist in spin(max(0.0, due - time.monotonic())):
            robot.drive(twist)
        while connection.poll():
            try:
                order = connection.recv()
            except EOFError:
                return
            if order[0] == "cut":
                cut()
            connection.send(robot.order(*order))


def _odometry(header, message):
    x, y, theta = message.X_OB.tolist()
    orientation = {"x": 0.0, "y": 0.0, "z": math.sin(0.5 * theta), "w": math.cos(0.5 * theta)}
    pose = {"position": {"x": x, "y": y, "z": 0.0}, "orientation": orientation}
    v, w = message.V_B.tolist()
    return {
        "header": header,
        "child_frame_id": "base_link",
        "pose": {"pose": pose},
        "twist": {"twist": conversions.twist(v, w)},
    }


def _scan(header, scan):
    return {
        "header": header,
        "angle_min": float(scan.angles[0]),
        "angle_max": float(scan.angles[-1]),
        "angle_increment": SCAN.resolution,
        "time_increment": 0.0,
        "range_min": 0.05,
        "range_max": scan.range_max,
        "ranges": scan.ranges.tolist(),
    }


def _cloud(header, detections):
    layout = np.dtype([("id", "<u4")] + [(name, "<f8") for name in conversions.COLUMNS[1:]])
    points = np.zeros(len(detections.ids), dtype=layout)
    points["id"] = detections.ids
    for name in conversions.COLUMNS[1:]:
        points[name] = getattr(detections, name)
    fields = [
        {"name": name, "offset": layout.fields[name][1], "datatype": 6 if name == "id" else 8, "count": 1}
        for name in conversions.COLUMNS
    ]
    return {
        "header": header | {"frame_id": "base_link"},
        "height": 1,
        "width": len(points),
        "fields": fields,
        "is_bigendian": False,
        "point_step": layout.itemsize,
        "row_step": points.nbytes,
        "data": points.tobytes(),
        "is_dense": True,
    }
