"""The recorder and the player: what one has heard the other says again."""

import numpy as np
from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

from tfg_drake.messages import Hazards, LaserScan, Odometry, SaidPose, TagDetections
from tfg_drake.planning.requested_goal import RequestedGoal
from tfg_drake.storage.port_recording import MESSAGES, REQUESTS, PortWriter, read_recording
from tfg_drake.systems.port_player import PortPlayer
from tfg_drake.systems.port_recorder import PortRecorder
from tfg_drake.systems.ports import PERIOD, declare_message_output

NONE = np.zeros(0)
LATE = 0.15


class LateStation(LeafSystem):
    """Sensors whose messages are stamped LATE s before they come, ten times a second, and an explorer's command."""

    def __init__(self):
        super().__init__()
        for name in MESSAGES:
            declare_message_output(
                self, name, lambda context, name=name: self.message(name, context), {self.time_ticket()}
            )
        self.DeclareVectorOutputPort(
            "base.enabled", 1, lambda context, output: output.SetFromVector([context.get_time() >= 1.0])
        )
        sent = lambda context: RequestedGoal(int(2.0 * context.get_time()), np.ones(2))  # noqa: E731
        declare_message_output(self, "operator.goal", sent, {self.time_ticket()})
        said = lambda context: SaidPose(context.get_time(), int(context.get_time()))  # noqa: E731
        declare_message_output(self, "operator.pose", said, {self.time_ticket()})
        self.DeclareVectorOutputPort("base.velocity_commanded", 2, lambda _, output: output.SetFromVector([0.25, 0.0]))

    def message(self, name, context):
        stamp = np.floor(10.0 * context.get_time()) / 10.0 - LATE
        return {
            "base.odometry": Odometry(stamp, np.full(3, stamp), np.zeros(2)),
            "base.hazards": Hazards(stamp, 1, 0, 0),
            "tags.detections": TagDetections(stamp, np.array([3]), *np.full((4, 1), stamp)),
            "scan.ranges": LaserScan(stamp, NONE, NONE, 10.0, 0.01),
        }[name]


def test_the_player_says_at_every_time_what_the_recorder_heard_then(tmp_path):
    builder = DiagramBuilder()
    station = builder.AddNamedSystem("station", LateStation())
    with PortWriter(tmp_path / "ports.mcap", "late") as writer:
        recorder = builder.AddNamedSystem("recorder", PortRecorder(writer))
        requested = {name: station.GetOutputPort(name) for name in REQUESTS.values()}
        recorder.Connect(builder, station, station, requested)
        Simulator(builder.Build()).AdvanceTo(2.0)
    recording = read_recording(tmp_path)
    assert recording.end_time == 2.0 - 2.0 % PERIOD
    assert [len(recording.messages[name]) for name in MESSAGES] == [21] * 4
    assert [(one.v, one.w) for one in recording.messages["base.velocity_commanded"]] == [(0.25, 0.0)]

    player, original = PortPlayer(recording), station.CreateDefaultContext()
    context = player.CreateDefaultContext()
    for k in range(33):
        for one in (context, original):
            one.SetTime(k * PERIOD)
        for name in MESSAGES:
            heard, said = player.GetOutputPort(name).Eval(context), station.GetOutputPort(name).Eval(original)
            assert heard.stamp == said.stamp
        assert player.GetOutputPort("operator.goal").Eval(context).count == int(2.0 * k * PERIOD)
        heard = player.GetOutputPort("operator.pose").Eval(context)
        assert (heard.count, heard.stamp) == ((int(k * PERIOD), k * PERIOD) if k >= 16 else (0, -np.inf))
        assert player.GetOutputPort("base.enabled").Eval(context)[0] == (k * PERIOD >= 1.0)


def test_the_player_has_the_ports_of_a_station_and_no_state(tmp_path):
    station = LateStation()
    context = station.CreateDefaultContext()
    with PortWriter(tmp_path / "ports.mcap", "late") as writer:
        for name in MESSAGES:
            writer.write(name, 0.0, station.message(name, context))
    player = PortPlayer(read_recording(tmp_path))
    context = player.CreateDefaultContext()
    assert player.GetOutputPort("base.enabled").Eval(context).tolist() == [1.0]
    assert context.num_total_states() == 0
    assert not player.HasAnyDirectFeedthrough()
