"""`tfg-drake camera`: checks a camera's tag detection, and calibrates it. Needs no Drake."""

from __future__ import annotations

import io
import itertools
import json
import math
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tfg_drake.diagrams.commands import command
from tfg_drake.diagrams.commands.command import argument, bad_input, flag, option, parse_place, positive, writing

if TYPE_CHECKING:
    from tfg_drake.datasets.recording import Recording
    from tfg_drake.messages import FloatArray, TagDetections
    from tfg_drake.vision.calibration import CameraCalibration
    from tfg_drake.vision.image import Image
    from tfg_drake.vision.mount import CameraMount

# For a live source: number of views of the board that suffice; least interval between searches, or pictures, s.
LIVE_VIEWS, LIVE_EVERY = 25, 0.5

Source = Annotated[
    str, argument("SOURCE", "A folder of images, an image, a video, a stream's address or a camera's device or number.")
]

camera_app = command.group("camera", "Check a camera's tag detection, or calibrate it.")


@camera_app.command()
def check(
    source: Source,
    calibration: Annotated[Path, option("FILE", "The camera's calibration, OpenCV's YAML or ROS's camera_info.")],
    tag_size: Annotated[float, positive("M", "Side of the tags' black square.", "m")],
    family: Annotated[list[str] | None, option("NAME", "Tag family; repeatable [default: tag36h11].")] = None,
    mount: Annotated[
        str, option("X,Y,YAW,PITCH", "Pose of the camera on the robot, m and rad; pitch is downward.")
    ] = "0,0,0,0",
    margin: Annotated[float, option("G", "Reject tags with a smaller decision margin.")] = 30.0,
    decimation: Annotated[float, option("N", "Image decimation; 1 detects smaller tags in four times the time.")] = 2.0,
    threads: Annotated[int, option("N", "Threads of the detector.")] = 1,
    frames: Annotated[int | None, option("N", "Stop after N frames.", min=1)] = None,
    out: Annotated[
        Path | None, option("FILE", "Draw the newest frame in this file; into a folder, draw every frame.")
    ] = None,
    as_json: Annotated[
        bool, flag("--json", "Print one line of JSON per frame on standard output, nothing else.")
    ] = False,
) -> None:
    """Print the tags that a camera sees, with ranges, bearings and their deviations, and what is wrong."""
    _need_packages()
    from tfg_drake.vision.annotated import annotated
    from tfg_drake.vision.frames import frames as all_frames
    from tfg_drake.vision.frames import is_live
    from tfg_drake.vision.sighting import TagSizes, sighted
    from tfg_drake.vision.tag_detector import DetectorConfig, TagDetector

    where, known = _mount(mount), _calibration(calibration)
    with command.naming("", ValueError):
        detector = TagDetector(DetectorConfig(tuple(family or ("tag36h11",)), threads, decimation))
    into_folder = out is not None and out.suffix == ""
    told: set[str] = set()
    live, count, seen, spent, begin, drawn = is_live(source), 0, 0, 0.0, time.monotonic(), -math.inf
    try:
        for frame in itertools.islice(all_frames(source, _tell), frames):
            started = time.perf_counter()
            tags = detector.detect(frame.image)
            sighting = sighted(tags, frame.stamp, known, TagSizes(tag_size), where, least_margin=margin)
            spent += time.perf_counter() - started
            count, seen = count + 1, seen + len(sighting.detections.ids)
            rate = f"{count / max(time.monotonic() - begin, 1e-9):.1f} frames/s, {1000.0 * spent / count:.0f} ms each"
            if as_json:
                print(json_line(sighting.detections), flush=True)
            else:
                print(f"{frame.name}: {_row(sighting.detections)}", flush=True)
            for remark in sighting.remarks:
                # Print it once for a live camera, which repeats it in every frame.
                if not (live and remark in told):
                    print(f"{frame.name}: {remark}", file=sys.stderr, flush=True)
                told.add(remark)
            if out is not None and (into_folder or not live or time.monotonic() - drawn > LIVE_EVERY):
                drawing = annotated(frame.image, tags, sighting, [frame.name, rate])
                _write(drawing, out / f"{Path(frame.name).stem}.png" if into_folder else out)
                drawn = time.monotonic()
    except KeyboardInterrupt:
        pass
    if not as_json and count:
        picture = f"; picture in {out}" if out is not None else ""
        print(f"{count} frames, {seen} tags, {1000.0 * spent / count:.0f} ms a frame{picture}")


@camera_app.command()
def calibrate(
    source: Source,
    board: Annotated[str, option("CxR", "Inner corners of the chessboard, along and down.")],
    square: Annotated[float, positive("M", "Side of a square.", "m")],
    out: Annotated[Path, option("FILE", "The calibration, as ROS's camera_info YAML.")],
) -> None:
    """Calibrate a camera from views of a chessboard; show it tilted, near, and at the edges of the image."""
    _need_packages()
    from tfg_drake.vision.calibration import save_calibration
    from tfg_drake.vision.chessboard import calibrated

    columns, rows = _board(board)
    views, size = _views(source, columns, rows)
    with command.naming(f"{source}: ", ValueError):
        result = calibrated(views, columns, rows, square, size)
    with writing(f"--out {out}"):
        save_calibration(out, result.calibration)
    matrix = result.calibration.matrix
    print(f"{'views':<14}{result.views}")
    print(f"{'error':<14}{result.error:.2f} pixels")
    print(f"{'focal length':<14}{matrix[0, 0]:.1f}, {matrix[1, 1]:.1f} +- {result.focal_sigma:.1f} pixels")
    print(f"{'axis':<14}{matrix[0, 2]:.1f}, {matrix[1, 2]:.1f} pixels")
    print(f"{'file':<14}{out}")
    for remark in result.remarks:
        print(remark, file=sys.stderr)


def json_line(detections: TagDetections) -> str:
    """Return one frame as a line: stamp, s; ids; range and its deviation, m; bearing and its deviation, rad."""
    names = ("ids", "range", "bearing", "sigma_range", "sigma_bearing")
    return json.dumps({"stamp": detections.stamp, **{name: getattr(detections, name).tolist() for name in names}})


def video_loader(
    calibration: Path, tag_size: float, mount: str, odometry: Path | None, show: Callable[[str], object]
) -> Callable[[Path], Recording]:
    """Return a loader of a video or a folder of images for `tfg-drake slam`, with the options given there."""
    _need_packages()
    from tfg_drake.datasets.video import load_video

    where, known = _mount(mount), _calibration(calibration)
    return lambda source: load_video(
        str(source), known, tag_size, where, odometry, lambda count: show(f"looking for tags: {count} frames")
    )


def _row(detections: TagDetections) -> str:
    columns = (detections.ids, detections.range, detections.bearing, detections.sigma_range, detections.sigma_bearing)
    tags = [
        f"tag {i} at {r:.3f} +- {s:.3f} m, {math.degrees(b):+.2f} +- {math.degrees(t):.2f} deg"
        for i, r, b, s, t in zip(*(column.tolist() for column in columns), strict=True)
    ]
    return "; ".join(tags) or "no tag"


def _need_packages() -> None:
    """End the command if the extra `camera` is not installed."""
    # Otherwise OpenCV prints many lines for one complaint.
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
    with command.installed("camera"):
        import robotpy_apriltag  # noqa: F401


def _tell(line: str) -> None:
    print(line, file=sys.stderr)


def _views(source: str, columns: int, rows: int) -> tuple[list[FloatArray], tuple[int, int]]:
    """Return the corners of the board in each view that differs from the others, and the image size, pixels."""
    from tfg_drake.vision.chessboard import MOST_VIEWS, board_corners, is_new_view
    from tfg_drake.vision.frames import frames, is_live

    views: list[FloatArray] = []
    size, looked, live = (0, 0), -math.inf, is_live(source)
    try:
        for frame in frames(source, _tell):
            if live and time.monotonic() - looked < LIVE_EVERY:
                continue
            looked = time.monotonic()
            height, width = frame.image.shape[:2]
            size = size if size[0] else (width, height)
            if (width, height) != size:
                said = f"{width} x {height} pixels, not {size[0]} x {size[1]} as the first; left out"
                print(f"{frame.name}: {said}", file=sys.stderr)
                continue
            corners = board_corners(frame.image, columns, rows)
            if corners is None:
                print(f"{frame.name}: no board of {columns}x{rows} inner corners in sight", file=sys.stderr)
            elif is_new_view(corners, views, width):
                views.append(corners)
                print(f"{frame.name}: view {len(views)}", flush=True)
            if len(views) >= (LIVE_VIEWS if live else MOST_VIEWS):
                break
    except KeyboardInterrupt:
        pass
    return views, size


def _board(text: str) -> tuple[int, int]:
    columns, _, rows = text.partition("x")
    if not (columns.isdigit() and rows.isdigit() and 3 <= int(columns) <= 50 and 3 <= int(rows) <= 50):
        bad_input(f"--board {text}: must be the numbers of inner corners, 3 to 50, such as 9x6")
    return int(columns), int(rows)


def _calibration(path: Path) -> CameraCalibration:
    from tfg_drake.vision.calibration import CalibrationError, load_calibration

    with command.naming("--calibration ", CalibrationError):
        return load_calibration(path)


def _mount(text: str) -> CameraMount:
    from tfg_drake.vision.mount import CameraMount

    x, y, yaw, pitch = parse_place("--mount", text, "X,Y,YAW,PITCH")
    return CameraMount(x=x, y=y, yaw=yaw, pitch=pitch)


def _write(picture: Image, path: Path) -> None:
    """Write a picture atomically, as another program may be showing the file."""
    import PIL.Image

    from tfg_drake.io.files import write_atomic

    buffer = io.BytesIO()
    with writing(f"--out {path}"):
        path.parent.mkdir(parents=True, exist_ok=True)
        PIL.Image.fromarray(picture).save(buffer, "JPEG" if path.suffix.lower() in (".jpg", ".jpeg") else "PNG")
        write_atomic(path, buffer.getvalue(), durable=False)
