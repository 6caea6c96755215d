"""Maps odometry, tags and scans from logs of any origin: SLAM without exploration.

Here the logs are those of a run; others are lists of the same messages, stamped from 0 s on. Scans are needed.
"""

import bisect
import sys

from pydrake.systems.analysis import Simulator
from pydrake.systems.framework import DiagramBuilder, LeafSystem

import tfg_drake
from tfg_drake.diagrams.mapping_explorer import MakeMappingExplorer
from tfg_drake.diagrams.mission_diagram import ConnectStation
from tfg_drake.diagrams.scenario import LoadScenario
from tfg_drake.systems.ports import declare_message_output


class Logs(LeafSystem):
    """A station whose outputs are the newest messages of lists by port name; it does not drive."""

    def __init__(self, logs):
        super().__init__()
        for port, messages in logs.items():
            stamps = [message.stamp for message in messages]

            def newest(context, stamps=stamps, messages=messages):
                return messages[max(bisect.bisect_right(stamps, context.get_time()) - 1, 0)]

            declare_message_output(self, port, newest, {self.time_ticket()})
        self.DeclareVectorInputPort("base.velocity_commanded", 2)


def mapped(scenario, logs):
    """The MapEstimate of tags and walls. scenario: its sections odometry, tags, scan and explorer are read."""
    end = logs["base.odometry"][-1].stamp
    builder = DiagramBuilder()
    station = builder.AddNamedSystem("station", Logs(logs))
    explorer = builder.AddNamedSystem("explorer", MakeMappingExplorer(scenario, end))
    ConnectStation(builder, station, explorer)
    simulator = Simulator(builder.Build())
    simulator.AdvanceTo(end + 10.0)  # It ends by itself once all is mapped.
    return explorer.GetOutputPort("landmarks").Eval(explorer.GetMyContextFromRoot(simulator.get_context()))


if __name__ == "__main__":
    run = tfg_drake.load_run(sys.argv[1])
    logs = {port: run.recording.messages[port] for port in ("base.odometry", "tags.detections", "scan.ranges")}
    landmarks = mapped(LoadScenario(run.folder / "scenario.yaml"), logs)
    print(f"{len(landmarks.of_tags.ids)} tags and {len(landmarks.ids) - len(landmarks.of_tags.ids)} walls are mapped")
