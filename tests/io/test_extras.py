"""A missing package is installed by the pip of the environment that misses it."""

import sys

import pytest

from tfg_drake.io.extras import pip_install


@pytest.mark.parametrize(
    ("python", "pip"),
    [
        ("here/.venv/bin/python3", ".venv/bin/pip"),
        (".venv/bin/python", "../.venv/bin/pip"),
        ("here/my env/bin/python", "'my env/bin/pip'"),
    ],
)
def test_it_is_named_from_the_working_folder(tmp_path, monkeypatch, python, pip):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setattr(sys, "executable", str(tmp_path / python))
    assert pip_install("serial") == f"{pip} install 'tfg-drake[serial]'"


def test_it_is_named_from_the_root_where_that_is_shorter(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "executable", "/env/bin/python")
    assert pip_install("export") == "/env/bin/pip install 'tfg-drake[export]'"
