"""`tfg-drake slam`: maps a recording."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from tfg_drake.diagrams.commands import command
from tfg_drake.diagrams.commands.camera import video_loader
from tfg_drake.diagrams.commands.command import argument, bad_input, flag, option, positive
from tfg_drake.diagrams.commands.explore import open_meshcat
from tfg_drake.diagrams.screen import Screen


def slam(
    dataset: Annotated[
        Path,
        argument(
            None,
            "A ROS bag with scans and odometry, a laser log of CARMEN or BreezySLAM, an MR.CLAM or TagSLAM "
            "folder, a .g2o file or, with --calibration, a video or folder of images.",
        ),
    ],
    robot: Annotated[int | None, option("N", "Number of the robot, if the recording has several.")] = None,
    calibration: Annotated[
        Path | None, option("FILE", "Camera calibration of a video: OpenCV's YAML or ROS's camera_info.")
    ] = None,
    tag_size: Annotated[float | None, positive("M", "Side of the tags' black square.", "m")] = None,
    mount: Annotated[
        str, option("X,Y,YAW,PITCH", "Pose of the camera on the moving body, m and rad; pitch is downward.")
    ] = "0,0,0,0",
    odometry: Annotated[
        Path | None, option("FILE", "Odometry of a video: a TUM trajectory, or a CSV of time, x, y, heading.")
    ] = None,
    method: Annotated[
        str | None,
        option("walls|grid", "How to map a laser recording: walls as landmarks, or GMapping. [walls]"),
    ] = None,
    relations: Annotated[
        Path | None, option("FILE", "Reference relations between poses, for the errors of a laser recording.")
    ] = None,
    odometry_noise: Annotated[
        float | None, positive("K", "Factor on the odometry errors drawn for a corrected CARMEN log. [1]")
    ] = None,
    seed: Annotated[
        int | None,
        option(
            "N", "Seed of the drawn odometry errors and of GMapping's particles. [0]", callback=command.checked_seed
        ),
    ] = None,
    settings: command.Settings = None,
    page: Annotated[bool, flag("--page", "Show the mapping of a laser recording on a page.")] = False,
    meshcat: Annotated[bool, flag("--meshcat", "Show it in Drake's Meshcat.")] = False,
    realtime_rate: Annotated[
        float, option("R", "At most R recorded seconds per second; 0: no limit.", callback=command.checked_rate)
    ] = 0.0,
    out: Annotated[Path | None, option("DIR", "The run's folder [default: runs/<time>-<data set>].")] = None,
    as_json: command.AsJson = False,
) -> None:
    """Map a recording: a laser recording as a mission that plays it, other data by the estimator alone."""
    is_video = calibration is not None or tag_size is not None
    if is_video and (calibration is None or tag_size is None):
        bad_input("slam: a video needs both --calibration FILE and --tag-size M")
    if odometry is not None and not is_video:
        bad_input(f"--odometry {odometry}: goes with a video; give --calibration FILE and --tag-size M, too")
    if robot is not None and is_video:
        bad_input(f"--robot {robot}: is for MR.CLAM; a video has one camera")
    of_lasers = {"odometry-noise": odometry_noise, "seed": seed, "method": method, "relations": relations}
    for name, value in {**of_lasers, "set": settings, "page": page, "meshcat": meshcat}.items():
        if is_video and value:
            bad_input(f"--{name} {value}: is for laser recordings; leave it out")
    command.make_ready(out)
    from tfg_drake.hardware.ros.bag_files import is_bag

    with contextlib.ExitStack() as stack:
        show = stack.enter_context(Screen("loading"))

        def say(text: str) -> None:
            if command.interruption.is_set():
                raise KeyboardInterrupt  # There is no result.
            show(text)

        load: Callable[[Path], Any]
        # Missing options are reported before the slow imports.
        if calibration is not None and tag_size is not None:
            load = video_loader(calibration, tag_size, mount, odometry, say)
        elif is_bag(dataset):
            with command.installed("bag"):
                import rosbags  # noqa: F401

        from tfg_drake.diagrams.missions.slam import run_slam, scanner_settings, table_rows
        from tfg_drake.hardware.recordings import load_recording

        if not is_video:
            scanner, settings = scanner_settings(settings or [])
            load = functools.partial(load_recording, robot=robot, noise=odometry_noise, seed=seed, scanner=scanner)
        mapped: dict[str, Any] = {
            "seed": seed or 0,
            "realtime_rate": realtime_rate,
            "interrupted": command.interruption,
        }
        if page:
            from tfg_drake.diagrams.missions.page import open_page

            mapped["cockpit"] = stack.enter_context(open_page(dataset.name, "localhost", None, rate=realtime_rate))
        if meshcat:
            mapped["meshcat"] = open_meshcat()
        result = run_slam(dataset, out, say, load, method, relations, settings or [], **mapped)
    command.print_rows([*table_rows(result.summary), ("files", str(result.folder))], width=14)
    command.end(result.summary, command.EXIT_CODES[result.summary["outcome"]], as_json)
