"""A page in Debian's chromium, without a window: for films, pictures and tests. Needs the `film` extra."""

from __future__ import annotations

import io
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from PIL import Image

# Software rendering, no network, no questions.
OPTIONS = """--headless=new --no-sandbox --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader
--no-first-run --disable-background-networking --disable-component-update --disable-sync --hide-scrollbars"""
# What a hand on the slider does; how long it took, s.
SEEK = """const start = performance.now(), slider = document.getElementById("slider");
slider.value = arguments[0];
slider.dispatchEvent(new Event("input"));
slider.dispatchEvent(new Event("change"));
viewer.renderer.getContext().finish();
return (performance.now() - start) / 1000;"""
# Of a film only the picture is shown, and the time.
BARE = """for (const id of ["side", "view", "controls", "wheels"]) document.getElementById(id).style.display = "none";
document.querySelector("footer").style.display = "none";
window.dispatchEvent(new Event("resize"));
document.getElementById("fit").click();"""
# Pictures of a film, how long each is shown, and the last of them, ms, its colours and its size, pixels.
FRAMES, SHOWN, LAST, COLOURS, SIZE = 72, 130, 2500, 64, (800, 510)
# A page is read within so long, s.
PATIENCE = 60.0


class BrowserMissing(Exception):
    """There is no browser to drive; the message says how to get one."""


def open_browser(width: int, height: int) -> Any:
    """Debian's chromium with a window of so many pixels, as selenium drives it; the caller quits it.

    Raises BrowserMissing where it, its driver or selenium is not installed.
    """
    browser, service = shutil.which("chromium"), shutil.which("chromedriver")
    if browser is None or service is None:
        raise BrowserMissing("chromium or its driver is missing: apt-get install chromium chromium-driver")
    try:
        from selenium import webdriver
    except ImportError:
        raise BrowserMissing("the package selenium is missing: pip install -e '.[film]'") from None
    options = webdriver.ChromeOptions()
    options.binary_location = browser
    for option in (*OPTIONS.split(), f"--window-size={width},{height}"):
        options.add_argument(option)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    os.environ["SE_OFFLINE"] = "true"
    return webdriver.Chrome(options=options, service=webdriver.ChromeService(service))


def wait_for_page(driver: Any) -> None:
    """Until the page has been read. Raises TimeoutError where that takes too long."""
    end = time.monotonic() + PATIENCE
    while not driver.execute_script("return document.body.dataset.ready === 'true'"):
        if time.monotonic() > end:
            raise TimeoutError(f"the page is not ready: {driver.get_log('browser')}")
        time.sleep(0.02)


def film_page(page: Path, show: Callable[[str], object], frames: int = FRAMES) -> bytes:
    """A GIF of a whole page's mission in space, from its beginning to its end.

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
        pictures = []
        for k in range(frames):
            show(f"filming the mission, picture {k + 1} of {frames}")
            driver.execute_script(SEEK, end * k / max(frames - 1, 1))
            picture = Image.open(io.BytesIO(driver.get_screenshot_as_png())).convert("RGB")
            pictures.append(picture.quantize(COLOURS, dither=Image.Dither.NONE))
    finally:
        driver.quit()
    film, shown = io.BytesIO(), [SHOWN] * (frames - 1) + [LAST]
    pictures[0].save(film, "GIF", save_all=True, append_images=pictures[1:], duration=shown, loop=0, optimize=True)
    return film.getvalue()
