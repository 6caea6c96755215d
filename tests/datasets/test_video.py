"""Odometry beside a video, however its file is written: the poses are the same, and one line says what was assumed."""

import re

import numpy as np
import pytest

from tests.mutations import assert_refused_or_read
from tests.vision.rendering import cv2  # noqa: F401
from tfg_drake.datasets.recording import DatasetError
from tfg_drake.datasets.video import read_poses

STAMPS = 0.1 * np.arange(40)
X_OB = np.column_stack([np.cos(STAMPS), np.sin(STAMPS), 0.5 + STAMPS / 2.0])


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("good.tum", ()),
        ("order.csv", ("order.csv: columns read as time, heading, x, y",)),
        ("semicolon.csv", ()),
        ("nonunit.tum", ("nonunit.tum: quaternions of length 2 to 2, normalised",)),
        ("ns.tum", ("ns.tum: stamps read as ns",)),
    ],
)
def test_the_same_drive_in_many_files(name, told, shared_data):
    folder = shared_data("reports") / "odometry"
    stamps, poses, notes = read_poses(folder / name)
    good = np.loadtxt(folder / "good.tum")
    np.testing.assert_allclose(stamps, good[:, 0], atol=1e-6)
    np.testing.assert_allclose(poses, np.column_stack([good[:, 1:3], np.zeros(len(good))]), atol=1e-6)
    assert tuple(one.text for one in notes) == told


def tum(length=1.0, unit=1.0, order=range(8), separator=" ", header=""):
    half = 0.5 * X_OB[:, 2]
    q = length * np.column_stack([0.0 * half, 0.0 * half, np.sin(half), np.cos(half)])
    table = np.column_stack([STAMPS / unit, X_OB[:, :2], 0.0 * half, q])[:, list(order)]
    return header + "".join(separator.join(f"{value:.9f}" for value in row) + "\n" for row in table)


@pytest.mark.parametrize(
    "text",
    [
        tum(),
        tum(length=0.5),
        tum(length=-300.0, unit=1e-3),
        tum(unit=1e-6, separator="\t"),
        tum(unit=1e-9, separator=";", order=(0, 1, 2, 3, 7, 4, 5, 6), header="#timestamp [ns];x;y;z;qw;qx;qy;qz\n"),
    ],
)
@pytest.mark.parametrize("name", ["odometry.tum", "odometry.csv"])
def test_quaternions_of_any_length_and_order(tmp_path, text, name):
    (tmp_path / name).write_text(text)
    stamps, poses, notes = read_poses(tmp_path / name)
    np.testing.assert_allclose(stamps, STAMPS, atol=1e-6)
    np.testing.assert_allclose(poses, X_OB, atol=1e-6)
    assert bool(notes) == (text != tum())


def test_a_quaternion_without_length_is_refused(tmp_path):
    (tmp_path / "odometry.tum").write_text(tum(length=0.0))
    complaint = f"{tmp_path}/odometry.tum: the quaternion at 0.000 s has no length; leave its row out"
    with pytest.raises(DatasetError, match="^" + re.escape(complaint)):
        read_poses(tmp_path / "odometry.tum")


@pytest.mark.parametrize("wrapped", [False, True])
@pytest.mark.parametrize("rate", [0.3, -1.0])
def test_headings_in_degrees_are_refused(tmp_path, wrapped, rate):
    def write(heading, half):
        heading = (heading + half) % (2.0 * half) - half if wrapped else heading
        rows = np.column_stack([0.1 * np.arange(200), np.zeros((200, 2)), heading])
        np.savetxt(tmp_path / "odometry.csv", rows, delimiter=",", header="time,x,y,heading")

    heading = rate * 0.1 * np.arange(200)
    write(heading, np.pi)
    assert len(read_poses(tmp_path / "odometry.csv")[0]) == 200
    write(np.degrees(heading), 180.0)
    with pytest.raises(DatasetError, match=r"the heading turns by \d+\.?\d* rad/s on average; write radians, not degr"):
        read_poses(tmp_path / "odometry.csv")


@pytest.mark.slow
def test_mutated_odometry_is_refused_or_read(tmp_path):
    file = tmp_path / "odometry.tum"
    file.write_text(tum(header="time x y z qx qy qz qw\n"))
    assert_refused_or_read(file, lambda: read_poses(file), DatasetError, count=1000)
