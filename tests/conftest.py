"""What every test shares."""

import os
from pathlib import Path

import hypothesis

# Numba's cache of compiled kernels is not made for two writers at once: each xdist worker keeps its own.
if worker := os.environ.get("PYTEST_XDIST_WORKER"):
    os.environ["NUMBA_CACHE_DIR"] = str(Path(__file__).parents[1] / ".pytest_cache" / "numba" / worker)

# The same examples in every run, and no limit on an example's time: the first call of a kernel compiles it.
hypothesis.settings.register_profile("tfg_drake", deadline=None, derandomize=True)
hypothesis.settings.load_profile("tfg_drake")
