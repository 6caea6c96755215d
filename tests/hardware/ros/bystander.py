"""A node like a real robot's, which would obey anybody: `python bystander.py`. For every line on its standard input it
prints as JSON how many commands it has heard and who publishes what it knows of."""

import json
import sys
import threading

import rclpy
from geometry_msgs.msg import TwistStamped

rclpy.init()
node = rclpy.create_node("bystander")
heard = []
node.create_subscription(TwistStamped, "/cmd_vel", heard.append, 10)
threading.Thread(target=rclpy.spin, args=(node,), daemon=True).start()
for _ in sys.stdin:
    published = [topic for topic in ("/odom", "/scan", "/cmd_vel") if node.get_publishers_info_by_topic(topic)]
    print(json.dumps({"commands": len(heard), "published": published}), flush=True)
