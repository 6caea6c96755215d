"""The public names are found: by completion, by type checkers, in the docstrings of the systems."""

import importlib
import inspect
import os
import pkgutil
import re
import subprocess
import sys
import sysconfig
import textwrap
import zipfile
from pathlib import Path

import pytest
from pydrake.systems.framework import LeafSystem

import tfg_drake
import tfg_drake.systems
from tests.test_packaging import clone  # noqa: F401
from tfg_drake.diagrams.explorer import MakeTfgExplorer
from tfg_drake.diagrams.scenario import Scenario
from tfg_drake.diagrams.station import MakeTurtlebotStation

PUBLIC = {"Exploration", "explore", "fork", "load_run", "map_graph", "merge"}


def test_completion_offers_what_is_public():
    assert PUBLIC < set(tfg_drake.__all__) <= set(dir(tfg_drake))
    assert not {"Any", "TYPE_CHECKING", "importlib"} & set(dir(tfg_drake))
    for name in PUBLIC:
        value = getattr(tfg_drake, name)
        assert (value.__name__, name in tfg_drake.__doc__) == (name, True)
    with pytest.raises(AttributeError, match="module 'tfg_drake' has no attribute 'explor'"):
        tfg_drake.explor  # noqa: B018


def test_the_package_alone_does_without_drake():
    program = "import sys, tfg_drake; dir(tfg_drake); tfg_drake.load_run; print('pydrake' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "False\n"


def test_one_public_function_is_called_explore():
    from tfg_drake.diagrams.missions import run

    assert not hasattr(run, "explore")


def systems():
    for module in pkgutil.iter_modules(tfg_drake.systems.__path__):
        imported = importlib.import_module(f"tfg_drake.systems.{module.name}")
        for name, kind in vars(imported).items():
            own = inspect.isclass(kind) and kind.__module__ == imported.__name__ and not name.startswith("_")
            if own and issubclass(kind, LeafSystem) and module.name != "visualizer":
                yield kind


def undocumented(docstring):
    """Ports that a block lists and the text does not say the type or meaning of."""
    before, _, rest = inspect.cleandoc(docstring).partition(".. pydrake_system::")
    block, _, after = rest.partition("\n\n")[2].partition("\n\n")
    text = " ".join(f"{before} {after}".split())
    told = re.compile(r"((?:[\w.()]+(?: \([^)]*\))?(?:, | and ))*[\w.()]+)(?: \([^)]*\))?: ")
    names = {name for group in told.findall(text) for name in re.split(r", | and | ", group)}
    ports = re.findall(r"^\s*- (\S+)", block, re.MULTILINE)
    assert ports
    return [port for port in ports if port not in names]


@pytest.mark.parametrize("part", [*systems(), MakeTfgExplorer, MakeTurtlebotStation], ids=lambda part: part.__name__)
def test_each_port_has_its_type_and_meaning(part):
    assert undocumented(part.__doc__) == []


@pytest.mark.parametrize("Make", [MakeTfgExplorer, MakeTurtlebotStation])
def test_the_ports_of_a_diagram_are_those_that_its_docstring_lists(Make):
    block = inspect.cleandoc(Make.__doc__).partition(".. pydrake_system::")[2].partition("\n\n")[2].partition("\n\n")[0]
    diagram = Make(Scenario())
    count = diagram.num_input_ports(), diagram.num_output_ports()
    names = {diagram.get_input_port(i).get_name() for i in range(count[0])}
    names |= {diagram.get_output_port(i).get_name() for i in range(count[1])}
    assert names - set(re.findall(r"- (\S+)", block)) == set()


def editable(folder, out):
    """An editable wheel of a clone, as pip has it built."""
    program = "import sys, setuptools.build_meta as b; b.build_editable(sys.argv[1])"
    subprocess.run([sys.executable, "-c", program, str(out)], cwd=folder, check=True, capture_output=True)
    (wheel,) = out.glob("*.whl")
    return wheel


def test_an_editable_installation_is_a_plain_path(clone, tmp_path):  # noqa: F811
    with zipfile.ZipFile(editable(clone, tmp_path)) as wheel:
        own = [name for name in wheel.namelist() if ".dist-info/" not in name]
        assert [Path(name).suffix for name in own] == [".pth"]
        assert wheel.read(own[0]).decode().strip() == str(clone)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["editable", "wheel"])
def test_a_type_checker_sees_the_types_and_a_misspelling(clone, tmp_path, kind):  # noqa: F811
    pytest.importorskip("mypy")
    environment = tmp_path / "env"
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", str(environment)], check=True)
    (site,) = environment.glob("lib/python3*/site-packages")
    if kind == "editable":
        wheel = editable(clone, tmp_path)
    else:
        program = "import sys, setuptools.build_meta as b; b.build_wheel(sys.argv[1])"
        subprocess.run([sys.executable, "-c", program, str(tmp_path)], cwd=clone, check=True, capture_output=True)
        (wheel,) = tmp_path.glob("*.whl")
    zipfile.ZipFile(wheel).extractall(site)
    # What it depends on comes from this environment, after what was installed.
    (site / "zz.pth").write_text(sysconfig.get_path("purelib") + "\n")
    (tmp_path / "script.py").write_text(
        textwrap.dedent("""\
        import tfg_drake
        house = tfg_drake.explore("house", seed=3)
        reveal_type(house)
        reveal_type(house.map)
        reveal_type(tfg_drake.load_run("runs"))
        reveal_type(tfg_drake.fork("runs", 4))
        tfg_drake.explor("house")
        tfg_drake.explore("house", sead=3)
        """)
    )
    python = ["--python-executable", str(environment / "bin" / "python"), "--cache-dir", str(tmp_path / "cache")]
    command = [sys.executable, "-m", "mypy", "--strict", *python, "--config-file", "", "script.py"]
    alone = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "MYPYPATH")}
    said = subprocess.run(command, cwd=tmp_path, env=alone, capture_output=True, text=True, check=False).stdout
    assert '3: note: Revealed type is "tfg_drake.diagrams.exploration.Exploration"' in said
    assert '4: note: Revealed type is "tfg_drake.messages.MapEstimate | None"' in said
    assert '5: note: Revealed type is "tfg_drake.storage.run.Run"' in said
    assert '6: note: Revealed type is "pydrake.systems.analysis.Simulator"' in said
    assert '7: error: Module has no attribute "explor"; maybe "explore"?' in said
    assert '8: error: Unexpected keyword argument "sead"' in said
    assert "Found 2 errors in 1 file" in said
