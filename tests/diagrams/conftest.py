"""The command line, called in this process."""

import signal

import pytest

from tests.diagrams.rooms import ROOM
from tests.diagrams.rooms import room as divided_room
from tfg_drake.diagrams import cli
from tfg_drake.diagrams.commands import screen
from tfg_drake.diagrams.missions import run


@pytest.fixture(autouse=True)
def _compiled(compiled):
    """No command waits for kernels."""


@pytest.fixture
def call(capsys, monkeypatch):
    """tfg-drake with some arguments: its exit code, standard output and standard error, in which nothing that takes
    long on a busy machine is said meanwhile."""
    monkeypatch.setattr(screen, "INTERVAL", 1e6)

    def run(*arguments):
        handler = signal.getsignal(signal.SIGINT)
        try:
            with pytest.raises(SystemExit) as caught:
                cli.main([str(argument) for argument in arguments])
        finally:
            signal.signal(signal.SIGINT, handler)
        return (caught.value.code, *capsys.readouterr())

    return run


@pytest.fixture
def room(tmp_path):
    """The path of a scenario: a bare room."""
    path = tmp_path / "room.yaml"
    path.write_text(ROOM)
    return str(path)


@pytest.fixture(scope="session")
def finished(tmp_path_factory, compiled):
    """A mission in the divided room, recorded and run to its end."""
    return run.explore(divided_room(), name="room", out_dir=tmp_path_factory.mktemp("finished"))
