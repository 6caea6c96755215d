"""The emulated TurtleBot behind a small rosbridge server of ours: `python rosbridge_turtlebot.py FILE_DESCRIPTOR`.

It speaks what is needed of rosbridge's protocol 2.0: subscribe, advertise, publish, and the service /rosapi/topics.
"""

import asyncio
import base64
import json
import math
import sys
from multiprocessing.connection import Connection

from autobahn.asyncio.websocket import WebSocketServerFactory, WebSocketServerProtocol
from emulated import make_robot, orders

TOPICS = {
    "/odom": "nav_msgs/msg/Odometry",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/detections": "sensor_msgs/msg/PointCloud2",
    "/cmd_vel": "geometry_msgs/msg/TwistStamped",
}
# What a client may listen to although nobody says it yet.
SILENT = {"/initialpose": "geometry_msgs/msg/PoseWithCovarianceStamped"}
KEYS = {"odometry": "/odom", "scan": "/scan", "detections": "/detections"}
# By topic, how a client advertised it, and its newest message as `msg`.
heard = {}
clients, robot = set(), make_robot()


class Client(WebSocketServerProtocol):
    """One connection."""

    def onOpen(self):
        self.subscribed = set()
        clients.add(self)

    def onMessage(self, payload, isBinary):
        message = json.loads(payload)
        if message["op"] == "subscribe":
            assert (TOPICS | SILENT)[message["topic"]] == message["type"]
            self.subscribed.add(message["topic"])
        elif message["op"] == "advertise":
            assert TOPICS.get(message["topic"], message["type"]) == message["type"]
            heard[message["topic"]] = message
        elif message["op"] == "publish" and message["topic"] == "/cmd_vel":
            robot.drive(message["msg"])
        elif message["op"] == "publish":
            heard[message["topic"]] |= {"msg": message["msg"]}
        elif message["op"] == "call_service":
            values = {"topics": list(TOPICS), "types": list(TOPICS.values())}
            answer = {"op": "service_response", "id": message["id"], "service": message["service"]}
            self.say(answer | {"values": values, "result": True})

    def onClose(self, wasClean, code, reason):
        clients.discard(self)

    def say(self, message):
        self.sendMessage(json.dumps(message, allow_nan=False).encode())


def in_json(value):
    """A message as rosbridge writes it: bytes in base64, null where a number is not finite."""
    if isinstance(value, dict):
        return {key: in_json(item) for key, item in value.items()}
    if isinstance(value, list):
        return [in_json(item) for item in value]
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def main():
    """Runs until the test lets go."""
    loop = asyncio.new_event_loop()
    asyncio.set_event_loop(loop)
    factory = WebSocketServerFactory(loop=loop)
    factory.protocol = Client
    server = loop.run_until_complete(loop.create_server(factory, "127.0.0.1", 0))

    def publish(key, message):
        for client in clients:
            if KEYS.get(key) in client.subscribed:
                client.say({"op": "publish", "topic": KEYS[key], "msg": in_json(message)})

    def spin(duration):
        loop.run_until_complete(asyncio.sleep(duration))

    def cut():
        for client in clients:
            client.transport.abort()

    connection = Connection(int(sys.argv[1]))
    connection.send(server.sockets[0].getsockname()[1])
    robot.run(publish, spin, orders(robot, connection, {"cut": cut, "heard": lambda: heard}))


main()
