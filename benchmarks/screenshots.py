"""Pictures of a run's page, in Debian's chromium.

    python benchmarks/screenshots.py runs/... --times 60,120,297 --out docs/figures
    python benchmarks/screenshots.py runs/... --dark --size 1600x900

Needs the packages chromium and chromium-driver, and selenium. Writes <name>-2d-<time>.png, from above, and
<name>-3d-<time>.png, in space, and prints how long the slowest of the moments took to be shown.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from tfg_drake.cockpit.browser import SEEK, open_browser, wait_for_page


def main() -> None:
    """Make the pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path, help="the folder of a run, with its mission.html")
    parser.add_argument("--times", help="s, separated by commas [default: four moments, the last one the end]")
    parser.add_argument("--size", default="1280x860")
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
