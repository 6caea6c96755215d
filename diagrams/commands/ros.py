"""`tfg-drake ros2`: emulates a TurtleBot on the ROS 2 graph."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import sys
import threading
from typing import TYPE_CHECKING, Annotated

from tfg_drake.diagrams.commands import command
from tfg_drake.diagrams.commands.command import argument, bad_input, flag, option

if TYPE_CHECKING:
    from tfg_drake.hardware.emulation.emulated_turtlebot import EmulatedTurtlebot

ros2_app = command.group("ros2", "Emulate a robot on a ROS 2 graph.")


@ros2_app.command()
def emulate(
    scenario: Annotated[str, argument(None, "The world: a shipped scenario or a YAML file.")] = "house",
    seed: Annotated[int | None, option("N", "Seed of the emulated noise [default: the scenario's].")] = None,
    network: Annotated[bool, flag("--network", "Use the whole network, not only this machine.")] = False,
) -> None:
    """Emulate a TurtleBot 4 until Ctrl-C. Prints its topics and, at the end or for a line `report` on standard input,
    the truth as one line of JSON.

    Its preset is `emulated`: tags come as PointCloud2, as not every ROS has apriltag_msgs. By default it stays on this
    machine, as a real robot in the network would obey the same commands.
    """
    if seed is not None and seed < 0:
        bad_input(f"--seed {seed}: must be 0 or more")

    from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld
    from tfg_drake.hardware.emulation.emulated_turtlebot import EmulatedTurtlebot, Ros2Emulator
    from tfg_drake.hardware.ros.preset import load_preset

    preset = load_preset("emulated")
    if network:
        preset = dataclasses.replace(preset, discovery="subnet")
    loaded = LoadScenario(scenario)
    robot = EmulatedTurtlebot(
        MakeWorld(loaded.world),
        preset,
        loaded.tags,
        loaded.scan,
        loaded.odometry,
        loaded.seed if seed is None else seed,
    )
    emulator = Ros2Emulator(robot, preset)
    with contextlib.suppress(KeyboardInterrupt):
        for topic in emulator.topics:
            print(f"{topic.name:<14}{topic.type}", flush=True)
        threading.Thread(target=_report, args=(robot,), daemon=True).start()
        emulator.run(lambda: True)
    emulator.close()
    print(json.dumps(robot.report()), flush=True)


def _report(robot: EmulatedTurtlebot) -> None:
    for line in sys.stdin or ():
        if line.strip() == "report":
            print(json.dumps(robot.report()), flush=True)
