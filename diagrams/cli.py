"""The commands of `tfg-drake`. Everything heavy is imported when it is needed."""

from __future__ import annotations

import contextlib
import functools
import gc
import io
import json
import locale
import math
import os
import resource
import shlex
import shutil
import signal
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from tfg_drake import __version__
from tfg_drake.bad_input import BadInput, EstimateLost
from tfg_drake.config import ROBOTS
from tfg_drake.diagrams.commands import explore as explore_command
from tfg_drake.diagrams.commands.camera import camera_app, video_loader
from tfg_drake.diagrams.commands.command_line import (
    bad_input,
    check_positive,
    grouped_help,
    interruption,
    parse_place,
    wait_for_enter,
)
from tfg_drake.diagrams.commands.kobuki import kobuki_app
from tfg_drake.diagrams.commands.map import map_app
from tfg_drake.diagrams.commands.options import AsJson, PagePort, Settings, argument, flag, option
from tfg_drake.diagrams.commands.ros import ros2_app
from tfg_drake.diagrams.commands.tags import tags_app
from tfg_drake.diagrams.compile_kernels import wait_for_kernels
from tfg_drake.diagrams.missions import run_folder
from tfg_drake.diagrams.screen import Screen, say
from tfg_drake.mission.interruption import NAMES

if TYPE_CHECKING:
    from tfg_drake.diagrams.methods import Method
    from tfg_drake.diagrams.missions.run import RunResult
    from tfg_drake.diagrams.scenario import Scenario

# Tags nearer to each other than this would lie on top of one another, m.
LEAST_SPACING = 0.05
EXIT_CODES = {
    "complete": 0,
    "budget": 0,
    "battery": 0,
    "time_limit": 0,
    "stuck": 1,
    "apart": 1,
    "fault": 3,
    "interrupted": 130,
}
# The map or the summary could not be written.
NOT_WRITTEN = 4

# Commands that a signal ends with all that they have written; others it ends at once.
WRITING = ("explore", "compare", "fork", "slam", "figures")
# Address space that a command needs at least, bytes: its libraries take two thirds of it.
LEAST_MEMORY = 2**30

# What the parser raises for a command line it cannot read; typer has no name of its own for it.
_UsageError: Any = typer.BadParameter.__base__

# How the options of `explore` are told; (): those that are in no other group.
_GROUPS: dict[str, tuple[str, ...]] = {
    "Arguments": ("scenario",),
    "The mission": (),
    "A simulated world": ("world", "tag_spacing", "start"),
    "A real robot, or a run": ("robot", "port", "preset", "bridge", "tags", "scan", "skip_checks"),
    "To look at it": ("headless", "host", "page_port", "meshcat"),
}

# Options of several commands.
World = Annotated[Path | None, option("FILE", "Other walls: a scenario, a map_server .yaml or a *.vectormap.txt.")]


def _spacing(text: str) -> float:
    """Metres between tags, inf for none."""
    try:
        return math.inf if text == "none" else float(text)
    except ValueError:
        raise typer.BadParameter(f"{text!r} is neither a distance in metres nor none") from None


TagSpacing = Annotated[
    float | None,
    option("M|none", "Place tags along every reachable surface, this far apart, or none at all.", parser=_spacing),
]
Start = Annotated[str | None, option("X,Y,YAW", "Where to start in W, m and rad.")]
MaxTime = Annotated[float, option("S", "Give up after S simulated seconds.")]
RunArgument = Annotated[Path, argument("RUN", "The folder of a run.")]
Host = Annotated[str, option("ADDRESS", "Where the page is served; 0.0.0.0 for other computers, too.")]

app = typer.Typer(
    context_settings={"help_option_names": ["-h", "--help"]}, rich_markup_mode=None, pretty_exceptions_enable=False
)
app.add_typer(map_app, name="map")
app.add_typer(kobuki_app, name="kobuki")
app.add_typer(ros2_app, name="ros2")
app.add_typer(camera_app, name="camera")
app.add_typer(tags_app, name="tags")


def _print_version(asked: bool) -> None:
    if asked:
        print(f"tfg-drake {__version__}")
        raise typer.Exit


@app.callback(invoke_without_command=True)
def _commands(
    context: typer.Context,
    _version: Annotated[bool, flag("--version", "Print the version.", callback=_print_version, is_eager=True)] = False,
) -> None:
    """Active SLAM on topological feature graphs: a robot explores and maps an unknown building on its own."""
    if context.invoked_subcommand is None:
        print(context.get_help(), file=sys.stderr)
        raise typer.Exit(2)
    if context.invoked_subcommand in WRITING:
        interruption.first, interruption.again = _tell_interruption, _leave


# Below the options of explore.
_EXPLORE_ENDS = (
    "Example: tfg-drake explore house --seed 3 --realtime-rate 8. Exit codes: 0 ended as it should; 1 stuck or apart; "
    "2 bad input; 3 something failed; 4 nothing could be written; 130, 143, 129 interrupted."
)


@app.command(cls=grouped_help(_GROUPS), epilog=_EXPLORE_ENDS)
def explore(
    scenario: Annotated[
        str | None, typer.Argument(help="A shipped scenario or a YAML file [default: paper, or that of a replay].")
    ] = None,
    world: World = None,
    tag_spacing: TagSpacing = None,
    start: Start = None,
    method: Annotated[
        str, option("NAME", "What explores: tfg, grid-nearest, ... or a Python file that makes one.")
    ] = "tfg",
    robot: Annotated[
        str, option("NAME", "What to drive: sim, a real robot (kobuki, ros2, rosbridge) or a run: replay:RUN_DIR.")
    ] = "sim",
    port: Annotated[str | None, option("DEVICE", "The Kobuki's serial port.")] = None,
    preset: Annotated[str | None, option("NAME", "The robot on ROS: turtlebot2, 3, 4 or a YAML file.")] = None,
    bridge: Annotated[str | None, option("HOST:PORT", "The rosbridge server.")] = None,
    tags: Annotated[
        str | None,
        option(
            "SOURCE",
            "A real robot's tags: none, ros2:/TOPIC, rosbridge:HOST:PORT/TOPIC, socket:HOST:PORT, camera:DEVICE.",
        ),
    ] = None,
    scan: Annotated[str | None, option("SOURCE", "Its scans, likewise, or rplidar:DEVICE or realsense:.")] = None,
    skip_checks: Annotated[
        bool, flag("--skip-checks", "Do not check battery, sensors and clocks before it may be enabled.")
    ] = False,
    seed: Annotated[int | None, option("N", "Every random number comes from it.")] = None,
    known_map: Annotated[
        Path | None, option("MAP", "Begin with a map of the building, a file or the folder of a run.", "--map")
    ] = None,
    at: Annotated[
        str | None,
        option(
            "X,Y,YAW", "Where in that map the robot is, m and rad, and how sure that is, if not to 0.5 m and 0.3 rad."
        ),
    ] = None,
    headless: Annotated[bool, flag("--headless", "No page that shows it.")] = False,
    meshcat: Annotated[bool, flag("--meshcat", "Draw it in Drake's Meshcat, too.")] = False,
    host: Host = "localhost",
    page_port: PagePort = None,
    realtime_rate: Annotated[float, option("R", "At most R simulated seconds a second; 0 for no limit.")] = 0.0,
    max_time: MaxTime = 3600.0,
    settings: Settings = None,
    resume: Annotated[Path | None, option("RUN", "Go on with a mission that was cut short, from its folder.")] = None,
    out: Annotated[Path | None, option("DIR", "The run's folder [default: runs/<time>-<scenario>-<seed>].")] = None,
    as_json: AsJson = False,
) -> None:
    """Explore a building and map it, until nothing is left to gain."""
    check_positive("--max-time", max_time, "s")
    _check_rate_and_seed(realtime_rate, seed)
    _check_spacing(tag_spacing)
    replayed = explore_command.replayed_run(robot)
    links = {"port": port, "preset": preset, "bridge": bridge, "tags": tags, "scan": scan}
    place = {"--world": world, "--tag-spacing": tag_spacing, "--start": start}
    if resume is not None:
        given = {"scenario": scenario, **place, "--seed": seed, "--set": settings, "--robot": replayed}
        given |= {"--map": known_map, "--at": at}
        method = explore_command.resumed(resume, method, robot, given)
    explore_command.check_robot(robot, links, place, realtime_rate, checked=not skip_checks)
    if method == "manual":  # Nobody drives faster.
        realtime_rate = realtime_rate or 1.0
    with contextlib.ExitStack() as page_stack, contextlib.ExitStack() as stack:
        show: Callable[[str], None] = stack.enter_context(Screen())
        if sys.stdout.isatty():  # Elsewhere nothing is said before all that was given is known to do.
            show("loading")
        from tfg_drake.diagrams.missions.resume import cut_short
        from tfg_drake.diagrams.scenario import PrepareScenario

        scenario = scenario or ("paper" if replayed is None else str(replayed / "scenario.yaml"))
        name, before = run_folder.run_name(scenario, world, robot), None
        if resume is None:
            known = [] if known_map is None else [f"explorer.known_map={known_map.resolve()}"]
            known += [] if at is None else [f"explorer.known_at={_told_place(at)}"]
            loaded = PrepareScenario(scenario, [*(settings or []), *known], seed, world, tag_spacing, _start(start))
            _make_ready(out, replayed, [Path(file) for file in (scenario, world) if file is not None])
        else:
            if out is not None and out.resolve() != resume.resolve():
                _make_ready(out)
            before = cut_short(resume, out)
            loaded, out, name, scenario = before.scenario, before.folder, before.name, before.world_name
        if robot != "sim" and replayed is None:
            explore_command.link(loaded, robot, links)
        explorer = _find_method(method, loaded)
        if explorer.needs_keys and robot != "sim":
            bad_input(f"--method {explorer.name}: is for a simulated robot; leave --robot out")
        cockpit, real = None, robot in ROBOTS
        if not real:
            driven = explore_command.unreal_robot(robot, loaded)
        if not headless:
            from tfg_drake.diagrams.missions.page import open_page

            title, rate = f"{name}, seed {loaded.seed}", None if real else realtime_rate
            cockpit = page_stack.enter_context(open_page(title, host, page_port, rate=rate, preview=not real))
            show = explore_command.also_on_page(show, cockpit)
        show("loading")
        # Before this process imports the rest: it shares the machine's time and memory with those who compile.
        wait_for_kernels(show, interruption)
        if explorer.needs_keys:
            explorer = stack.enter_context(explore_command.keys_of_driver(explorer, cockpit))
        if robot == "sim" and not loaded.world.tags and loaded.explorer.landmarks == "tags":
            say("There is no tag in this world, so no landmark to map; --tag-spacing places some")

        from tfg_drake.diagrams.missions import run
        from tfg_drake.diagrams.missions.mission import MissionRequest

        stack.enter_context(run_folder.remarks_on_screen())
        if real:
            from tfg_drake.diagrams.missions.real_robot import OpenRobot

            opened = OpenRobot(loaded, explorer, interruption, checked=not skip_checks)
            driven, loaded = stack.enter_context(opened)
        request = MissionRequest(
            loaded,
            method=explorer,
            robot=driven,
            name=name,
            world_name=str(world or scenario) if driven.world_known else "unknown",
            meshcat=explore_command.open_meshcat() if meshcat else None,
            cockpit=cockpit,
            realtime_rate=realtime_rate,
            max_time=max_time,
            out_dir=out,
            on_progress=lambda progress: show(explore_command.progress_line(progress)),
            interrupted=interruption,
            before=None if before is None else before.state,
        )
        result = run.run_mission(request)
        stack.close()
        _tell(result)
        if cockpit is not None and sys.stdin.isatty() and sys.stdout.isatty():
            wait_for_enter()
    code = EXIT_CODES["stuck" if isinstance(result.mission.failure, EstimateLost) else result.summary["outcome"]]
    _end(result.summary, code if explore_command.is_kept(result.unwritten) else NOT_WRITTEN, as_json)


def _end(summary: dict[str, Any], code: int, as_json: bool) -> NoReturn:
    """Ends a command whose run has a summary."""
    if as_json:
        print(json.dumps(summary), flush=True)
    raise typer.Exit(code)


def _tell(result: RunResult) -> None:
    """The closing table of a mission."""
    from tfg_drake.cockpit.page import FILE_NAME
    from tfg_drake.diagrams.missions.summary_words import table_rows

    rows = table_rows(result.summary)
    rows += [("not whole", f"{name}: {reason}") for name, reason in result.unwritten.items()]
    rows += [("files", str(result.folder)), ("page", str(result.folder / FILE_NAME))]
    for name, value in rows:
        print(f"{name:<12}{value}", flush=True)
    if result.summary["outcome"] == "fault":
        log = (
            "" if isinstance(result.mission.failure, EstimateLost) else f"; the traceback is in {result.folder}/log.txt"
        )
        print(f"tfg-drake: {_one_line(result.summary['reason'])}{log}", file=sys.stderr)


@app.command()
def view(
    run: RunArgument,
    host: Host = "localhost",
    port: PagePort = None,
) -> None:
    """Show a mission that has ended, or is under way, with a slider for the time."""
    from tfg_drake.diagrams.commands.view import serve_run

    serve_run(run, host, port)


@app.command()
def export(
    run: RunArgument,
    out: Annotated[Path, argument("OUT", "The file to write: .html, .gif, .mp4.")],
) -> None:
    """Write a mission as one page that needs nothing else, with a slider for the time, or as a film."""
    from tfg_drake.diagrams.commands.view import export_run

    export_run(run, out)


@app.command()
def compare(
    scenario: Annotated[str, typer.Argument(help="A shipped scenario or a YAML file.")] = "paper",
    world: World = None,
    tag_spacing: TagSpacing = None,
    start: Start = None,
    methods: Annotated[
        str, option("NAME,...", "What to compare; the others are compared with the first.")
    ] = "tfg,tfg-nearest,grid-nearest",
    seeds: Annotated[int, option("N", "Every method runs on the seeds 0 to N - 1.")] = 10,
    max_time: MaxTime = 3600.0,
    settings: Settings = None,
    jobs: Annotated[int | None, option("N", "Missions at a time [default: 1].")] = None,
    ray: Annotated[str | None, option("ADDRESS", "Run on a Ray cluster; local starts one here.")] = None,
    out: Annotated[Path | None, option("DIR", "The folder [default: runs/<time>-compare-<scenario>].")] = None,
) -> None:
    """Compare methods on the same seeds, and report; in the same DIR it goes on where it ended."""
    check_positive("--max-time", max_time, "s")
    _check_spacing(tag_spacing)
    if seeds < 1:
        bad_input(f"--seeds {seeds}: must be 1 or more")
    for setting in settings or []:
        if setting.split("=")[0].strip() == "seed":
            bad_input(f"--set {setting}: the seeds are 0 to one less than --seeds; leave it out")
    if jobs is not None and jobs < 1:
        bad_input(f"--jobs {jobs}: must be 1 or more")
    if jobs is not None and ray is not None:
        bad_input("--jobs and --ray exclude each other; a cluster knows how many missions it can run")

    with Screen() as show:
        show("loading")

        from tfg_drake.diagrams.commands import compare as compare_command
        from tfg_drake.diagrams.missions import comparison_report
        from tfg_drake.diagrams.missions.sweep import Task, parse_methods
        from tfg_drake.diagrams.scenario import PrepareScenario

        name = run_folder.run_name(scenario, world)
        place = _start(start)
        of_seed = [PrepareScenario(scenario, settings or [], seed, world, tag_spacing, place) for seed in range(seeds)]
        sources = parse_methods(methods, of_seed[0])
        names = list(sources)
        # All methods of a seed before the next seed, so that a partial report compares like with like.
        world_name = scenario if world is None else str(world)
        tasks = [Task(method, one, name, world_name, max_time, sources[method]) for one in of_seed for method in names]
        if out is not None:
            _make_writable(out)
        folder = run_folder.make_run_folder(out, f"compare-{name}")
        wait_for_kernels(show, interruption)
        spacing = "none" if tag_spacing == math.inf else tag_spacing
        given = [("--world", world), ("--tag-spacing", spacing), ("--start", start), ("--methods", methods)]
        given += [("--seeds", seeds), ("--max-time", f"{max_time:g}"), *(("--set", one) for one in settings or [])]
        words = [str(word) for option, value in given if value is not None for word in (option, value)]
        command = shlex.join(["tfg-drake", "compare", scenario, *words])
        with run_folder.claimed(folder):
            runs = compare_command.run_sweep(tasks, folder, jobs or 1, ray, interruption, show)
            comparison_report.write_comparison(runs, tasks, folder, command, show)
    for line in compare_command.closing_lines(runs, names):
        print(line)
    print(f"report: {folder / 'report.html'}")
    if interruption.is_set():
        raise typer.Exit(EXIT_CODES["interrupted"])
    raise typer.Exit(EXIT_CODES["fault"] if any(not run.counts for run in runs) else 0)


@app.command()
def fork(
    run: Annotated[Path, argument("RUN", "The folder of a simulated run.")],
    stage: Annotated[int, option("N", "The stage whose goal is another.")],
    goal: Annotated[str | None, option("X,Y", "Drive there instead, in W, m, to the place next to it.")] = None,
    candidate: Annotated[int | None, option("K", "Or to this of the stage's candidates, 1 for the most gain.")] = None,
    out: Annotated[
        Path | None, option("DIR", "The fork's folder [default: runs/<time>-<scenario>-fork-<seed>].")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Say what a run would have done: drive it anew to a stage, on to another goal, and compare the two."""
    if goal is not None and candidate is not None:
        bad_input("--goal and --candidate exclude each other; name one of them")
    place = None if goal is None else parse_place("--goal", goal, "X,Y")
    _make_ready(out)
    with Screen() as show:
        show("loading")
        wait_for_kernels(show, interruption)

        from tfg_drake.diagrams.commands import fork as fork_command
        from tfg_drake.diagrams.methods import METHODS
        from tfg_drake.diagrams.missions import fork as forks
        from tfg_drake.diagrams.missions.mission import MissionRequest
        from tfg_drake.diagrams.missions.run import run_mission

        before, loaded = forks.forkable(run, stage)
        if out is not None and out.resolve() == run.resolve():
            bad_input(f"--out {out}: holds the run that is forked; name another folder")
        change, summary = forks.Fork(stage, place, candidate), before.summary
        # A run that somebody or a limit of time ended ends there again.
        limited = summary["outcome"] in ("time_limit", "interrupted")
        request = MissionRequest(
            loaded,
            method=METHODS[summary["method"]],
            name=f"{summary['scenario']}-fork",
            world_name=summary["world"],
            max_time=summary["sim_time_s"] if limited else 3600.0,
            out_dir=out,
            on_progress=lambda progress: show(explore_command.progress_line(progress)),
            interrupted=interruption,
            monitor=change.monitor,
        )
        result = run_mission(request)
        if change.failure is not None:
            if out is None:
                shutil.rmtree(result.folder)  # Nothing of it is of use.
            raise change.failure
        forks.check_same(before, result.stages, stage)
    for line in fork_command.aligned(fork_command.candidate_rows(change.candidates)):
        print(line)
    print()
    for line in fork_command.aligned(fork_command.difference_rows(dict(summary), result.summary)):
        print(line)
    print(f"files: {result.folder}")
    _end(result.summary, EXIT_CODES[result.summary["outcome"]], as_json)


@app.command()
def slam(
    dataset: Annotated[
        Path,
        typer.Argument(
            help="A ROS bag with scans and odometry, a laser log of CARMEN or BreezySLAM, an MR.CLAM or TagSLAM "
            "folder, a .g2o file or, with --calibration, a video or folder of images."
        ),
    ],
    robot: Annotated[int | None, option("N", "The robot to map with, if there are several.")] = None,
    calibration: Annotated[
        Path | None, option("FILE", "A video's camera calibration: OpenCV's YAML or ROS's camera_info.")
    ] = None,
    tag_size: Annotated[float | None, option("M", "Side of the tags' black square.")] = None,
    mount: Annotated[
        str, option("X,Y,YAW,PITCH", "The camera on what moves, m and rad; pitch is downward.")
    ] = "0,0,0,0",
    odometry: Annotated[
        Path | None, option("FILE", "A video's odometry: a TUM trajectory, or a CSV of time, x, y, heading.")
    ] = None,
    method: Annotated[
        str | None, option("walls|grid", "How to map a laser recording: walls as landmarks, or GMapping. [walls]")
    ] = None,
    relations: Annotated[
        Path | None, option("FILE", "Relations of poses to compare a laser recording's map with.")
    ] = None,
    odometry_noise: Annotated[
        float | None, option("K", "Odometry errors drawn for a corrected CARMEN log, times the usual. [1]")
    ] = None,
    seed: Annotated[
        int | None, option("N", "Seed of the drawn odometry errors and of GMapping's particles. [0]")
    ] = None,
    settings: Settings = None,
    page: Annotated[bool, flag("--page", "A page that shows how a laser recording is mapped.")] = False,
    meshcat: Annotated[bool, flag("--meshcat", "Draw that in Drake's Meshcat, too.")] = False,
    realtime_rate: Annotated[float, option("R", "At most R recorded seconds a second; 0 for no limit.")] = 0.0,
    out: Annotated[Path | None, option("DIR", "The run's folder [default: runs/<time>-<data set>].")] = None,
    as_json: AsJson = False,
) -> None:
    """Map what was recorded: a mission without wheels, of a laser recording, or the estimator alone on other data."""
    is_video = calibration is not None or tag_size is not None
    if is_video and (calibration is None or tag_size is None):
        bad_input("slam: a video needs both --calibration FILE and --tag-size M")
    if odometry is not None and not is_video:
        bad_input(f"--odometry {odometry}: goes with a video; give --calibration FILE and --tag-size M, too")
    if robot is not None and is_video:
        bad_input(f"--robot {robot}: is for MR.CLAM; a video has one camera")
    of_lasers: dict[str, Any] = {
        "--odometry-noise": odometry_noise,
        "--seed": seed,
        "--method": method,
        "--relations": relations,
    }
    of_lasers |= {"--set": settings, "--page": page, "--meshcat": meshcat}
    for name, value in of_lasers.items():
        if is_video and value:
            bad_input(f"{name} {value}: is for laser recordings; leave it out")
    _check_rate_and_seed(realtime_rate, seed)
    check_positive("--tag-size", tag_size, "m")
    check_positive("--odometry-noise", odometry_noise, "")
    _make_ready(out)
    with contextlib.ExitStack() as stack:
        show = stack.enter_context(Screen())
        show("loading")

        from tfg_drake.diagrams.commands import slam as slam_command
        from tfg_drake.hardware.recordings import load_recording

        progress = slam_command.Progress(show, interruption)
        load: Callable[[Path], Any]
        if calibration is not None and tag_size is not None:
            load = video_loader(calibration, tag_size, mount, odometry, progress.say)
        else:
            scanner, others = slam_command.scanner_settings(settings or [])
            load = functools.partial(load_recording, robot=robot, noise=odometry_noise, seed=seed, scanner=scanner)
            settings = others
        mapped: dict[str, Any] = {"seed": seed or 0, "realtime_rate": realtime_rate, "interrupted": interruption}
        if page:
            from tfg_drake.diagrams.missions.page import open_page

            mapped["cockpit"] = stack.enter_context(open_page(dataset.name, "localhost", None, rate=realtime_rate))
        if meshcat:
            mapped["meshcat"] = explore_command.open_meshcat()
        result = slam_command.run_slam(dataset, out, progress, load, method, relations, settings or [], **mapped)
    for name, value in [*slam_command.table_rows(result.summary), ("files", str(result.folder))]:
        print(f"{name:<14}{value}")
    _end(result.summary, EXIT_CODES[result.summary["outcome"]], as_json)


@app.command()
def figures(
    out: Annotated[Path, option("DIR", "Where to write them.")] = Path("figures"),
) -> None:
    """The paper's figures and tables from missions of our own: gains, priors, the TFG, its growth, maps, coverage,
    errors, a disturbance, Tables I and II, and paper.md, which sets each beside what the paper says."""
    _make_writable(out)
    with Screen() as show:
        show("loading")
        wait_for_kernels(show, interruption)

        from tfg_drake.diagrams.commands.figures import write_figures, write_tables

        def on_stage(stage: int, time: float) -> bool:
            show(f"the mission to draw: stage {stage}, {time:.0f} s")
            return interruption.is_set()

        with run_folder.claimed(out):
            files = write_figures(out, on_stage)
            if not interruption.is_set():
                files.append(write_tables(out, interruption, show))
    for file in files:
        print(file)
    if interruption.is_set():
        raise typer.Exit(EXIT_CODES["interrupted"])


def main(arguments: list[str] | None = None) -> None:
    """Run a command. Bad input is one line on standard error and exit code 2; there is never a traceback for it."""
    # So many objects come before somebody looks for garbage among them: importing libraries makes none, and to look
    # as often as usual takes a quarter of a second.
    gc.set_threshold(50_000)
    interruption.clear()
    interruption.first = interruption.again = signal.default_int_handler
    try:
        with interruption.heard():
            _check_environment()
            code = app(arguments, prog_name="tfg-drake", standalone_mode=False)
    except BadInput as error:
        code = _complain(str(error))
    except EstimateLost as error:
        _complain(str(error))
        code = EXIT_CODES["stuck"]
    except _UsageError as error:
        complaint = _one_line(error.format_message()).rstrip(".")
        command = error.ctx.command_path if error.ctx is not None else "tfg-drake"
        code = _complain(f"{complaint[:1].lower()}{complaint[1:]}; see {command} --help")
    except (KeyboardInterrupt, typer.Abort):
        code = EXIT_CODES["interrupted"]
    except BrokenPipeError:
        code = 141  # Whoever read our output has gone; nothing is left to say.
    except OSError as error:
        # What the machine refuses: a folder that is gone, one process or file too many.
        where = "" if error.filename is None else f"{error.filename}: "
        code = _complain(f"{where}{(error.strerror or str(error)).lower()}")
    except Exception as error:
        if isinstance(error, MemoryError) or "start new thread" in str(error):
            sys.exit(_complain("no memory or thread is left; end other programs, or raise the limits (ulimit -v, -u)"))
        # A mistake of ours outside the simulation, whose own end with outcome "fault".
        last = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{Path(last.filename).name}, line {last.lineno}"
        _complain(f"internal error: {type(error).__name__}: {error} ({place})")
        code = 3
    if code == EXIT_CODES["interrupted"] and interruption.is_set():
        code = 128 + interruption.number
    try:
        sys.stdout.flush()
    except OSError:
        # What is left to say has nowhere to go, at exit either, which would have a code of its own.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(code if isinstance(code, int) else 0)


def _check_environment() -> None:
    """Makes up for what the program was started without, if it can; else raises BadInput."""
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass  # A file that is opened must not be taken for a standard stream.
    os.close(descriptor)
    sys.stdin = sys.stdin or os.fdopen(0, encoding="utf-8")
    sys.stdout = sys.stdout or os.fdopen(1, "w", encoding="utf-8")
    sys.stderr = sys.stderr or os.fdopen(2, "w", encoding="utf-8")
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")
    # Drake reads its own files as the locale says, and they are UTF-8; other processes are told by PYTHONUTF8.
    if "utf" not in locale.getencoding().lower():
        os.environ["PYTHONUTF8"] = "1"
        with contextlib.suppress(locale.Error):
            locale.setlocale(locale.LC_CTYPE, "C.UTF-8")
    try:
        os.getcwd()
    except OSError as error:
        bad_input(f"the working directory: {(error.strerror or str(error)).lower()}; change to another")
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < LEAST_MEMORY:
        bad_input(f"ulimit -v: {limit / 1e6:.0f} MB of address space; raise it to {LEAST_MEMORY / 1e6:.0f} or more")


def _complain(line: str) -> int:
    """Says what is wrong; the exit code of bad input."""
    print(f"tfg-drake: {_one_line(line)}", file=sys.stderr)
    return 2


def _tell_interruption(number: int, _frame: Any) -> None:
    """A signal is only noted, so that it may come at any time, during imports too; the mission ends when it sees
    that."""
    _tell_at_once(f"stopping; {NAMES[signal.Signals(number)]} again leaves at once")


def _leave(number: int, _frame: Any) -> None:
    """The second one leaves at once: an exception might be lost in a callback or end in a traceback."""
    if keyboard := sys.modules.get("tfg_drake.hardware.keyboard"):
        keyboard.restore_terminals()
    _tell_at_once("interrupted; nothing more is written")
    os._exit(128 + number)


def _tell_at_once(line: str) -> None:
    with contextlib.suppress(OSError):  # The terminal may be gone.
        os.write(2, f"\ntfg-drake: {line}\n".encode())


def _one_line(message: str) -> str:
    """A message that may quote a file: no terminal takes what is in it for an order."""
    words = " ".join(message.split())
    return "".join(one if one.isprintable() else ascii(one)[1:-1] for one in words)


def _check_rate_and_seed(realtime_rate: float, seed: int | None) -> None:
    if not (math.isfinite(realtime_rate) and realtime_rate >= 0.0):
        bad_input(f"--realtime-rate {realtime_rate:g}: must be 0 (no limit) or more")
    if seed is not None and not 0 <= seed < 2**31:
        bad_input(f"--seed {seed}: must be between 0 and 2147483647")


def _check_spacing(tag_spacing: float | None) -> None:
    if tag_spacing != math.inf:
        check_positive("--tag-spacing", tag_spacing, "m")
    if tag_spacing is not None and tag_spacing < LEAST_SPACING:
        bad_input(f"--tag-spacing {tag_spacing:g}: must be {LEAST_SPACING:g} m at least; tags are no smaller")


def _make_ready(out: Path | None, replayed: Path | None = None, read: Sequence[Path] = ()) -> None:
    """Makes the folder of a run, if one is named; what is read may lie in it. Raises BadInput as `check_kept` does, and
    where it cannot be written."""
    if out is not None:
        run_folder.check_kept(out, replayed, [file for file in read if file.is_file()])
        _make_writable(out)


def _make_writable(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except FileExistsError:
        bad_input(f"--out {folder}: is a file; name a folder")
    except OSError as error:
        bad_input(f"--out {folder}: {(error.strerror or str(error)).lower()}; name a folder that can be written")
    if not os.access(folder, os.W_OK | os.X_OK):
        bad_input(f"--out {folder}: permission denied; name a folder that can be written")
    try:
        with run_folder.claimed(folder):
            pass  # Better now than when the robot is connected.
    except BlockingIOError as error:
        bad_input(f"--out {folder}: {error.strerror}")


def _start(text: str | None) -> list[float] | None:
    return None if text is None else parse_place("--start", text)


def _told_place(text: str) -> list[float]:
    """The place that --at says, x, y (m) and yaw (rad), with its deviations, m and rad."""
    given = text.count(",") + 1
    form = "X,Y,YAW,SIGMA_M,SIGMA_RAD" if given > 3 else "X,Y,YAW"
    place = [*parse_place("--at", text, form), 0.5, 0.3][:5]
    if min(place[3:]) <= 0.0:
        bad_input(f"--at {text}: its deviations must be greater than 0")
    return place


def _find_method(name: str, scenario: Scenario) -> Method:
    from tfg_drake.diagrams.methods import FindMethod, MethodError

    try:
        method = FindMethod(name)
        method.Check(scenario)
        return method
    except MethodError as error:
        bad_input(f"--method {error}")


if __name__ == "__main__":
    main()
