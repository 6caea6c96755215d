"""A page in Debian's chromium, without a window: for films, pictures and tests. Needs the `film` extra."""

from __future__ import annotations

import io
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tfg_drake.bad_input import BadInput
from tfg_drake.io.extras import pip_install
from tfg_drake.io.files import write_atomic

# Options of the browser: software rendering, no network, no dialogs.
OPTIONS = """--headless=new --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader
--no-first-run --disable-background-networking --disable-component-update --disable-sync --hide-scrollbars"""
# Move the slider as a user does; returns the time taken, s.
SEEK = """const start = performance.now(), slider = document.getElementById("slider");
slider.value = arguments[0];
slider.dispatchEvent(new Event("input"));
slider.dispatchEvent(new Event("change"));
const context = viewer.renderer.getContext();  // Until its pixels are there: nothing else waits for them.
context.readPixels(0, 0, 1, 1, context.RGBA, context.UNSIGNED_BYTE, new Uint8Array(4));
return (performance.now() - start) / 1000;"""
# A film shows only the picture and the time.
BARE = """for (const id of ["side", "view", "controls", "wheels"]) document.getElementById(id).style.display = "none";
document.querySelector("footer").style.display = "none";
window.dispatchEvent(new Event("resize"));
document.getElementById("fit").click();"""
# Size of a film, pixels. GIF: number of pictures, duration of each and of the last one, ms, number of colours.
SIZE = (800, 510)
GIF_FRAMES, SHOWN, LAST, COLOURS = 72, 130, 2500, 64
# MP4: number of pictures, their rate, 1/s, and codecs, of which the first that OpenCV has is used; browsers show VP9.
MP4_FRAMES, RATE, CODES = 240, 20.0, ("vp09", "mp4v")
# Greatest time to load a page, s.
PATIENCE = 60.0


class BrowserMissing(BadInput):
    """There is no browser to drive; the message says how to get one."""


def open_browser(width: int, height: int) -> Any:
    """Debian's chromium with a window of so many pixels, as selenium drives it; the caller quits it.

    Raises BrowserMissing where it, its driver or selenium is not installed, or it does not begin.
    """
    browser, service = shutil.which("chromium"), shutil.which("chromedriver")
    if browser is None or service is None:
        raise BrowserMissing("chromium or its driver is missing: apt-get install chromium chromium-driver")
    try:
        from selenium import common, webdriver
    except ImportError:
        raise BrowserMissing(f"the package selenium is missing: {pip_install('film')}") from None
    options = webdriver.ChromeOptions()
    options.binary_location = browser
    for option in (*OPTIONS.split(), f"--window-size={width},{height}"):
        options.add_argument(option)
    if os.geteuid() == 0:  # Chromium does not begin then with its sandbox.
        options.add_argument("--no-sandbox")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    os.environ["SE_OFFLINE"] = "true"
    try:
        return webdriver.Chrome(options=options, service=webdriver.ChromeService(service))
    except common.WebDriverException as error:
        raise BrowserMissing(f"chromium does not begin: {' '.join(str(error.msg).split())}") from None


def wait_for_page(driver: Any) -> None:
    """Until the page has been read. Raises TimeoutError where that takes too long."""
    end = time.monotonic() + PATIENCE
    while not driver.execute_script("return document.body.dataset.ready === 'true'"):
        if time.monotonic() > end:
            raise TimeoutError(f"the page is not ready: {driver.get_log('browser')}")
        time.sleep(0.02)


def film_page(page: Path, show: Callable[[str], object], frames: int) -> Iterator[Image.Image]:
    """The pictures of a film of a whole page's mission in space, from its beginning to its end.

    Args:
        page: the file, see tfg_drake.cockpit.page.
        show: is told how far it has come.
        frames: how many pictures it has.

    Raises:
        BrowserMissing: see `open_browser`.
    """
    driver = open_browser(*SIZE)
    try:
        driver.get(page.resolve().as_uri())
        wait_for_page(driver)
        driver.find_element("id", "mode").click()
        driver.execute_script(BARE)
        end = driver.execute_script("return timeline.end")
        for k in range(frames):
            show(f"filming the mission, picture {k + 1} of {frames}")
            driver.execute_script(SEEK, end * k / max(frames - 1, 1))
            yield Image.open(io.BytesIO(driver.get_screenshot_as_png())).convert("RGB")
    finally:
        driver.quit()


def write_gif(page: Path, out: Path, show: Callable[[str], object], frames: int = GIF_FRAMES) -> None:
    """Write a film as GIF; see `film_page`. Raises OSError where it cannot be written."""
    pictures = [one.quantize(COLOURS, dither=Image.Dither.NONE) for one in film_page(page, show, frames)]
    film, shown = io.BytesIO(), [SHOWN] * (len(pictures) - 1) + [LAST]
    pictures[0].save(film, "GIF", save_all=True, append_images=pictures[1:], duration=shown, loop=0, optimize=True)
    write_atomic(out, film.getvalue())


def write_mp4(page: Path, out: Path, show: Callable[[str], object], frames: int = MP4_FRAMES) -> None:
    """Write a film as MP4; see `film_page`. Raises OSError where it cannot be written."""
    import cv2

    with tempfile.TemporaryDirectory() as folder:
        file, writer = Path(folder) / "film.mp4", None
        for picture in film_page(page, show, frames):
            if writer is None:
                for code in CODES:
                    writer = cv2.VideoWriter(str(file), cv2.VideoWriter.fourcc(*code), RATE, picture.size)
                    if writer.isOpened():
                        break
            assert writer is not None
            writer.write(np.asarray(picture)[:, :, ::-1])
        if writer is not None:
            writer.release()
        if not file.exists() or not file.stat().st_size:
            raise OSError("OpenCV has no encoder for it")
        write_atomic(out, file.read_bytes())
