"""Makes the list of the kernels that missions call, and with what, anew: what is compiled before the first mission.

    python benchmarks/mission_kernels.py

Two missions, one by tags and walls and one by walls alone, compile into an empty folder all that they call, five
minutes. A line a kernel and types: module, name, seconds that it took without those it calls, types. First come those
that call no others, then those that call only these, and so on, of each the longest first: so hardly one is compiled by
two processes at a time.
"""

from __future__ import annotations

import inspect
import os
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

FILE = Path(__file__).parents[1] / "tfg_drake" / "mission_kernels.txt"
# Tags a metre apart as the scenario has them, or none; how long each goes on, s.
MISSIONS, UNTIL = (False, True), 120.0


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


def lines(kernel: Any, cost: float, types: Any) -> str:
    """Its line in the list."""
    module = sys.modules[kernel.py_func.__module__]
    name = next(name for name, one in kernels_of(module).items() if one is kernel)
    types = f"({''.join(f'{spelled(one)}, ' for one in types)})"
    return f"{module.__name__.removeprefix('tfg_drake.')} {name} {cost:.2f} {types}"


def called() -> set[tuple[str, str, str]]:
    """Module, name and types of all kernels that this process has called from Python so far."""
    modules = [module for name, module in list(sys.modules.items()) if name.startswith("tfg_drake.")]
    kernels = [one for module in modules for one in kernels_of(module).values()]
    split = (lines(one, 0.0, types).split(maxsplit=3) for one in kernels for types in one.overloads)
    return {(module, name, types) for module, name, _, types in split}


def main() -> None:
    """Drive the missions, and write the list."""
    rows: dict[tuple[Any, Any], float] = {}
    with tempfile.TemporaryDirectory() as folder:
        os.environ["NUMBA_CACHE_DIR"] = folder
        from numba.core import event

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
        for without_tags in MISSIONS:
            scenario = LoadScenario("house")
            if without_tags:
                scenario.world.tags = []
            run_mission(scenario, max_time=UNTIL, out_dir=Path(folder) / f"run-{without_tags}")
    ordered = sorted(rows, key=lambda key: (depth(key[0]), -rows[key]))
    FILE.write_text("".join(f"{lines(key[0], rows[key], key[1])}\n" for key in ordered), encoding="utf-8")
    total = sum(rows.values())
    print(f"{len(rows)} of {len({key[0] for key in rows})} kernels, {total:.0f} s: {FILE}")


if __name__ == "__main__":
    main()
