"""All figures of the docs, made anew by the code that is here (`make figures`): some twenty minutes.

    python benchmarks/figures.py
    python benchmarks/figures.py --only run page mission information_gain
    python benchmarks/figures.py --only laser_log --data FOLDER

Run, page and mission are of one mission in `paper`, comparison of --seeds missions of each of three methods there,
laser_log of a log in FOLDER, which is not the project's. Needs tfg_drake[film], chromium and chromium-driver.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from tfg_drake.diagrams.missions.paper_figures import GAIN_STAGE, write_figures

BENCHMARKS = Path(__file__).resolve().parent
METHODS = "tfg,tfg-nearest,grid-nearest"
# Simulated time of the page's screenshot, s: half of the building is known then.
MOMENT = 200


def call(*words: object) -> None:
    """A command of the program; raises CalledProcessError."""
    subprocess.run([sys.executable, "-m", "tfg_drake.diagrams.cli", *map(str, words)], check=True)


def measure(name: str, *words: object) -> None:
    """A benchmark; raises CalledProcessError."""
    subprocess.run([sys.executable, str(BENCHMARKS / name), *map(str, words)], check=True)


def made(name: str, folder: Path, seeds: int, data: Path | None) -> Path:
    """The file of a figure, made in a folder."""
    mission = folder / "mission"
    if name in ("run", "page", "mission") and not mission.exists():
        call("explore", "paper", "--seed", 0, "--headless", "--out", mission)
    match name:
        case "run":
            return mission / "figure.png"
        case "page":
            measure("screenshots.py", mission, "--times", MOMENT, "--out", folder)
            return folder / f"mission-3d-{MOMENT}.png"
        case "mission":
            call("export", mission, folder / "mission.gif")
            return folder / "mission.gif"
        case "information_gain":
            write_figures(folder, lambda stage, _time: stage > GAIN_STAGE)
            return folder / "information_gain.png"
        case "comparison":
            call("compare", "paper", "--methods", METHODS, "--seeds", seeds, "--out", folder / "compared")
            return folder / "compared/errors.png"
        case "laser_log":
            call("slam", f"{data}/carmen/intel-corrected.log.gz", "--out", folder / name)
            return folder / name / "figure.png"
    measure("rendered_detections.py", "--out", folder / f"{name}.png")
    return folder / f"{name}.png"


NAMES = ["run", "page", "mission", "information_gain", "rendered_detections", "comparison", "laser_log"]


def main() -> None:
    """Make the figures, each put in its place when it is whole."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=NAMES, default=NAMES)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--out", type=Path, default=BENCHMARKS.parent / "docs/figures")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        for name in options.only:
            if name == "laser_log" and options.data is None:
                print(f"{name}: needs --data", flush=True)
                continue
            file = made(name, Path(folder), options.seeds, options.data)
            print(shutil.copyfile(file, options.out / (name + file.suffix)), flush=True)


if __name__ == "__main__":
    main()
