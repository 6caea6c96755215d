"""The layers import downward only, and the tree is in the order that docs/ARCHITECTURE.md describes."""

import ast
import functools
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LAYERS = ("systems", "diagrams", "hardware")
# The core, lowest first: each imports only what is before it. The robot's own part can know nothing of the world.
BASE = (
    "bad_input",
    "messages",
    "notes",
    "table",
    "percent",
    "constraints",
    "typed_tree",
    "config",
    "io",
    "kernels",
    "geometry",
)
ROBOT = ("vision", "slam", "tfg", "mission", "planning", "safety", "grid")
BEYOND = ("world", "simulation", "mapfile", "pictures", "storage", "comparison", "datasets", "cockpit")
CORE = BASE + ROBOT + BEYOND


@functools.cache
def files():
    """Paths of all files of the project, relative to its root: those git tracks or would."""
    listing = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listing, cwd=ROOT, capture_output=True, text=True, check=True).stdout.split("\0")
    return [Path(name) for name in sorted(set(names)) if (ROOT / name).is_file()]


def sources(*folders):
    return [path for path in files() if path.suffix == ".py" and (not folders or path.parts[0] in folders)]


@functools.cache
def tree(path):
    return ast.parse((ROOT / path).read_text(encoding="utf-8"), str(path))


@functools.cache
def imports(path):
    """(line, dotted name) of everything a file imports, also inside functions; `from a import b` as a.b."""
    found = []
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            module = "." * node.level + (node.module or "")
            found += [(node.lineno, f"{module}.{alias.name}") for alias in node.names]
    return found


def offenders(paths, *banned):
    return [
        f"{path}:{line} imports {name}"
        for path in paths
        for line, name in imports(path)
        if any(f"{name}.".startswith(f"{module}.") for module in banned)
    ]


def test_make_quick_names_tests_that_there_are():
    (names,) = re.findall(r"^QUICK := (.*)$", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert [name for name in names.split() if not (ROOT / "tests" / name).exists()] == []


def test_there_are_files_to_check():
    for folder in ("tfg_drake", "systems", "diagrams", "tests"):
        assert sources(folder)


def test_the_core_imports_neither_drake_nor_a_layer_above():
    # The front door names what is behind it; tests/test_public_api.py sees to it that it is imported when asked for.
    core = [path for path in sources("tfg_drake") if path != Path("tfg_drake/__init__.py")]
    assert not offenders(core, "pydrake", *(f"tfg_drake.{layer}" for layer in LAYERS))


def test_the_order_of_the_core_names_all_of_it():
    inside = {path.parts[1].removesuffix(".py") for path in sources("tfg_drake")} - {"__init__"}
    assert sorted(CORE) == sorted(inside)


@pytest.mark.parametrize("name", CORE)
def test_the_core_imports_in_its_order(name):
    own = [path for path in sources("tfg_drake") if path.parts[1].removesuffix(".py") == name]
    later = CORE[CORE.index(name) + 1 :]
    assert not offenders(own, *(f"tfg_drake.{one}" for one in later))


@pytest.mark.parametrize("folder", ["", "missions", "commands"])
def test_diagrams_import_in_their_order(folder):
    order = ["", "missions", "commands", "cli", "exploration"]
    later = order[order.index(folder) + 1 :]
    inside = [path for path in sources("diagrams") if path.parent == Path("diagrams", folder)]
    inside = [path for path in inside if folder or path.stem not in order]
    assert inside
    assert not offenders(inside, *(f"tfg_drake.diagrams.{one}" for one in later))


def test_systems_and_hardware_do_not_import_diagrams():
    assert not offenders(sources("systems", "hardware"), "tfg_drake.diagrams")


def test_imports_go_through_the_package():
    assert not offenders(sources(), *LAYERS)
    assert not [f"{path}:{line}" for path in sources() for line, name in imports(path) if name.startswith(".")]


@pytest.mark.parametrize("layer", LAYERS)
def test_layers_are_symlinked_into_the_package(layer):
    link = ROOT / "tfg_drake" / layer
    assert link.is_symlink()
    assert link.readlink() == Path("..") / layer


def public(body, prefix):
    """(qualified name, node) of the public functions and classes of a body and of public classes in it."""
    for node in body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) and not node.name.startswith("_"):
            yield f"{prefix}.{node.name}", node
            if isinstance(node, ast.ClassDef):
                yield from public(node.body, f"{prefix}.{node.name}")


def test_everything_public_has_a_docstring():
    missing = []
    for path in sources("tfg_drake", *LAYERS):
        module = ".".join(path.with_suffix("").parts)
        named = [(module, tree(path)), *public(tree(path).body, module)]
        missing += [f"{path}: {name}" for name, node in named if not ast.get_docstring(node)]
    assert not missing, "\n".join(missing)


MACHINE_PATH = re.compile(r"(?<![\w.])/(?:root|work|farm|tmp|home|Users)/\w")
REGISTRY = re.compile(r"(?:pypi|npmjs|crates)\.(?:org|io)|pythonhoste[d]|(?:deb|archive)\.(?:debian|ubuntu)\.")


@pytest.mark.parametrize("pattern", [MACHINE_PATH, REGISTRY], ids=["path of one machine", "host of a registry"])
def test_no_file_names(pattern):
    found = []
    for path in files():
        try:
            text = (ROOT / path).read_text(encoding="utf-8")
        except UnicodeDecodeError:
            continue
        found += [f"{path}:{i}: {line.strip()}" for i, line in enumerate(text.splitlines(), 1) if pattern.search(line)]
    assert not found, "\n".join(found)
