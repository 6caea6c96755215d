"""Parts of the command explore: what it refuses, the robot that it drives, its progress on the screen."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import math
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tfg_drake.config import ROBOTS
from tfg_drake.diagrams.commands.command_line import bad_input
from tfg_drake.diagrams.screen import say

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

    from tfg_drake.cockpit.server import Cockpit
    from tfg_drake.diagrams.methods import Method
    from tfg_drake.diagrams.missions.mission_runner import Progress
    from tfg_drake.diagrams.robots import Robot
    from tfg_drake.diagrams.scenario import Scenario


def replayed_run(robot: str) -> Path | None:
    """The folder of the run that is driven once more; None where it is none. Raises BadInput where it holds none."""
    if not robot.startswith("replay:"):
        return None
    folder = Path(robot.removeprefix("replay:"))
    if not (folder / "scenario.yaml").is_file():
        bad_input(f"--robot {robot}: there is no scenario.yaml; name the folder of a run")
    return folder


def resumed(run: Path, method: str, robot: str, given: dict[str, Any]) -> str:
    """The method of a mission that is gone on with. Raises BadInput where there is none, where something is given that
    it has already, or something is not that the run must not say by itself: a real robot, a file that is run."""
    from tfg_drake.storage.checkpoint import read_told

    told = read_told(run)
    for option, value in given.items():
        if value is not None:
            bad_input(f"{option}: is that of the run which is resumed; leave it out")
    if told["own"] and not method.endswith((".py", ".csv")):
        bad_input(f"--resume {run}: its method, {told['method']}, is somebody's own; give it again: --method FILE")
    if not told["own"] and method not in ("tfg", told["method"]):
        bad_input(f"--method {method}: the run that is resumed has {told['method']}; leave it out")
    if robot == "sim" != told["robot"]:
        bad_input(f"--resume {run}: that run drove a real robot; give it again: --robot {told['robot']}")
    if robot != told["robot"]:
        bad_input(f"--robot {robot}: the run that is resumed drove {told['robot']}; leave it out")
    return method if told["own"] else str(told["method"])


def link(scenario: Scenario, robot: str, links: dict[str, str | None]) -> None:
    """Sets which real robot is driven, those of its links that were given, and that its world is not the scenario's.

    Raises DeviceError where one of them cannot be.
    """
    from tfg_drake.diagrams.scenario import WorldConfig
    from tfg_drake.hardware.robot_devices import check_devices

    scenario.world, scenario.hardware.robot = WorldConfig(), robot
    for name, value in links.items():
        if value is not None:
            setattr(scenario.hardware, name, value)
    check_devices(scenario.hardware)


def check_robot(
    robot: str, links: dict[str, str | None], place: dict[str, Any], realtime_rate: float, *, checked: bool = True
) -> None:
    """Raises BadInput: what fits a simulated robot only is refused for a real one, and the other way round."""
    if robot not in ROBOTS:
        if not checked:
            bad_input(f"--skip-checks: is for a real robot; give --robot {', '.join(ROBOTS)} too")
        for link, value in links.items():
            if value is not None:
                bad_input(f"--{link} {value}: is for a real robot; give --robot {', '.join(ROBOTS)} too")
    if robot == "sim":
        return
    if robot not in ROBOTS and not robot.startswith("replay:"):
        bad_input(f"--robot {robot}: no such robot; name one of sim, {', '.join(ROBOTS)}, replay:RUN_DIR")
    for option, given in place.items():
        if given is not None:
            bad_input(f"{option}: is for a simulated robot; leave it out")
    if realtime_rate and robot in ROBOTS:
        bad_input("--realtime-rate: a real robot's time is real; leave it out")


def unreal_robot(name: str, scenario: Scenario) -> Robot:
    """The simulated robot, or that of the run that is driven once more; raises BadInput where that is in another
    world."""
    from tfg_drake.diagrams.robots import SIMULATED

    folder = replayed_run(name)
    if folder is None:
        return SIMULATED

    from tfg_drake.diagrams.recorded_station import ReplayRobot
    from tfg_drake.diagrams.scenario import LoadScenario
    from tfg_drake.storage.port_recording import read_recording

    robot, of_run = ReplayRobot(read_recording(folder)), folder / "scenario.yaml"
    if robot.world_known and scenario.world != LoadScenario(of_run).world:
        bad_input(f"--robot {name}: that run's world is another; leave the scenario out, or base it on {of_run}")
    return robot


@contextlib.contextmanager
def keys_of_driver(method: Method, cockpit: Cockpit | None) -> Iterator[Method]:
    """The method manual with the keys of standard input and, if there is one, of the page."""
    from tfg_drake.diagrams.driven_explorers import MakeManualExplorer
    from tfg_drake.hardware.keyboard import Keyboard
    from tfg_drake.mission.manual_drive import HELP, KEYS

    with contextlib.closing(Keyboard(KEYS)) as keyboard:
        print(HELP, flush=True)
        keys: Callable[[], Sequence[str]] = keyboard.requests
        if cockpit is not None:
            cockpit.drives, page = True, cockpit.keys
            keys = lambda: [*keyboard.requests(), *page()]  # noqa: E731
        yield dataclasses.replace(method, MakeExplorer=lambda scenario: MakeManualExplorer(scenario, keys))


def open_meshcat() -> Meshcat:
    """A Meshcat for this machine only, its address printed."""
    from pydrake.common import use_native_cpp_logging
    from pydrake.geometry import Meshcat, MeshcatParams

    # Its server logs when it ends. By way of Python it would wait for Python's lock, which its destructor holds while
    # it waits for the server. And what it says of its address is said here.
    logging.getLogger("drake").setLevel(logging.ERROR)
    with contextlib.suppress(RuntimeError):  # Somebody has set up Drake's log already.
        use_native_cpp_logging()
    meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    say(f"Meshcat: {meshcat.web_url()}")
    return meshcat


def also_on_page(show: Callable[[str], object], cockpit: Cockpit) -> Callable[[str], None]:
    """Wraps show: its lines go to the page, too, until the mission begins."""

    def both(word: str) -> None:
        show(word)
        if not cockpit.begun:
            cockpit.word = word

    return both


def progress_line(progress: Progress) -> str:
    """How far the mission has come, on one line of a terminal of 80 columns; what is done now where it has ended."""
    if progress.outcome:
        # In a building of thousands of tags the last solve takes half a minute.
        return f"{progress.time:6.1f} s  {progress.outcome}: solving the whole map, writing the run's files"
    where = f"{progress.time:6.1f} s  stage {progress.stage:3d} {progress.phase:8s}"
    speed = progress.time / max(progress.wall_time, 1e-9)
    error = "" if math.isnan(progress.position_error) else f"  error {100.0 * progress.position_error:5.1f} cm"
    return f"{where}{progress.landmarks:>9} {progress.area:5.0f} m2{error}  {speed:4.1f} x real time"


def is_kept(unwritten: dict[str, str]) -> bool:
    """True if a run's map and summary are on the disk."""
    return not unwritten.keys() & {"map.npz", "grid.npz", "summary.json"}
