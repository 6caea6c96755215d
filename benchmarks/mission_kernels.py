"""Makes the list of the kernels that missions call, and with what, anew: what is compiled before the first mission.

    python benchmarks/mission_kernels.py

Three missions, by tags and walls, by walls alone and on a grid, compile into an empty folder all that they call, five
minutes. A line a kernel and types: module, name, types. First come those that call no others, then those that call only
these, and so on, of each those first that take longest without those they call: so hardly one is compiled by two
processes at a time.
"""

from __future__ import annotations

import argparse
import inspect
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

FILE = Path(__file__).parents[1] / "tfg_drake" / "mission_kernels.txt"
# MISSIONS: method, and whether the scenario keeps its tags, a metre apart. UNTIL: duration of each mission, s.
MISSIONS, UNTIL = (("tfg", True), ("tfg", False), ("weighted", False)), 120.0


def spelled(one: Any) -> str:
    """A numba type as Python spells it, with the names of numba.types."""
    from numba import types

    if isinstance(one, types.Array):
        return f"Array({spelled(one.dtype)}, {one.ndim}, {one.layout!r}, {not one.mutable})"
    if isinstance(one, types.BaseTuple):
        kind, parts = type(one).__name__, ", ".join(map(spelled, one.types))
        named = f", {one.instance_class.__name__}" if isinstance(one, types.BaseNamedTuple) else ""
        if isinstance(one, types.UniTuple | types.NamedUniTuple):
            return f"{kind}({spelled(one.dtype)}, {one.count}{named})"
        return f"{kind}([{parts}]{named})"
    if isinstance(one, types.Literal):
        return f"literal({one.literal_value!r})"
    return "boolean" if one == types.boolean else str(one)


def kernels_of(module: Any) -> dict[str, Any]:
    """The numba dispatchers that a module of the package has of its own, by its names for them."""
    if not module.__name__.startswith("tfg_drake."):
        return {}
    found = {name: as_kernel(value) for name, value in vars(module).items()}
    return {name: one for name, one in found.items() if one and one.py_func.__module__ == module.__name__}


def as_kernel(value: Any) -> Any:
    """The dispatcher behind a function, None if there is none."""
    if not callable(value):
        return None
    value = inspect.unwrap(value, stop=lambda function: hasattr(function, "compile"))
    return value if hasattr(value, "compile") else None


def called_by(kernel: Any) -> list[Any]:
    """The kernels that one calls."""
    function = kernel.py_func
    return [one for name in function.__code__.co_names if (one := as_kernel(function.__globals__.get(name)))]


def depth(kernel: Any) -> int:
    """How many kernels call one another below one, at most."""
    return max((1 + depth(one) for one in called_by(kernel)), default=0)


def line(kernel: Any, types: Any) -> str:
    """Its line in the list."""
    module = sys.modules[kernel.py_func.__module__]
    name = next(name for name, one in kernels_of(module).items() if one is kernel)
    types = f"({''.join(f'{spelled(one)}, ' for one in types)})"
    return f"{module.__name__.removeprefix('tfg_drake.')} {name} {types}"


def called() -> set[tuple[str, ...]]:
    """Module, name and types of all kernels that this process has called from Python so far."""
    modules = [module for name, module in list(sys.modules.items()) if name.startswith("tfg_drake.")]
    kernels = [one for module in modules for one in kernels_of(module).values()]
    return {tuple(line(one, types).split(maxsplit=2)) for one in kernels for types in one.overloads}


def main() -> None:
    """Drive the missions, and write the list."""
    argparse.ArgumentParser(description=__doc__).parse_args()
    rows: dict[tuple[Any, Any], float] = {}
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NUMBA_CACHE_DIR"] = folder
        from numba.core import event

        from tfg_drake.diagrams.methods import METHODS
        from tfg_drake.diagrams.missions.run import run_mission
        from tfg_drake.diagrams.scenario import LoadScenario

        inner = [0.0]

        class Listener(event.Listener):
            def on_start(self, event: Any) -> None:
                inner.append(0.0)
                event.data["begun"] = time.process_time()

            def on_end(self, event: Any) -> None:
                spent = time.process_time() - event.data["begun"]
                own, kernel = spent - inner.pop(), event.data["dispatcher"]
                # Others, numba's and those inside a kernel, are compiled anew with each that calls them.
                if kernel in kernels_of(sys.modules[kernel.py_func.__module__]).values():
                    inner[-1] += spent
                    rows.setdefault((kernel, event.data["args"]), own)
                else:
                    inner[-1] += spent - own

        event.register("numba:compile", Listener())
        for number, (method, has_tags) in enumerate(MISSIONS):
            scenario = LoadScenario("house")
            if not has_tags:
                scenario.world.tags = []
            run_mission(scenario, method=METHODS[method], max_time=UNTIL, out_dir=Path(folder) / f"run-{number}")
    ordered = sorted(rows, key=lambda key: (depth(key[0]), -rows[key]))
    FILE.write_text("".join(f"{line(*key)}\n" for key in ordered), encoding="utf-8")
    total = sum(rows.values())
    print(f"{len(rows)} of {len({key[0] for key in rows})} kernels, {total:.0f} s: {FILE}")


if __name__ == "__main__":
    main()
