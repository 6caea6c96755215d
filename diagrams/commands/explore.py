"""Parts of the command explore: the robot that it drives, its progress on the screen, its closing table."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import math
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from tfg_drake.config import ROBOTS
from tfg_drake.diagrams.commands.command_line import bad_input
from tfg_drake.diagrams.commands.screen import say
from tfg_drake.percent import percent

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

    from tfg_drake.cockpit.server import Cockpit
    from tfg_drake.diagrams.methods import Method
    from tfg_drake.diagrams.missions.mission_runner import Progress
    from tfg_drake.diagrams.robots import Robot
    from tfg_drake.diagrams.scenario import Scenario

# Exit code where the map or the summary could not be written.
NOT_WRITTEN = 4
# What remarks what an operator is to see at once.
REMARKING = (
    "hardware",
    "notes",
    "operator",
    "pace",
    "port_recording",
    "run_folder",
    "slam.sensors",
    "visualizer",
    "world",
)


def run_name(scenario: str, world: Path | None, robot: str = "sim") -> str:
    """Name of a run: its robot, its world or its scenario."""
    if robot != "sim":
        return robot.partition(":")[0]
    return Path(scenario).stem if world is None else world.stem.removesuffix(".vectormap")


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


def check_kept(out: Path, replayed: Path | None = None, inputs: Sequence[Path] = ()) -> None:
    """Raises BadInput where a run in the folder would be lost that nothing brings back, or what somebody wrote: one of
    the files that are read has the name of the scenario that a run leaves, and is none."""
    from tfg_drake.storage.port_recording import recorded_robot

    for file in inputs:
        if file.resolve() == (out / "scenario.yaml").resolve() and not (out / "stages.jsonl").exists():
            bad_input(f"--out {out}: its scenario.yaml, which is read, would be written over; name another folder")
    if replayed is not None and out.resolve() == replayed.resolve():
        bad_input(f"--out {out}: holds the run that is replayed; name another folder")
    robot = recorded_robot(out)
    if robot in ROBOTS:
        bad_input(f"--out {out}: holds the run of a real robot ({robot}), which nothing brings back; name another")


@contextlib.contextmanager
def open_robot(
    name: str,
    scenario: Scenario,
    method: Method,
    interrupted: threading.Event,
    *,
    checked: bool = True,
) -> Iterator[tuple[Robot, Scenario]]:
    """The robot to drive, and the scenario within its limits; raises BadInput where there is none, or where a real one
    is checked and something is wrong with it. A rehearsal ends when interrupted."""
    from tfg_drake.diagrams.robots import SIMULATED

    if name == "sim":
        yield SIMULATED, scenario
        return

    from tfg_drake.diagrams.missions.real_robot import OpenRobot, Rehearse
    from tfg_drake.hardware.keyboard import HELP

    if name.startswith("replay:"):
        from tfg_drake.diagrams.recorded_station import ReplayRobot
        from tfg_drake.diagrams.scenario import LoadScenario
        from tfg_drake.storage.port_recording import read_recording

        folder = Path(name.removeprefix("replay:"))
        robot = ReplayRobot(read_recording(folder))
        of_run = folder / "scenario.yaml"
        if robot.world_known and scenario.world != LoadScenario(of_run).world:
            bad_input(f"--robot {name}: that run's world is another; leave the scenario out, or base it on {of_run}")
        yield robot, scenario
        return
    if not checked:
        print("--skip-checks: battery, sensors and clocks are not checked, nor is the first turn", flush=True)
    with OpenRobot(scenario, checked=checked) as opened:
        print(f"{name}: connected; a short rehearsal in simulation, then it is yours", flush=True)
        Rehearse(scenario, method, interrupted)
        print(HELP, flush=True)
        yield opened


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


@contextlib.contextmanager
def remarks_on_screen(screen: TextIO | None = None) -> Iterator[None]:
    """Shows the remarks of base, operator, Meshcat's picture and the run's files on a screen, by default standard
    output."""
    handler = logging.StreamHandler(screen or sys.stdout)
    handler.setFormatter(logging.Formatter("%(message)s"))
    loggers = [logging.getLogger(f"tfg_drake.{name}") for name in REMARKING]
    for logger in loggers:
        logger.addHandler(handler)
    try:
        yield
    finally:
        for logger in loggers:
            logger.removeHandler(handler)


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
    if progress.word:
        return f"{where} {progress.word}"
    speed = progress.time / max(progress.wall_time, 1e-9)
    error = "" if math.isnan(progress.position_error) else f"  error {100.0 * progress.position_error:5.1f} cm"
    return f"{where}{progress.landmarks:>9} {progress.area:5.0f} m2{error}  {speed:4.1f} x real time"


def is_kept(unwritten: dict[str, str]) -> bool:
    """True if a run's map and summary are on the disk."""
    return not unwritten.keys() & {"map.npz", "grid.npz", "summary.json"}


def table_rows(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """The closing table: name and value, "-" where there is none."""

    def number(value: float | None, form: str, factor: float = 1.0) -> str:
        return "-" if value is None else form.format(factor * value)

    position, heading = summary["position_error_moving_m"] or {}, summary["heading_error_rad"] or {}
    mapped, present = summary["landmarks_mapped"], summary["landmarks_reachable"]
    rows = {
        "outcome": f"{summary['outcome']}: {summary['reason']}",
        "time": f"{summary['sim_time_s']:.1f} s, {number(summary['real_time_factor'], '{:.1f}')} x real time",
        "driven": f"{number(summary['distance_m'], '{:.1f}')} m, {summary['stages']} stages",
        "tags": "-",
        "walls": f"{summary['walls_mapped']} mapped",
        "map": "-",
        "pose error": "-",
        "coverage": "-",
        "safety": "-",
    }
    if mapped is not None:
        rows["tags"] = f"{mapped} mapped"
    if mapped is not None and present:
        rows["tags"] += (
            f" of {present} reachable, map error {number(summary['landmark_rmse_m'], '{:.3f}')} m"
            f" RMSE ({number(summary['landmark_rmse_aligned_m'], '{:.3f}')} m aligned)"
        )
    if summary["landmarks_doubtful"]:
        rows["tags"] += f"; doubtful: {', '.join(map(str, summary['landmarks_doubtful']))}"
    if least := summary["least_known"]:
        x, y = least["p_WL"]
        rows["map"] = f"known to {least['deviation_m']:.3f} m or better (1 sigma); least at ({x:.1f}, {y:.1f})"
    if changes := summary["changes"]:
        from tfg_drake.mapfile.changes import told

        found = changes["found_at_s"]
        rows["known map"] = "the robot has not found itself in it, and has mapped apart; map merge may join the two"
        if found is not None:
            rows["known map"] = f"the robot found itself at {found:.0f} s; changed since: {told(changes)}"
    if position.get("mean") is not None:
        rows["pose error"] = (
            f"{number(position['mean'], '{:.3f}')} m mean from the first drive on,"
            f" {number(position['max'], '{:.3f}')} m max;"
            f" {number(heading.get('mean'), '{:.4f}')} rad mean"
        )
    if summary["surface_coverage_5cm"] is not None:
        shares = {"area": summary["area_coverage"], "surface within 5 cm": summary["surface_coverage_5cm"]}
        known = [f"{percent(share):.1f} % of the {what}" for what, share in shares.items() if share is not None]
        rows["coverage"] = ", ".join(known)
    if summary["contacts"] is not None:
        clearance = number(summary["min_clearance_m"], "{:.2f}")
        caused = f"{summary['contacts']} by the robot, {summary['contacts_received']} by others"
        rows["safety"] = f"contacts: {caused}; least clearance {clearance} m"
    if not summary["walls_mapped"]:
        del rows["walls"]
    elif not (mapped or present or summary["landmarks_doubtful"]):
        del rows["tags"]
    from tfg_drake.diagrams.missions.left_open import left_open_rows

    return [*rows.items(), *left_open_rows(summary)]
