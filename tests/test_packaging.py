"""What is built from a clone: each file once and nothing stray, and nothing at all where the links are broken."""

import os
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path, PurePosixPath

import pytest
from packaging.requirements import Requirement

from tfg_drake import __version__

ROOT = Path(__file__).parents[1]
LINKED = ("systems", "diagrams", "hardware")
# What every source distribution holds besides the package.
BESIDE = {"LICENSE", "MANIFEST.in", "PKG-INFO", "README.md", "pyproject.toml", "setup.cfg", "setup.py"}

pytest.importorskip("setuptools", minversion="77", reason="setuptools 77 or newer builds the package")


def tracked():
    """The names of all files that git tracks, and whether each is a link."""
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True)
    return {name: (ROOT / name).is_symlink() for name in listing.stdout.split("\0") if name}


def expected():
    """The package's files as an installation has them."""
    names = {name for name, is_link in tracked().items() if not is_link}
    own = {name for name in names if name.startswith("tfg_drake/")}
    return own | {f"tfg_drake/{name}" for name in names if name.split("/")[0] in LINKED}


@pytest.fixture
def clone(tmp_path):
    """A copy of what git tracks, with what a developer's has besides."""
    folder = tmp_path / "clone"
    for name in tracked():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, folder / name, follow_symlinks=False)
    for place in ("tfg_drake", "hardware", "tests"):
        (folder / place / "__pycache__").mkdir()
        (folder / place / "__pycache__" / "old.cpython-311.pyc").write_bytes(b"old")
    (folder / "runs").mkdir()
    (folder / "runs" / "summary.json").write_text("{}")
    return folder


def build(folder, kind, out):
    """What setuptools says while it builds a wheel or an sdist, as pip would have it; it is not to ask the network."""
    program = "import sys, setuptools.build_meta as b; getattr(b, 'build_' + sys.argv[1])(sys.argv[2])"
    command = [sys.executable, "-c", program, kind, str(out)]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_wheel_holds_each_file_once(clone, tmp_path):
    built = build(clone, "wheel", tmp_path)
    assert built.returncode == 0, built.stderr
    (wheel,) = tmp_path.glob("*.whl")
    assert wheel.name == f"tfg_drake-{__version__}-py3-none-any.whl"
    names = zipfile.ZipFile(wheel).namelist()
    assert len(names) == len(set(names))
    assert {name for name in names if ".dist-info/" not in name} == expected()


def test_sdist_holds_each_file_once(clone, tmp_path):
    built = build(clone, "sdist", tmp_path)
    assert built.returncode == 0, built.stderr
    with tarfile.open(tmp_path / f"tfg_drake-{__version__}.tar.gz") as archive:
        members = [member for member in archive.getmembers() if not member.isdir()]
    assert all(member.isfile() for member in members)
    names = [str(PurePosixPath(*PurePosixPath(member.name).parts[1:])) for member in members]
    assert len(names) == len(set(names))
    assert {name for name in names if not name.startswith("tfg_drake.egg-info/")} == expected() | BESIDE


@pytest.mark.parametrize("kind", ["wheel", "sdist"])
@pytest.mark.parametrize("broken", LINKED)
def test_without_links_nothing_is_built(clone, tmp_path, kind, broken):
    # What git writes where core.symlinks is false.
    (clone / "tfg_drake" / broken).unlink()
    (clone / "tfg_drake" / broken).write_text(f"../{broken}")
    built = build(clone, kind, tmp_path)
    assert built.returncode == 1
    assert built.stderr == (
        f"tfg_drake/{broken} is not a link to {broken}/, as git makes it where core.symlinks is true; "
        "mend it with: git config core.symlinks true && git checkout -- tfg_drake\n"
    )
    assert not [*tmp_path.glob("*.whl"), *tmp_path.glob("*.tar.gz")]


def test_the_remedy_helps(clone):
    def git(*arguments):
        mine = ["-c", "user.name=me", "-c", "user.email=me@example.com"]
        subprocess.run(["git", *mine, *arguments], cwd=clone, check=True, capture_output=True)

    git("init", "-q")
    git("add", "tfg_drake", "setup.py", ".gitignore", *LINKED)
    git("commit", "-qm", "all")
    for name in LINKED:
        (clone / "tfg_drake" / name).unlink()
    git("config", "core.symlinks", "false")
    git("checkout", "--", "tfg_drake")
    assert (clone / "tfg_drake" / "systems").is_file()
    git("config", "core.symlinks", "true")
    git("checkout", "--", "tfg_drake")
    assert all((clone / "tfg_drake" / name).is_symlink() for name in LINKED)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["wheel", "sdist"])
def test_what_is_built_can_be_installed(clone, tmp_path, kind):
    built = build(clone, kind, tmp_path)
    assert built.returncode == 0, built.stderr
    (package,) = [*tmp_path.glob("*.whl"), *tmp_path.glob("*.tar.gz")]
    offline = ["--no-deps", "--no-index", "--no-build-isolation", "--disable-pip-version-check"]
    # A folder of its own: what it depends on comes from this environment.
    installed = tmp_path / "installed"
    command = [sys.executable, "-m", "pip", "install", "-q", *offline, "--target", str(installed), str(package)]
    subprocess.run(command, cwd=tmp_path, check=True)

    def run(*arguments):
        env = os.environ | {"PYTHONPATH": os.pathsep.join([str(installed), *filter(None, [os.getenv("PYTHONPATH")])])}
        command = [sys.executable, *arguments]
        return subprocess.run(command, cwd=tmp_path, env=env, check=True, capture_output=True, text=True).stdout

    assert run("-c", "import tfg_drake.messages as m; print(m.__file__)").startswith(str(installed))
    scenarios = "from importlib.resources import files; print(files('tfg_drake.diagrams') / 'scenarios')"
    folder = Path(run("-c", scenarios).strip())
    assert folder.is_relative_to(installed)
    assert {file.name for file in folder.iterdir()} == {
        Path(name).name for name in expected() if name.startswith("tfg_drake/diagrams/scenarios/")
    }
    assert run(str(installed / "bin" / "tfg-drake"), "--version") == f"tfg-drake {__version__}\n"


def requirements(project):
    """All that pyproject.toml asks for, the extras', too, but for this package itself."""
    lists = [project["dependencies"], *project["optional-dependencies"].values()]
    every = [Requirement(one) for some in lists for one in some]
    return [one for one in every if one.name != project["name"]]


@pytest.mark.parametrize("version", ["3.11", "3.12", "3.13", "3.14"])
def test_pins_are_what_the_project_asks_for(version):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    lines = (ROOT / f"constraints-{version}.txt").read_text().splitlines()
    pins = dict(line.split("==") for line in lines)
    for one in requirements(project):
        python = {"python_version": version, "sys_platform": "linux", "platform_machine": "x86_64"}
        if one.marker is None or one.marker.evaluate(python):
            assert one.specifier.contains(pins[one.name]), one


def test_each_python_that_is_tested_has_its_pins():
    workflow = (ROOT / ".github" / "workflows" / "ci.yml").read_text()
    for pins in ROOT.glob("constraints-*.txt"):
        assert f'"{pins.stem.removeprefix("constraints-")}"' in workflow
