"""The command line, called in this process."""

import signal

import pytest

from tfg_drake.diagrams import cli
from tfg_drake.diagrams.commands import screen


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
