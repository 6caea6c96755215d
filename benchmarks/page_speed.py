"""How quickly the page shows a large map, live and any time of it afterwards, in Debian's chromium.

    python benchmarks/page_speed.py
    python benchmarks/page_speed.py --landmarks 1000 10000 --seconds 20

A building of rooms is made up, each with a tag every metre of its walls. Live: all of it is known, a robot drives
through it at real time and maps some more every two seconds; the pictures a second that a page draws meanwhile, CPU
milliseconds of the browser a picture, the longest time between two pictures, s, and CPU milliseconds a second that the
mission's program spends on page and timeline. Afterwards: the building was mapped room by room; the time, s, until
another time is shown after the slider has moved, median and most of --moves random ones, CPU milliseconds of the
browser for one, and megabytes of the page. Where other jobs run beside it only the CPU times tell something.
Pictures are drawn by the processor (software rendering). Needs chromium, chromium-driver and selenium.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np

from tfg_drake.cockpit.browser import SEEK, open_browser, wait_for_page
from tfg_drake.cockpit.page import export_page
from tfg_drake.cockpit.server import Cockpit
from tfg_drake.diagrams.missions.run import viewer_script
from tfg_drake.pictures.rows import Table
from tfg_drake.pictures.scene import POSITION
from tfg_drake.storage.timeline import TimelineWriter

ROOM = 6.0  # m, of a wall
TAGS = 20  # of a room
RATE = 8.0  # poses a second
STAGE = 2.0  # s
NEAR = 12.0  # m: what is nearer is mapped a little more accurately by a stage
STAR = 96  # corners

# Counts the pictures, each until its pixels are there, and notes the longest time between two.
COUNT = """window.drawn_ = 0; window.gap_ = 0; window.last_ = performance.now(); window.begun_ = window.last_;
const before_ = render;
render = () => {
  before_();
  const context = viewer.renderer.getContext();
  context.readPixels(0, 0, 1, 1, context.RGBA, context.UNSIGNED_BYTE, new Uint8Array(4));
  const now = performance.now();
  window.gap_ = Math.max(window.gap_, now - window.last_);
  window.last_ = now;
  window.drawn_++;
};"""
COUNTED = "return [window.drawn_, (performance.now() - window.begun_) / 1000, window.gap_ / 1000]"


class Building:
    """Rooms in a square, as a mission maps them: landmarks, pieces of wall, and what is seen from each room's views."""

    def __init__(self, landmarks: int) -> None:
        self.rng = np.random.default_rng(0)
        self.rooms = max(1, round(landmarks / TAGS))
        across = int(np.ceil(np.sqrt(self.rooms)))
        row, column = np.divmod(np.arange(self.rooms), across)
        column = np.where(row % 2 == 0, column, across - 1 - column)
        self.corner = ROOM * np.column_stack([column, row])
        along = (np.arange(TAGS // 4) + 0.5) * ROOM / (TAGS // 4)
        zero, far = np.full_like(along, 0.1), np.full_like(along, ROOM - 0.1)
        sides = [(along, zero), (far, along), (along, far), (zero, along)]
        tags = np.concatenate([np.column_stack(side) for side in sides])
        self.points = (self.corner[:, None] + tags).reshape(-1, 2)
        others = np.roll(self.points.reshape(self.rooms, TAGS, 2), -1, axis=1)
        self.segments = np.hstack([self.points, others.reshape(-1, 2)])
        self.kind = (self.rng.random(len(self.points)) < 0.1).astype(np.uint8)
        turn = np.linspace(0.0, 2.0 * np.pi, STAR, endpoint=False)
        reach = 0.5 * ROOM / np.maximum(np.abs(np.cos(turn)), np.abs(np.sin(turn)))
        ring = reach[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
        self.star = np.vstack([np.zeros((1, 2)), ring])

    def place(self, time: float) -> np.ndarray:
        """Where the robot is, m: to and fro through all rooms, half a metre a second."""
        way = 0.5 * time / ROOM
        room = int(way) % max(self.rooms - 1, 1)
        share = way - int(way)
        middle = self.corner[[room, min(room + 1, self.rooms - 1)]] + 0.5 * ROOM
        return (1.0 - share) * middle[0] + share * middle[1]

    def begin(self, writer: TimelineWriter) -> None:
        """The part that stays as it is."""
        camera = {"range": 3.0, "field_of_view": 2.1}
        writer.write("world", 0.0, {}, title="building", radius=0.18, rule="tour", simulated=True, camera=camera)
        writer.write("frame", 0.0, {"pose": np.zeros(3, dtype=np.float32)})
        writer.write("enabled", 0.0, {}, enabled=True)

    def drive(self, writer: TimelineWriter, now: float, place: np.ndarray) -> None:
        """Where the robot is, and what its scanner meets."""
        pose = np.array([*place, 0.3 * now % 6.0, 1e-4, 0.0, 1e-4, 1e-4], dtype=np.float32)
        writer.write("pose", now, {"pose": pose})
        writer.write("truth", now, {"pose": pose[:3] + np.float32(0.02)})
        writer.write("scan", now, {"rays": place + self.star, "met": np.ones(len(self.star) - 1, dtype=np.bool_)})

    def stage(self, writer: TimelineWriter, now: float, number: int, rooms: int, place: np.ndarray) -> None:
        """A look, of so many rooms: what is near the robot has become a little more accurate."""
        count = TAGS * rooms
        near = np.hypot(*(self.points - place).T) < NEAR
        self.points[near] += self.rng.normal(0.0, POSITION, (int(near.sum()), 2))
        covariance = np.tile(np.array([4e-4, 1e-4, 3e-4], dtype=np.float32), (count, 1))
        ids, doubtful = np.arange(count), np.arange(count) % 97 == 0
        points, segments = self.points[:count], self.segments[:count]
        tags = {"points": points, "covariance": covariance, "doubtful": doubtful, "ids": ids}
        walls = {"segments": segments, "kind": self.kind[:count]}
        told = {"stage": number, "entropy": -5.0 * count, "views": number}
        writer.write_rows("map", now, Table(tags, points / POSITION, ids), **told)
        writer.write_rows("tfg", now, Table(walls, segments / POSITION))
        some = segments[max(0, count - 200) :]
        writer.write_rows("frontiers", now, Table({"segments": some}, some / POSITION))
        middles = self.corner[:rooms] + 0.5 * ROOM
        share = self.rng.integers(0, 256, rooms).astype(np.uint8)
        writer.write("gains", now, {"points": middles, "share": share}, explained=[])
        writer.write("goal", now, {"points": middles[-1:]}, verdict="goal", reason="")
        writer.write("path", now, {"segments": np.hstack([place, middles[-1]])[None]})
        writer.write("mission", now, {}, phase="follow", stage=number, outcome="", reason="", drives=True)

    def seen(self, writer: TimelineWriter, now: float, first: int, last: int) -> None:
        """The floor of some rooms is seen."""
        index = np.arange(first, last)
        points = (self.corner[first:last, None] + 0.5 * ROOM + self.star).reshape(-1, 2)
        writer.write("free", now, {"index": index, "count": np.full(len(index), STAR + 1), "points": points})


class Live(threading.Thread):
    """A mission in a building that is all known, at real time; spent: CPU s of writing it."""

    def __init__(self, building: Building, path: Path, cockpit: Cockpit) -> None:
        super().__init__(daemon=True)
        self.over, self.spent = threading.Event(), 0.0
        self._building, self._path, self._cockpit = building, path, cockpit

    def run(self) -> None:
        """Until it is over."""
        building = self._building
        with TimelineWriter(self._path, lambda: self._cockpit.watched) as writer:
            building.begin(writer)
            building.seen(writer, 0.0, 0, building.rooms)
            self._cockpit.follow(self._path)
            begin, count = time.monotonic(), 0
            while not self.over.is_set():
                now, start = count / RATE, time.thread_time()
                place = building.place(now)
                if count % int(STAGE * RATE) == 0:
                    building.stage(writer, now, 1 + count // int(STAGE * RATE), building.rooms, place)
                building.drive(writer, now, place)
                writer.flush(all_of_it=False)
                self.spent += time.thread_time() - start
                count += 1
                self.over.wait(max(0.0, begin + count / RATE - time.monotonic()))


def cpu(driver: Any) -> float:
    """CPU s that the browser has taken, all of its processes together."""
    ticks, pids = 0, [driver.service.process.pid]
    while pids:
        pid = pids.pop()
        try:
            figures = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
            for task in Path(f"/proc/{pid}/task").iterdir():
                pids += map(int, (task / "children").read_text().split())
        except OSError:
            continue  # It has ended.
        ticks += int(figures[11]) + int(figures[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def live(driver: Any, building: Building, folder: Path, seconds: float) -> list[tuple[str, list[float]]]:
    """The picture from above and in space: pictures a second, CPU ms each, longest gap, s, and the CPU, ms a
    second, of the program that is looked at."""
    rows = []
    with Cockpit(viewer_script(), "building", rate=1.0) as cockpit:
        mission = Live(building, folder / "live.tfg", cockpit)
        mission.start()
        driver.get(cockpit.address)
        wait_for_page(driver)
        driver.execute_script(COUNT)
        for mode in ("from above", "in space"):
            time.sleep(3.0)
            driver.execute_script("drawn_ = gap_ = 0; last_ = begun_ = performance.now()")
            before, own = cpu(driver), time.process_time()
            time.sleep(seconds)
            drawn, passed, gap = driver.execute_script(COUNTED)
            spent = cpu(driver) - before
            own = 1e3 * (time.process_time() - own) / seconds
            rows.append((mode, [drawn / passed, 1e3 * spent / max(drawn, 1), gap, own]))
            driver.find_element("id", "mode").click()
        mission.over.set()
        mission.join()
    return rows


def afterwards(driver: Any, building: Building, folder: Path, moves: int) -> list[tuple[str, list[float]]]:
    """From above and in space: s until a time is shown, median and most, CPU ms for it, and megabytes of the page."""
    path, page = folder / "timeline.tfg", folder / "mission.html"
    with TimelineWriter(path) as writer:
        building.begin(writer)
        stages, seen = min(building.rooms, 100), 0
        for number in range(1, stages + 1):
            rooms = building.rooms * number // stages
            now, place = STAGE * number, building.corner[rooms - 1] + 0.5 * ROOM
            building.stage(writer, now, number, rooms, place)
            building.seen(writer, now, seen, rooms)
            for k in range(int(STAGE * RATE)):
                building.drive(writer, now + k / RATE, place)
            writer.flush()
            seen = rooms
    export_page(path, page, "building", viewer_script())
    driver.get(page.as_uri())
    wait_for_page(driver)
    rows, rng = [], np.random.default_rng(1)
    for mode in ("from above", "in space"):
        times = STAGE * stages * rng.random(moves)
        driver.execute_script(SEEK, float(times[0]))
        before = cpu(driver)
        spent = [driver.execute_script(SEEK, float(one)) for one in times[1:]]
        each = 1e3 * (cpu(driver) - before) / len(spent)
        rows.append((mode, [float(np.median(spent)), max(spent), each, 1e-6 * page.stat().st_size]))
        driver.find_element("id", "mode").click()
    return rows


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--landmarks", type=int, nargs="+", default=[10_000])
    parser.add_argument("--seconds", type=float, default=20.0, help="that the page is looked at")
    parser.add_argument("--moves", type=int, default=20, help="of the slider")
    parser.add_argument("--size", default="1280x860")
    options = parser.parse_args()
    width, height = map(int, options.size.split("x"))
    driver = open_browser(width, height)
    try:
        for landmarks in options.landmarks:
            with tempfile.TemporaryDirectory() as name:
                folder = Path(name)
                print(f"{landmarks} landmarks, live: pictures/s, CPU ms a picture, longest gap s, program's CPU ms/s")
                for mode, row in live(driver, Building(landmarks), folder, options.seconds):
                    print(f"  {mode:<12}" + "".join(f"{value:9.2f}" for value in row), flush=True)
                print(f"{landmarks} landmarks, afterwards: s until a time is shown, median and most; CPU ms; page MB")
                for mode, row in afterwards(driver, Building(landmarks), folder, options.moves):
                    print(f"  {mode:<12}" + "".join(f"{value:9.2f}" for value in row), flush=True)
            print("load:", *(f"{value:.1f}" for value in os.getloadavg()))
    finally:
        driver.quit()


if __name__ == "__main__":
    main()
