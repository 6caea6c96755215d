"""The system that publishes what the explorer knows, without a robot."""

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from tests.hardware.fake_robot import SameClock
from tfg_drake.hardware.ros.map_publisher import MapPublisher
from tfg_drake.hardware.ros.preset import Frames
from tfg_drake.messages import replace
from tfg_drake.systems.ports import declare_message_output


class Recorder:
    """A device that keeps what is to be published."""

    def __init__(self):
        self.published = []

    def publish(self, key, message):
        self.published.append((key, message))

    def count(self, key):
        return sum(key == one for one, _ in self.published)


class Source(LeafSystem):
    """Messages by time: message_at(t) for each port."""

    def __init__(self, ports):
        super().__init__()
        for name, message_at in ports.items():
            declare_message_output(
                self, name, lambda context, message_at=message_at: message_at(context.get_time()), {self.time_ticket()}
            )


def run(ports, duration):
    """What a recorder gets in `duration` s from message_at(t) by port."""
    device, builder = Recorder(), DiagramBuilder()
    publisher = builder.AddSystem(MapPublisher(device, Frames(), SameClock()))
    source = builder.AddSystem(Source(ports))
    for name in ports:
        builder.Connect(source.GetOutputPort(name), publisher.GetInputPort(name))
    Simulator(builder.Build()).AdvanceTo(duration)
    return device


def constant(message):
    return lambda _: message


def test_the_map_once_a_stage_the_pose_all_the_time(room):
    first = {name: constant(message) for name, message in room.messages(0.0).items()}
    device = run(first, 1.0)
    assert {key: device.count(key) for key in ("map", "markers", "path")} == {"map": 1, "markers": 1, "path": 1}
    assert device.count("pose") == device.count("tf") == 17

    maps = [room.tfg(), replace(room.tfg(), stage=2)]
    goals = [room.goal(), replace(room.goal(), stage=2)]
    paths = [room.path(), replace(room.path(), id=2)]
    first["tfg"] = lambda t: maps[t >= 0.5]
    first["goal"] = lambda t: goals[t >= 0.7]
    first["path"] = lambda t: paths[t >= 0.8]
    device = run(first, 1.0)
    assert {key: device.count(key) for key in ("map", "markers", "path")} == {"map": 2, "markers": 3, "path": 2}


def test_a_grid_once_a_stage(room):
    grids = [replace(room.grid(), stamp=0.1 * i, stage=1 + i // 6) for i in range(11)]
    device = run({"pose": constant(room.pose(0.0)), "grid": lambda t: grids[int(10.0 * t)]}, 1.0)
    assert device.count("map") == 2
    assert device.count("tf") == 0


def test_nothing_is_said_without_a_pose(room):
    assert run({"path": constant(room.path())}, 0.5).published == []
