"""Checkpoint of a mission under way, a file to go on from: written anew every few seconds, whole or not at all.

The file is MAGIC and two pickles: what is told of the mission, and its state. They are read without running anything
but the making of numpy's arrays and of the program's own dataclasses and tuples, and by the version that wrote them.
"""

from __future__ import annotations

import dataclasses
import io
import pickle
from pathlib import Path
from typing import Any

from tfg_drake import __version__
from tfg_drake.io.files import FileError, of_run, write_atomic

FILE_NAME = "checkpoint.bin"
MAGIC = b"tfg_drake checkpoint 1\n"

# What makes an array of its bytes.
_OF_NUMPY = {"_reconstruct", "_frombuffer", "scalar", "ndarray", "dtype"}
_BUILT_IN = {("builtins", "set"), ("builtins", "frozenset"), ("collections", "deque")}


class CheckpointError(FileError):
    """A mission that cannot be gone on with; the message is one line: which, why and how to mend it."""


def write_checkpoint(path: Path, told: dict[str, Any], state: dict[str, Any]) -> None:
    """Write a mission. told: plain values and arrays, to be read without the state. Raises OSError."""
    data = MAGIC + pickle.dumps({"version": __version__, **told}, 5) + pickle.dumps(state, 5)
    write_atomic(path, data, durable=False)


def read_checkpoint(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """What is told of a mission, and its state. path: the file, or the run's folder with it.

    Raises:
        CheckpointError: there is none, it is damaged, or another version wrote it.
    """
    file = _opened(path)
    told = _load(path, file)
    if told["version"] != __version__:
        mend = f"go on with that version, or begin a mission with its map: --map {path}"
        raise CheckpointError(f"{path}: was written by version {told['version']}, this is {__version__}; {mend}")
    return told, _load(path, file)


def read_told(path: Path) -> dict[str, Any]:
    """What is told of a mission that was cut short, whichever version wrote it. Raises CheckpointError."""
    return _load(path, _opened(path))


def _opened(path: Path) -> io.BytesIO:
    path = of_run(path, FILE_NAME)
    if not path.is_file():
        run = path.parent
        if (run / "summary.json").is_file():
            raise CheckpointError(f"{run}: that mission has ended; begin another one with its map: --map {run}")
        raise CheckpointError(f"{run}: holds no mission to go on with; name the folder of one that was cut short")
    data = path.read_bytes()
    if not data.startswith(MAGIC):
        raise CheckpointError(f"{path}: is no checkpoint of this version; begin a mission with the run's map: --map")
    file = io.BytesIO(data)
    file.seek(len(MAGIC))
    return file


def _load(path: Path, file: io.BytesIO) -> dict[str, Any]:
    try:
        found = _Unpickler(file).load()
        return {**found}
    except Exception as error:  # Anything may come of bytes that are not what they should be.
        mend = "begin a mission with the run's map: --map"
        raise CheckpointError(f"{of_run(path, FILE_NAME)}: is damaged ({error}); {mend}") from error


class _Unpickler(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        """Arrays, dataclasses and tuples of the program: no others."""
        if "." not in name and ((module, name) in _BUILT_IN or module.partition(".")[0] in ("numpy", "tfg_drake")):
            found = super().find_class(module, name)
            of_numpy = name in _OF_NUMPY or module == "numpy.dtypes"
            own = isinstance(found, type) and (dataclasses.is_dataclass(found) or issubclass(found, tuple))
            if (module, name) in _BUILT_IN or (of_numpy if module.startswith("numpy") else own):
                return found
        raise pickle.UnpicklingError(f"{module}.{name} has no place in it")
