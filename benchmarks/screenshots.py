"""Pictures of a run's page, in Debian's chromium.

    python benchmarks/screenshots.py runs/... --times 60,120,297 --out docs/figures
    python benchmarks/screenshots.py runs/... --dark --size 1600x900
    python benchmarks/screenshots.py runs/... --film docs/figures/mission.gif --size 720x420

Needs the packages chromium and chromium-driver, and selenium. Writes <name>-2d-<time>.png, from above, and
<name>-3d-<time>.png, in space, and prints how long the slowest of the moments took to be shown. --film writes the
mission in space as one moving picture instead, without the panels.
"""

from __future__ import annotations

import argparse
import io
import os
import shutil
import time
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
# Pictures of a film, how long each is shown, and the last of them, ms, and its colours.
FRAMES, SHOWN, LAST, COLOURS = 72, 130, 2500, 64
# A page is read within so long, s.
PATIENCE = 60.0


def open_browser(width: int, height: int) -> Any:
    """Debian's chromium, as selenium drives it; the caller quits it.

    Raises FileNotFoundError where it or its driver is not installed, ImportError without selenium.
    """
    from selenium import webdriver

    browser, service = shutil.which("chromium"), shutil.which("chromedriver")
    if browser is None or service is None:
        raise FileNotFoundError("Debian's chromium and chromium-driver are not installed")
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


def film(driver: Any, out: Path) -> None:
    """The mission from its beginning to its end as a GIF."""
    driver.find_element("id", "mode").click()
    driver.execute_script(BARE)
    end = driver.execute_script("return timeline.end")
    frames = []
    for k in range(FRAMES):
        driver.execute_script(SEEK, end * k / (FRAMES - 1))
        image = Image.open(io.BytesIO(driver.get_screenshot_as_png())).convert("RGB")
        frames.append(image.quantize(COLOURS, dither=Image.Dither.NONE))
    shown = [SHOWN] * (FRAMES - 1) + [LAST]
    frames[0].save(out, save_all=True, append_images=frames[1:], duration=shown, loop=0, optimize=True)
    print(f"{out}: {out.stat().st_size / 1e6:.1f} MB")


def main() -> None:
    """Make the pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="the folder of a run, with its mission.html")
    parser.add_argument("--times", help="s, separated by commas [default: four moments, the last one the end]")
    parser.add_argument("--size", default="1280x860")
    parser.add_argument("--film", type=Path, metavar="FILE.gif")
    parser.add_argument("--dark", action="store_true")
    parser.add_argument("--out", type=Path, default=Path("."))
    arguments = parser.parse_args()
    width, height = map(int, arguments.size.split("x"))
    arguments.out.mkdir(parents=True, exist_ok=True)
    driver = open_browser(width, height)
    try:
        if arguments.dark:
            feature = {"name": "prefers-color-scheme", "value": "dark"}
            driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [feature]})
        driver.get((arguments.run.resolve() / "mission.html").as_uri())
        wait_for_page(driver)
        if arguments.film is not None:
            film(driver, arguments.film)
            return
        end = driver.execute_script("return timeline.end")
        times = (
            [float(one) for one in arguments.times.split(",")]
            if arguments.times
            else [end * k / 4 for k in (1, 2, 3, 4)]
        )
        spent = []
        for mode in ("2d", "3d"):
            for moment in times:
                spent.append(driver.execute_script(SEEK, moment))
                time.sleep(0.2)
                path = arguments.out / f"{arguments.run.resolve().name}-{mode}-{moment:.0f}.png"
                driver.save_screenshot(str(path))
                print(path)
            driver.find_element("id", "mode").click()
        print(f"shown within {max(spent[1:]):.3f} s; the first, just after the page was read, within {spent[0]:.3f} s")
    finally:
        driver.quit()


if __name__ == "__main__":
    main()
