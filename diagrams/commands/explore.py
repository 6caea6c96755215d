"""`tfg-drake explore`: what it refuses, the robot that it drives, its progress on the screen."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from tfg_drake.bad_input import EstimateLost
from tfg_drake.config import ROBOTS
from tfg_drake.diagrams.commands import command
from tfg_drake.diagrams.commands.command import argument, bad_input, flag, option, parse_place
from tfg_drake.diagrams.compile_kernels import wait_for_kernels
from tfg_drake.diagrams.missions import run_folder
from tfg_drake.diagrams.screen import Screen, say

if TYPE_CHECKING:
    from pydrake.geometry import Meshcat

    from tfg_drake.cockpit.server import Cockpit
    from tfg_drake.diagrams.methods import Method
    from tfg_drake.diagrams.missions.run import RunResult
    from tfg_drake.diagrams.robots import Robot
    from tfg_drake.diagrams.scenario import Scenario

# Exit code if the map or the summary could not be written.
NOT_WRITTEN = 4
# Groups of options in the help; (): all remaining ones.
GROUPS: dict[str, tuple[str, ...]] = {
    "Arguments": ("scenario",),
    "The mission": (),
    "A simulated world": ("world", "tag_spacing", "start"),
    "A real robot, or a run": ("robot", "port", "preset", "bridge", "tags", "scan", "skip_checks"),
    "To look at it": ("headless", "host", "page_port", "meshcat"),
}
# The help's last paragraph.
ENDS = (
    "Example: tfg-drake explore house --seed 3 --realtime-rate 8. Exit codes: 0 ended as it should; 1 stuck or apart; "
    "2 bad input; 3 something failed; 4 nothing could be written; 130, 143, 129 interrupted."
)


def explore(
    scenario: Annotated[
        str | None, argument(None, "A shipped scenario or a YAML file [default: paper, or that of a replay].")
    ] = None,
    world: command.World = None,
    tag_spacing: command.TagSpacing = None,
    start: command.Start = None,
    method: Annotated[
        str, option("NAME", "Exploration method: tfg, grid-nearest, ... or a Python file with MakeExplorer.")
    ] = "tfg",
    robot: Annotated[
        str,
        option("NAME", "The robot: sim, a real one (kobuki, ros2, rosbridge), or a recorded run, replay:RUN_DIR."),
    ] = "sim",
    port: Annotated[str | None, option("DEVICE", "The Kobuki's serial port.")] = None,
    preset: Annotated[str | None, option("NAME", "The robot on ROS: turtlebot2, 3, 4 or a YAML file.")] = None,
    bridge: Annotated[str | None, option("HOST:PORT", "The rosbridge server.")] = None,
    tags: Annotated[
        str | None,
        option(
            "SOURCE",
            "Source of tags: none, ros2:/TOPIC, rosbridge:HOST:PORT/TOPIC, socket:HOST:PORT, camera:DEVICE.",
        ),
    ] = None,
    scan: Annotated[
        str | None,
        option("SOURCE", "Source of scans: ros2:, rosbridge: or socket: as for tags, rplidar:DEVICE, realsense:."),
    ] = None,
    skip_checks: Annotated[
        bool, flag("--skip-checks", "Do not check battery, sensors and clocks before the wheels may be enabled.")
    ] = False,
    seed: Annotated[int | None, option("N", "Seed of all random numbers.", callback=command.checked_seed)] = None,
    known_map: Annotated[
        Path | None, option("MAP", "Begin with a map of the building: a file or the folder of a run.", "--map")
    ] = None,
    at: Annotated[
        str | None,
        option("X,Y,YAW", "The robot's pose in that map, m and rad; append its deviations if not 0.5 m and 0.3 rad."),
    ] = None,
    headless: Annotated[bool, flag("--headless", "Serve no page.")] = False,
    meshcat: Annotated[bool, flag("--meshcat", "Also draw the mission in Drake's Meshcat.")] = False,
    host: command.Host = "localhost",
    page_port: command.PagePort = None,
    realtime_rate: Annotated[
        float, option("R", "At most R simulated seconds per second; 0: no limit.", callback=command.checked_rate)
    ] = 0.0,
    max_time: command.MaxTime = 3600.0,
    settings: command.Settings = None,
    resume: Annotated[Path | None, option("RUN", "Continue an interrupted mission from its folder.")] = None,
    out: Annotated[Path | None, option("DIR", "The run's folder [default: runs/<time>-<scenario>-<seed>].")] = None,
    as_json: command.AsJson = False,
) -> None:
    """Explore a building and map it."""
    replayed = replayed_run(robot)
    links = {"port": port, "preset": preset, "bridge": bridge, "tags": tags, "scan": scan}
    place = {"--world": world, "--tag-spacing": tag_spacing, "--start": start}
    if resume is not None:
        given = {"scenario": scenario, **place, "--seed": seed, "--set": settings, "--robot": replayed}
        method = method_resumed(resume, method, robot, given | {"--map": known_map, "--at": at})
    check_robot(robot, links, place, realtime_rate, checked=not skip_checks)
    if method == "manual":  # A person drives in real time.
        realtime_rate = realtime_rate or 1.0
    with contextlib.ExitStack() as page_stack, contextlib.ExitStack() as stack:
        # Without a terminal nothing is printed before all input is checked.
        show: Callable[[str], None] = stack.enter_context(Screen("loading" if sys.stdout.isatty() else ""))

        from tfg_drake.diagrams.methods import NamedMethod
        from tfg_drake.diagrams.missions.mission import MissionRequest
        from tfg_drake.diagrams.missions.resume import cut_short
        from tfg_drake.diagrams.scenario import PrepareScenario

        scenario = scenario or ("paper" if replayed is None else str(replayed / "scenario.yaml"))
        if resume is None:
            of_world = world, tag_spacing, command.parse_start(start)
            with run_folder.remarks_on_screen():
                loaded = PrepareScenario(scenario, settings or [], seed, *of_world, known_map, parse_at(at))
            command.make_ready(out, replayed, [Path(file) for file in (scenario, world) if file is not None])
            name = run_folder.run_name(scenario, world, robot)
            request = MissionRequest(loaded, name=name, world_name=str(world or scenario), out_dir=out)
        else:
            if out is not None and out.resolve() != resume.resolve():
                command.make_ready(out)
            request = cut_short(resume, out).request
            loaded = request.scenario
        if robot != "sim" and replayed is None:
            link(loaded, robot, links)
        explorer = NamedMethod("--method", method, loaded, settings or [])
        loaded = explorer.Fixed(loaded)
        if explorer.needs_keys and robot != "sim":
            bad_input(f"--method {explorer.name}: is for a simulated robot; leave --robot out")
        cockpit, real = None, robot in ROBOTS
        if not real:
            driven = unreal_robot(robot, replayed, loaded)
        if not headless:
            from tfg_drake.diagrams.missions.page import open_page

            title, of_clock = f"{request.name}, seed {loaded.seed}", None if real else realtime_rate
            cockpit = page_stack.enter_context(open_page(title, host, page_port, rate=of_clock, preview=not real))
            show = also_on_page(show, cockpit)
        show("loading")
        # Before the heavy imports: the compiling processes share the machine's time and memory.
        wait_for_kernels(show, command.interruption)
        if explorer.needs_keys:
            explorer = stack.enter_context(keys_of_driver(explorer, cockpit))
        if robot == "sim" and not loaded.world.tags and loaded.explorer.landmarks == "tags":
            say("There is no tag in this world, so no landmark to map; --tag-spacing places some")

        from tfg_drake.diagrams.missions.run import run_mission

        stack.enter_context(run_folder.remarks_on_screen())
        if real:
            from tfg_drake.diagrams.missions.real_robot import OpenRobot

            opened = OpenRobot(loaded, explorer, command.interruption, checked=not skip_checks)
            driven, loaded = stack.enter_context(opened)
        result = run_mission(
            request,
            scenario=loaded,
            method=explorer,
            robot=driven,
            meshcat=open_meshcat() if meshcat else None,
            cockpit=cockpit,
            realtime_rate=realtime_rate,
            max_time=max_time,
            on_progress=lambda progress: show(progress.line),
            interrupted=command.interruption,
        )
        stack.close()
        again = [f"--robot {robot}"] * real + [f"--method {shlex.quote(method)}"] * bool(explorer.source)
        _tell(result, again)
        if cockpit is not None and sys.stdin.isatty() and sys.stdout.isatty():
            command.wait_for_enter()
    code = command.EXIT_CODES[
        "stuck" if isinstance(result.mission.failure, EstimateLost) else result.summary["outcome"]
    ]
    is_kept = not result.unwritten.keys() & {"map.npz", "grid.npz", "summary.json"}
    command.end(result.summary, code if is_kept else NOT_WRITTEN, as_json)


def _tell(result: RunResult, again: list[str]) -> None:
    """Print the closing table of a mission. again: the options that are to be given again to go on with it."""
    from tfg_drake.cockpit.page import FILE_NAME
    from tfg_drake.diagrams.missions.summary_words import table_rows
    from tfg_drake.storage.checkpoint import FILE_NAME as CHECKPOINT

    rows = table_rows(result.summary)
    rows += [("not whole", f"{name}: {reason}") for name, reason in result.unwritten.items()]
    rows.append(("files", str(result.folder)))
    if (result.folder / CHECKPOINT).exists():
        rows.append(("go on", " ".join(["tfg-drake explore --resume", shlex.quote(str(result.folder)), *again])))
    command.print_rows([*rows, ("page", str(result.folder / FILE_NAME))])
    if result.summary["outcome"] == "fault":
        lost = isinstance(result.mission.failure, EstimateLost)
        log = "" if lost else f"; the traceback is in {result.folder}/log.txt"
        print(f"tfg-drake: {command.one_line(result.summary['reason'])}{log}", file=sys.stderr)


def parse_at(text: str | None) -> list[float] | None:
    """Return x, y (m) and yaw (rad) of --at, with the deviations of position (m) and yaw (rad)."""
    if text is None:
        return None
    form = "X,Y,YAW,SIGMA_M,SIGMA_RAD" if text.count(",") > 2 else "X,Y,YAW"
    place = [*parse_place("--at", text, form), 0.5, 0.3][:5]
    if min(place[3:]) <= 0.0:
        bad_input(f"--at {text}: its deviations must be greater than 0")
    return place


def replayed_run(robot: str) -> Path | None:
    """Return the folder of the run to replay, None for other robots. Raises BadInput if it holds no run."""
    if not robot.startswith("replay:"):
        return None
    folder = Path(robot.removeprefix("replay:"))
    if not (folder / "scenario.yaml").is_file():
        bad_input(f"--robot {robot}: there is no scenario.yaml; name the folder of a run")
    return folder


def method_resumed(run: Path, method: str, robot: str, given: dict[str, Any]) -> str:
    """Return the method of a resumed mission. Raises BadInput if there is none, if an option is given that the run
    determines, or if one is missing that a checkpoint must not supply: a real robot, or a file of code."""
    from tfg_drake.storage.checkpoint import read_told

    told = read_told(run)
    for named, value in given.items():
        if value is not None:
            bad_input(f"{named}: is that of the run which is resumed; leave it out")
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
    """Set a scenario's real robot and the given links, and clear its simulated world. Raises DeviceError if a link is
    invalid."""
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
    """Raise BadInput if options for simulated robots are given for a real one, or vice versa."""
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
    for named, given in place.items():
        if given is not None:
            bad_input(f"{named}: is for a simulated robot; leave it out")
    if realtime_rate and robot in ROBOTS:
        bad_input("--realtime-rate: a real robot's time is real; leave it out")


def unreal_robot(name: str, replayed: Path | None, scenario: Scenario) -> Robot:
    """Return the simulated robot, or the one that replays a run. Raises BadInput if that run has another world."""
    from tfg_drake.diagrams.robots import SIMULATED

    if replayed is None:
        return SIMULATED

    from tfg_drake.diagrams.recorded_station import ReplayRobot
    from tfg_drake.diagrams.scenario import LoadScenario
    from tfg_drake.storage.port_recording import read_recording

    robot, of_run = ReplayRobot(read_recording(replayed)), replayed / "scenario.yaml"
    if robot.world_known and scenario.world != LoadScenario(of_run).world:
        bad_input(f"--robot {name}: that run's world is another; leave the scenario out, or base it on {of_run}")
    return robot


@contextlib.contextmanager
def keys_of_driver(method: Method, cockpit: Cockpit | None) -> Iterator[Method]:
    """Return the method manual, driven by the keys of standard input and of the page, if there is one."""
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
    """Start a Meshcat that serves this machine only, and print its address."""
    from pydrake.common import use_native_cpp_logging
    from pydrake.geometry import Meshcat, MeshcatParams

    # The server logs when it ends. Through Python's logging it would wait for the GIL, which the destructor holds while
    # it waits for the server. The address that it logs is printed here.
    logging.getLogger("drake").setLevel(logging.ERROR)
    with contextlib.suppress(RuntimeError):  # Drake's log is set up already.
        use_native_cpp_logging()
    meshcat = Meshcat(MeshcatParams(host="localhost", show_stats_plot=False))
    say(f"Meshcat: {meshcat.web_url()}")
    return meshcat


def also_on_page(show: Callable[[str], object], cockpit: Cockpit) -> Callable[[str], None]:
    """Wrap show so that its lines also go to the page until the mission begins."""

    def both(word: str) -> None:
        show(word)
        if not cockpit.begun:
            cockpit.word = word

    return both
