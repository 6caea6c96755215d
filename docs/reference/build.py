"""Builds the reference from the docstrings, as web pages: every module, the ports of each system, and the diagrams.

    python docs/reference/build.py [OUT]      build/reference by default; needs the extra docs

The diagrams are drawn by Graphviz; where its program `dot` is not installed they are left out, with a line.
"""

from __future__ import annotations

import pkgutil
import shutil
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import tfg_drake
from tfg_drake.io.extras import pip_install

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
# Pages in the order of the layers; each has the modules of one folder.
FIRST = ("tfg_drake", "tfg_drake.systems", "tfg_drake.diagrams")
# What a mission from Python needs, by the name under which `tfg_drake` has it.
API = {
    "explore": "tfg_drake.diagrams.exploration",
    "load_run": "tfg_drake.storage.run",
    "fork": "tfg_drake.diagrams.exploration",
    "map_graph": "tfg_drake.slam.gtsam_solver",
    "merge": "tfg_drake.mapfile.merge",
}
START = """tfg_drake
=========

A robot explores a building by itself and maps its walls and tags. A mission in the browser, then its page again::

    tfg-drake explore house --realtime-rate 8
    tfg-drake view runs/...

The same from Python, as in ``examples/mission.py``:

.. literalinclude:: {example}
   :language: python

Poses are named as Drake does it: ``X_WB`` is the pose of the body B in the world W, in metres and radians; M is the
map, whose origin is where the robot started. ``docs/estimator.md`` shows how to put parts of your own in,
``docs/ARCHITECTURE.md`` which folder does what, ``docs/method.md`` what is computed.

{functions}
.. toctree::
   :maxdepth: 2
   :caption: By folder

{entries}
"""
DIAGRAMS = {
    "mission": "station, explorer and what records them",
    "station": "the simulated TurtleBot",
    "explorer": "from what the robot senses to what its base is told",
}


def modules() -> dict[str, list[str]]:
    """The modules of each package, by their names."""
    found: dict[str, list[str]] = defaultdict(list)
    for one in pkgutil.walk_packages(tfg_drake.__path__, "tfg_drake."):
        if not one.ispkg:
            found[one.name.rpartition(".")[0]].append(one.name)
    return found


def page(package: str, names: list[str]) -> str:
    """A page with all that is public in some modules."""
    title = package.removeprefix("tfg_drake.")
    lines = [title, "=" * len(title), "", f".. automodule:: {package}", ""]
    for name in sorted(names):
        heading = name.rpartition(".")[2]
        lines += [heading, "-" * len(heading), "", f".. automodule:: {name}", "   :members:", ""]
    return "\n".join(lines)


def draw_diagrams(folder: Path) -> list[str]:
    """Lines of a page with the diagrams, which are drawn into a folder."""
    lines = ["Diagrams", "========", ""]
    if shutil.which("dot") is None:
        print("the diagrams are left out: Graphviz's program dot is not installed (on Debian: apt install graphviz)")
        return [*lines, "Graphviz was not installed where these pages were built."]

    from tfg_drake.diagrams.mission_diagram import MakeMissionDiagram
    from tfg_drake.diagrams.scenario import LoadScenario, MakeWorld

    scenario = LoadScenario("house")
    mission = MakeMissionDiagram(scenario, MakeWorld(scenario.world))[0]
    drawn = {name: mission.GetSubsystemByName(name) for name in ("station", "explorer")}
    for name, what in DIAGRAMS.items():
        text = drawn.get(name, mission).GetGraphvizString(max_depth=1, options={"split": "I/O"})
        subprocess.run(["dot", "-Tsvg", "-o", str(folder / f"{name}.svg")], input=text, text=True, check=True)
        lines += [name, "-" * len(name), "", f"{what[0].upper()}{what[1:]}.", "", f".. image:: {name}.svg"]
        lines += [f"   :target: _images/{name}.svg", ""]
    return lines


def main(out: Path) -> int:
    """Write the sources and build them. Returns Sphinx's exit code."""
    try:
        from sphinx.cmd.build import build_main
    except ImportError:
        print(f"Sphinx is not installed; get it with {pip_install('docs')}", file=sys.stderr)
        return 2
    source = out / "source"
    shutil.rmtree(source, ignore_errors=True)
    source.mkdir(parents=True)
    found = modules()
    packages = [*FIRST, *sorted(set(found) - set(FIRST))]
    for package in packages:
        (source / f"{package}.rst").write_text(page(package, found[package]))
    (source / "diagrams.rst").write_text("\n".join(draw_diagrams(source)))
    entries = "\n".join(f"   {name}" for name in ("diagrams", *packages))
    functions = "".join(f".. autofunction:: {module}.{name}\n   :no-index:\n\n" for name, module in API.items())
    shutil.copy(ROOT / "examples" / "mission.py", source)
    (source / "index.rst").write_text(START.format(example="mission.py", functions=functions, entries=entries))
    code = int(build_main(["-q", "-c", str(HERE), str(source), str(out / "html")]))
    if code == 0:
        print(f"{out / 'html' / 'index.html'}")
    return code


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "build" / "reference"))
