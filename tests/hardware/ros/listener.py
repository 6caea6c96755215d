"""A node that knows nothing of us: `python listener.py FILE_DESCRIPTOR TIMEOUT`; sends what it heard, as plain values.

It joins late, as RViz does, and asks for what was said before.
"""

import sys
import time
from multiprocessing.connection import Connection

import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from visualization_msgs.msg import MarkerArray

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TOPICS = {
    "/map": (OccupancyGrid, LATCHED),
    "/tfg/markers": (MarkerArray, LATCHED),
    "/tfg/path": (Path, LATCHED),
    "/tfg/pose": (PoseWithCovarianceStamped, 10),
    "/odom": (Odometry, qos_profile_sensor_data),
}


def plain(value):
    """A message as dictionaries and lists."""
    if hasattr(value, "get_fields_and_field_types"):
        return {name: plain(getattr(value, name)) for name in value.get_fields_and_field_types()}
    return value if isinstance(value, str | int | float) else [plain(one) for one in value]


rclpy.init()
node = rclpy.create_node("listener")
heard = {}
for topic, (kind, qos) in TOPICS.items():
    node.create_subscription(kind, topic, lambda message, topic=topic: heard.update({topic: message}), qos)
end = time.monotonic() + float(sys.argv[2])
while time.monotonic() < end and len(heard) < len(TOPICS):
    rclpy.spin_once(node, timeout_sec=0.1)
Connection(int(sys.argv[1])).send({topic: plain(message) for topic, message in heard.items()})
