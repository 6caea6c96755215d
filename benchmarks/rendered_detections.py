"""How far rendered detections are from the truth, over range and incidence, beside what they state and an ideal sensor.

    python benchmarks/rendered_detections.py --out rendered_detections.png

One tag of 16 cm on a wall, seen by the station's rendered camera from random headings at each range and incidence. The
ideal sensor is that of `paper`. Prints a row a range and incidence: the share of images in which the tag was found,
mean and deviation of the errors of range and bearing, and the deviations that were stated; draws all of them.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from tfg_drake.config import CameraConfig, CameraRealityConfig, TagSensorConfig
from tfg_drake.diagrams.rendered_eyes import LEAST_SIDE, TAG_NOISE
from tfg_drake.geometry.se2 import wrap_angle
from tfg_drake.messages import FloatArray, TagDetections
from tfg_drake.simulation.tag_sensor import NOISE_PER_TAG, detect
from tfg_drake.systems.rendered_world import MakeCameraInfo, WorldView
from tfg_drake.vision.camera_sheet import FIELD_OF_VIEW
from tfg_drake.vision.exposure import exposed
from tfg_drake.vision.mount import CameraMount
from tfg_drake.vision.sighting import TagSizes, sighted
from tfg_drake.vision.tag_detector import TagDetector
from tfg_drake.world.world import World

RANGES = np.arange(0.5, 5.01, 0.5)
INCIDENCES = (0, 30, 45, 60)
COLOURS = ("#0072B2", "#009E73", "#E69F00", "#D55E00")
# Greatest bearing of the tag from the robot's heading, rad.
ASIDE = 0.4
TAG = np.array([3.0, 0.0])
WORLD = World(np.array([[3.01, -9.0, 3.01, 9.0]]), np.array([7]), TAG[None], np.array([math.pi]), np.zeros(3))


class Rendered:
    """The station's camera."""

    def __init__(self) -> None:
        camera = CameraConfig()
        self._mount, self._sizes = CameraMount(z=camera.mount_height), TagSizes(camera.tag_size)
        info = MakeCameraInfo(camera.width, camera.height, FIELD_OF_VIEW)
        self._view, self._detector = WorldView(WORLD, self._mount, info), TagDetector()

    def see(self, X_WB: FloatArray, rng: np.random.Generator) -> TagDetections:
        image = exposed(self._view.image(X_WB), 0.0, CameraRealityConfig(), int(rng.integers(2**32)))
        tags = self._detector.detect(image)
        sheet = self._view.calibration, self._sizes, self._mount, TAG_NOISE
        return sighted(tags, 0.0, *sheet, least_side=LEAST_SIDE).detections


class Ideal:
    """The sensor of `paper`."""

    def see(self, X_WB: FloatArray, rng: np.random.Generator) -> TagDetections:
        return detect(WORLD, X_WB, 0.0, rng.normal(size=(1, NOISE_PER_TAG)), TagSensorConfig())


def errors(sensor: Rendered | Ideal, distance: float, incidence: int, count: int) -> FloatArray:
    """(n, 4) of the images with the tag: errors of range, m, and bearing, rad, and the deviations stated."""
    rng, rows = np.random.default_rng((round(100 * distance), incidence)), []
    for _ in range(count):
        aslant = math.radians(incidence) * rng.choice([-1.0, 1.0])
        at = TAG - distance * np.array([math.cos(aslant), math.sin(aslant)])
        bearing = rng.uniform(-ASIDE, ASIDE)
        seen = sensor.see(np.array([*at, aslant - bearing]), rng)
        if len(seen.ids):
            off = seen.range[0] - distance, float(wrap_angle(seen.bearing[0] - bearing))
            rows.append((*off, seen.sigma_range[0], seen.sigma_bearing[0]))
    return np.array(rows).reshape(-1, 4)


def draw(all_errors: dict[str, dict[tuple[float, int], FloatArray]]) -> Figure:
    """A column a sensor: range above, bearing below; each image a dot, lines what was stated."""
    figure = Figure(figsize=(10.0, 6.5), layout="constrained")
    axes = figure.subplots(2, len(all_errors), sharex=True, sharey="row")
    for column, (name, cells) in enumerate(all_errors.items()):
        for row, (factor, label) in enumerate(((1e3, "error of range (mm)"), (1e3, "error of bearing (mrad)"))):
            ax = axes[row, column]
            for k, (incidence, colour) in enumerate(zip(INCIDENCES, COLOURS, strict=True)):
                found = [(r, cells[r, incidence]) for r in RANGES.tolist() if len(cells[r, incidence])]
                for r, e in found:
                    x = r + 0.05 * (k - 1.5)
                    ax.plot(np.full(len(e), x), factor * e[:, row], ".", color=colour, markersize=3, alpha=0.5)
                x = [r for r, _ in found]
                stated = factor * np.array([e[:, 2 + row].mean() for _, e in found])
                ax.plot(x, stated, color=colour, linewidth=1.0, label=f"{incidence} degrees")
                ax.plot(x, -stated, color=colour, linewidth=1.0)
            ax.axhline(0.0, color="0.7", linewidth=0.6, zorder=0)
            ax.grid(color="0.92")
            ax.set_ylabel(label if column == 0 else "")
            if row == 0:
                ax.set_title(name)
    for ax in axes[-1]:
        ax.set_xlabel("true range (m)")
    axes[0, 0].legend(title="incidence; lines: stated deviation", fontsize=8, title_fontsize=8, loc="upper left")
    return figure


def main() -> None:
    """Measure, print and draw."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=20, help="a range and incidence")
    parser.add_argument("--out", type=Path, default=Path("rendered_detections.png"))
    options = parser.parse_args()
    measured = {}
    for name, sensor in (("rendered, 640 x 480, 65 degrees", Rendered()), ("ideal, as in paper", Ideal())):
        print(f"{name}\n range  incid.  found   range mm: mean   std stated   bearing mrad: mean   std stated   NEES")
        cells = measured[name] = {
            (r, i): errors(sensor, r, i, options.images) for i in INCIDENCES for r in RANGES.tolist()
        }
        for (r, i), e in cells.items():
            share = f"{r:5.1f} m {i:4d} deg {len(e) / options.images:6.2f}"
            if len(e):
                mean, std, stated = 1e3 * e[:, :2].mean(axis=0), 1e3 * e[:, :2].std(axis=0), 1e3 * e[:, 2:].mean(axis=0)
                nees = 0.5 * ((e[:, :2] / e[:, 2:]) ** 2).sum(axis=1).mean()
                share += f"{mean[0]:17.1f}{std[0]:6.1f}{stated[0]:7.1f}"
                share += f"{mean[1]:20.2f}{std[1]:6.2f}{stated[1]:7.2f}{nees:7.2f}"
            print(share)
        joint = np.concatenate(list(cells.values()))
        print(f"mean NEES of all: {0.5 * ((joint[:, :2] / joint[:, 2:]) ** 2).sum(axis=1).mean():.2f}\n")
    figure = draw(measured)
    FigureCanvasAgg(figure).print_png(str(options.out))
    print(options.out)


if __name__ == "__main__":
    main()
