"""The commit that a run's summary names."""

import subprocess

import pytest

from tfg_drake.io import commit as module


@pytest.fixture
def clone(tmp_path, monkeypatch):
    """A repository of one file, as if the program were in it."""
    named = ["-c", "user.name=a", "-c", "user.email=a"]
    for arguments in (["init", "-q"], ["add", "-A"], [*named, "commit", "-qm", "one", "--allow-empty"]):
        (tmp_path / "file").write_text("1")
        subprocess.run(["git", "-C", tmp_path, *arguments], check=True)
    monkeypatch.setattr(module, "_ROOT", tmp_path)
    module.commit.cache_clear()
    yield tmp_path
    module.commit.cache_clear()


def test_it_is_that_of_the_clone(clone):
    head = ["git", "-C", clone, "rev-parse", "HEAD"]
    whole = subprocess.run(head, capture_output=True, text=True, check=True).stdout
    assert whole.startswith(module.commit())


def test_changes_are_told(clone):
    (clone / "file").write_text("2")
    assert module.commit().endswith("-dirty")


def test_an_installed_package_has_none(clone, monkeypatch):
    monkeypatch.setattr(module, "_ROOT", clone / "nowhere")
    assert module.commit() is None


def test_without_git_there_is_none(clone, monkeypatch):
    monkeypatch.setenv("PATH", "")
    assert module.commit() is None
