"""Maps of rendered image sequences, against where the tags were rendered."""

import json
import math
import shutil
import subprocess
import sys

import numpy as np
import pytest

from tests.cameras import pinhole
from tests.vision.rendering import cv2, render
from tfg_drake.datasets.recording import DatasetError
from tfg_drake.datasets.video import load_video, read_poses
from tfg_drake.geometry.alignment import align
from tfg_drake.geometry.se2 import transform
from tfg_drake.mapfile.saved_map import load_map
from tfg_drake.storage.trajectory import read_tum, write_tum
from tfg_drake.vision.calibration import CameraCalibration, save_calibration
from tfg_drake.vision.mount import CameraMount

SIZE = 0.16
MATRIX = np.array([[300.0, 0.0, 160.0], [0.0, 300.0, 120.0], [0.0, 0.0, 1.0]])
CALIBRATION = CameraCalibration(320, 240, MATRIX, "plumb_bob", np.zeros(0))
# Where tags hang in W, m, and the headings of their normals, rad: on three walls round the camera, all at its height.
TAGS = {
    3: ((3.0, 0.8), math.pi),
    4: ((3.0, 0.0), math.pi),
    5: ((3.0, -0.8), math.pi),
    6: ((2.2, 1.5), -0.5 * math.pi),
    7: ((1.0, 1.5), -0.5 * math.pi),
    8: ((2.2, -1.5), 0.5 * math.pi),
    9: ((1.0, -1.5), 0.5 * math.pi),
}
FRAMES = 60


def pose(k):
    """X_WB of frame k: forward and back on a curve while the camera looks left and right."""
    share = 2.0 * math.pi * k / FRAMES
    return np.array([0.4 - 0.4 * math.cos(share), 0.15 * math.sin(share), 0.75 * math.sin(2.0 * share)])


def in_view(p, X_WB):
    d = np.array(p) - X_WB[:2]
    c, s = math.cos(X_WB[2]), math.sin(X_WB[2])
    ahead, left = c * d[0] + s * d[1], -s * d[0] + c * d[1]
    return ahead > 0.4 and abs(left) < 0.5 * ahead, ahead, left


def frame(k):
    X_WB, tags = pose(k), []
    for tag, (p, facing) in TAGS.items():
        seen, ahead, left = in_view(p, X_WB)
        turned = facing - math.pi - X_WB[2]  # 0: it faces the camera
        if seen and abs(math.atan2(math.sin(turned), math.cos(turned))) < 1.2:
            c, s = math.cos(turned), math.sin(turned)
            # T is x right, y down, z away; turned to the left, as is counter-clockwise from above.
            R_CT = np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])
            tags.append((tag, R_CT, np.array([-left, 0.0, ahead]), SIZE))
    return render(tags, CALIBRATION, seed=k)


@pytest.fixture(scope="module")
def video(tmp_path_factory):
    """A folder with the images, ten a second, the file of the calibration and the true way as TUM and CSV."""
    folder = tmp_path_factory.mktemp("video")
    (folder / "images").mkdir()
    for k in range(FRAMES):
        cv2.imwrite(str(folder / "images" / f"{0.1 * k:.1f}.png"), frame(k))
    save_calibration(folder / "camera.yaml", CALIBRATION)
    stamps, X_WB = 0.1 * np.arange(FRAMES), np.array([pose(k) for k in range(FRAMES)])
    write_tum(folder / "odometry.tum", stamps, X_WB)
    rows = "".join(f"{t:.3f},{x:.6f},{y:.6f},{a:.6f}\n" for t, (x, y, a) in zip(stamps, X_WB, strict=True))
    (folder / "odometry.csv").write_text("time,x,y,heading\n" + rows)
    return folder


def slam(call, video, out, *more):
    code, printed, complaint = call(
        "slam", video / "images", "--calibration", video / "camera.yaml", "--tag-size", SIZE, "--out", out, *more
    )
    assert (code, complaint) == (0, ""), complaint
    return printed


def errors(saved):
    """Distances, m, of the landmarks from where they were rendered, after alignment."""
    p_WT = np.array([TAGS[int(tag)][0] for tag in saved.ids])
    return np.hypot(*(transform(align(p_WT, saved.p_ML), saved.p_ML) - p_WT).T)


def test_a_video_alone_gives_the_map_the_covariances_and_the_way(call, video, tmp_path):
    out = tmp_path / "run"
    slam(call, video, out)
    saved = load_map(out / "map.npz")
    assert saved.ids.tolist() == list(TAGS)
    assert errors(saved).max() < 0.03
    deviation = np.sqrt(np.trace(saved.landmark_covariance, axis1=1, axis2=2))
    assert ((deviation > 1e-3) & (deviation < 0.2)).all()
    stamps, X_MB = read_tum(out / "trajectory.tum")
    true = np.array([pose(round(10.0 * t)) for t in stamps])
    off = transform(align(true[:, :2], X_MB[:, :2]), X_MB[:, :2]) - true[:, :2]
    assert np.sqrt(np.mean(np.sum(off**2, axis=1))) < 0.05  # where one tag alone is in view it is known to no better
    picture = cv2.imread(str(out / "figure.png")).astype(int)
    blue_over_red = picture[..., 0] - picture[..., 2]
    # The smoothed path and the online one, landmarks and words.
    assert np.count_nonzero(blue_over_red > 40) >= 10
    assert np.count_nonzero(blue_over_red < -40) >= 100
    assert np.count_nonzero(picture.min(axis=2) < 200) >= 600
    assert (out / "landmarks.csv").read_text().count("\n") == len(TAGS) + 1
    assert json.loads((out / "summary.json").read_text())["landmarks_mapped"] == len(TAGS)


def test_odometry_is_used_where_there_is_any(call, video, tmp_path):
    slam(call, video, tmp_path / "run", "--odometry", video / "odometry.csv")
    assert errors(load_map(tmp_path / "run" / "map.npz")).max() < 0.03
    stamps, X_OB, _ = read_poses(video / "odometry.csv")
    same = read_poses(video / "odometry.tum")
    np.testing.assert_allclose(stamps, same[0], atol=1e-6)
    np.testing.assert_allclose(X_OB, same[1], atol=1e-5)


def test_images_a_second_apart_by_their_count(call, video, tmp_path):
    """Nothing is known of the way from one image to the next."""
    (tmp_path / "images").mkdir()
    for k in range(0, FRAMES, 2):
        (tmp_path / "images" / f"p{k}.png").symlink_to(video / "images" / f"{0.1 * k:.1f}.png")
    calibration = ["--calibration", video / "camera.yaml", "--tag-size", SIZE]
    code, printed, said = call("slam", tmp_path / "images", *calibration, "--out", tmp_path / "run")
    assert (code, said) == (0, "")
    assert "names tell no time; images taken as 1 s apart" in printed
    saved = load_map(tmp_path / "run" / "map.npz")
    assert saved.ids.tolist() == list(TAGS)
    assert errors(saved).max() < 0.05


@pytest.mark.parametrize("name", ["one_second_apart", "a.gif"])
def test_the_images_found_give_a_map(name, call, shared_data, tmp_path):
    folder = shared_data("reports") / "video"
    calibration = ["--calibration", folder / "cal.yaml", "--tag-size", SIZE]
    code, _, said = call("slam", folder / name, *calibration, "--out", tmp_path / "run")
    assert (code, said) == (0, "")
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert summary["landmarks_mapped"] > 0
    assert summary["measurements_rejected"] == 0


def test_a_video_without_times_is_told_how_to_get_them(monkeypatch, tmp_path):
    """Bare H.264, of which OpenCV says 0 for every frame."""
    path = str(tmp_path / "film.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"MJPG"), 10.0, (320, 240))
    for k in range(3):
        writer.write(cv2.cvtColor(frame(k), cv2.COLOR_GRAY2BGR))
    writer.release()

    class Capture:
        def __init__(self, source):
            self._capture = real(source)

        def get(self, _key):
            return 0.0

        def __getattr__(self, name):
            return getattr(self._capture, name)

    real = cv2.VideoCapture
    monkeypatch.setattr(cv2, "VideoCapture", Capture)
    with pytest.raises(DatasetError, match=r"frame 1 is not later .*; give it its rate, as in ffmpeg -r 30 -i in.h264"):
        load_video(path, CALIBRATION, SIZE, CameraMount())


def bare_h264(images):
    """Images (96, 128), bytes from 16 to 235, as an H.264 stream of plain macroblocks without any times."""
    stream = bytes.fromhex("000000016742000af841a2 0000000168ce3880")
    for image in images:
        stream += bytes.fromhex("0000000105888421a0")
        for row in range(0, 96, 16):
            for column in range(0, 128, 16):
                luminance = np.clip(image[row : row + 16, column : column + 16], 16, 235).astype(np.uint8)
                stream += (b"\x0d\x00" if row or column else b"") + luminance.tobytes() + 128 * b"\x80"
        stream += b"\x80"
    return stream


def test_a_bare_h264_stream_is_told_how_to_get_its_rate(call, tmp_path):
    small = pinhole(128, 96, 110.0)
    images = [render([(3, np.eye(3), np.array([0.01 * k, 0.0, 0.35]), SIZE)], small, seed=k) for k in range(4)]
    (tmp_path / "film.h264").write_bytes(bare_h264(images))
    save_calibration(tmp_path / "camera.yaml", small)
    calibration = ["--calibration", tmp_path / "camera.yaml", "--tag-size", SIZE]
    assert call("slam", tmp_path / "film.h264", *calibration, "--out", tmp_path / "run") == (
        2,
        "",
        f"tfg-drake: {tmp_path}/film.h264: frame 1 is not later than the one before; give it its rate, as in ffmpeg -r"
        " 30 -i in.h264 -c copy out.mp4, and name out.mp4\n",
    )
    # The images themselves are read.
    assert call("camera", "check", tmp_path / "film.h264", *calibration)[1].count("tag 3 at 0.3") == 4


PEAK = """
import resource, sys
from pathlib import Path
from tfg_drake.datasets.video import load_video, read_poses
from tfg_drake.vision.calibration import load_calibration
from tfg_drake.vision.mount import CameraMount
found = load_video(sys.argv[1], load_calibration(Path(sys.argv[2])), 0.16, CameraMount())
print(len(found.detections), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["film", "images"])
def test_ten_minutes_take_no_more_memory_than_one(kind, video, tmp_path):
    """At five images a second; all of ten minutes would be 0.7 GB."""

    def peak(count):
        source = tmp_path / f"{count}"
        if kind == "film":
            source = source.with_suffix(".avi")
            writer = cv2.VideoWriter(str(source), cv2.VideoWriter_fourcc(*"MJPG"), 5.0, (320, 240))
            shown = [cv2.cvtColor(frame(k), cv2.COLOR_GRAY2BGR) for k in range(FRAMES)]
            for k in range(count):
                writer.write(shown[k % FRAMES])
            writer.release()
        else:
            source.mkdir()
            for k in range(count):
                (source / f"{0.2 * k:.1f}.png").symlink_to(video / "images" / f"{0.1 * (k % FRAMES):.1f}.png")
        arguments = [sys.executable, "-c", PEAK, str(source), str(video / "camera.yaml")]
        done = subprocess.run(arguments, capture_output=True, text=True, check=True)
        seen, peak = map(int, done.stdout.split())
        assert seen > 0.9 * count
        return peak

    assert peak(3000) < 1.05 * peak(300)


def test_odometry_of_another_clock_is_refused(video, tmp_path):
    write_tum(tmp_path / "late.tum", 1000.0 + np.arange(3.0), np.zeros((3, 3)))
    (tmp_path / "images").mkdir()
    for name in ("0.0.png", "5.9.png"):
        shutil.copy(video / "images" / name, tmp_path / "images")
    with pytest.raises(DatasetError, match=r"reaches from 1000.0 to 1002.0 s, the frames from 0.0 to 5.9 s"):
        load_video(str(tmp_path / "images"), CALIBRATION, SIZE, CameraMount(), tmp_path / "late.tum")


def test_images_without_a_tag_are_refused(tmp_path):
    cv2.imwrite(str(tmp_path / "0.png"), np.full((240, 320), 128, dtype=np.uint8))
    with pytest.raises(DatasetError, match="no tag in 1 frames; is it of the family tag36h11, and sharp"):
        load_video(str(tmp_path), CALIBRATION, SIZE, CameraMount())


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--tag-size", "0.16"], "slam: a video needs both --calibration FILE and --tag-size M"),
        (["--odometry", "a.tum"], "--odometry a.tum: goes with a video; give --calibration FILE and --tag-size M, too"),
        (["--calibration", "none.yaml", "--tag-size", "0.16"], "--calibration none.yaml: cannot be read"),
        (["--calibration", "none.yaml", "--tag-size", "0"], "--tag-size 0: must be greater than 0 m"),
    ],
)
def test_bad_input_is_one_line(call, video, arguments, complaint):
    code, _, said = call("slam", video / "images", *arguments)
    assert code == 2
    assert complaint in said
    assert said.count("\n") == 1
