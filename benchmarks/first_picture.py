"""How soon after an installation there is something to see, in Debian's chromium.

    python benchmarks/first_picture.py
    python benchmarks/first_picture.py house --until live --out pictures

`explore` is called with an empty cache of kernels, as just after an installation: seconds from the call until the
page's address is printed, until the page of the recorded mission has drawn its first picture and, with --until live,
until it has gone over to the mission itself, with what the page tells meanwhile. Then the mission and those who compile
are ended. --out: pictures of the page, one in 20 s. Needs chromium, chromium-driver and selenium.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from tfg_drake.cockpit.browser import open_browser, wait_for_page

MOST = 1800.0  # s
LIVE = "return typeof SOURCE !== 'undefined' && SOURCE.live && timeline.layers.has('pose')"
EVERY = 20.0  # s


def main() -> None:
    """Call it and watch its page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenario", nargs="?", default="paper")
    parser.add_argument("--until", choices=("picture", "live"), default="picture")
    parser.add_argument("--out", type=Path, help="where pictures go")
    arguments = parser.parse_args()
    driver = open_browser(1366, 768)
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "tfg_drake.diagrams.cli", "explore", arguments.scenario, "--out", folder]
        begun = time.monotonic()
        process = subprocess.Popen(
            command,
            env={**os.environ, "NUMBA_CACHE_DIR": str(Path(folder) / "kernels"), "PYTHONUNBUFFERED": "1"},
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            assert process.stdout is not None
            address = next(line for line in process.stdout if line.startswith("page: ")).split()[1]
            print(f"{time.monotonic() - begun:6.1f} s  address", flush=True)
            driver.get(address)
            wait_for_page(driver)
            print(f"{time.monotonic() - begun:6.1f} s  first picture", flush=True)
            told, due = "", 0.0
            while arguments.until == "live" and time.monotonic() < begun + MOST:
                now = time.monotonic() - begun
                word = driver.execute_script("return document.getElementById('notice')?.textContent ?? ''")
                if word != told:
                    print(f"{now:6.1f} s  {word}", flush=True)
                told = word
                live = driver.execute_script(LIVE)
                if arguments.out is not None and (now >= due or live):
                    due = now + EVERY
                    arguments.out.mkdir(parents=True, exist_ok=True)
                    driver.save_screenshot(str(arguments.out / f"{now:.0f}.png"))
                if live:
                    print(f"{now:6.1f} s  the mission itself", flush=True)
                    break
                time.sleep(0.5)
        finally:
            driver.quit()
            process.send_signal(signal.SIGINT)
            process.wait()


if __name__ == "__main__":
    main()
