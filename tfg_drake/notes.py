"""Notes: what of a robot's or a recording's messages was not believed, or does not hold of the map, and since when.

A note is a log record; whoever keeps a run collects them with `NoteKeeper` for its summary.
"""

from __future__ import annotations

import logging

from tfg_drake.messages import message

_log = logging.getLogger("tfg_drake.notes")


@message
class Note:
    """kind: one word or two joined by "_", such as "jump", for who counts them. time_s: when, s, None of what is so all
    the time. text: one line."""

    kind: str
    time_s: float | None
    text: str


def take_note(kind: str, time_s: float | None, text: str) -> None:
    """Tells the operator, and whoever collects notes."""
    at = "" if time_s is None else f"{time_s:.2f} s: "
    _log.warning("%s%s", at, text, extra={"note": Note(kind, time_s, text)})


class NoteKeeper(logging.Handler):
    """Keeps the notes of log records; attached to the logger "tfg_drake" it hears all."""

    def __init__(self, notes: list[Note] | None = None) -> None:
        """notes: where they are kept, in order and each once."""
        super().__init__()
        self.notes: list[Note] = [] if notes is None else notes

    def emit(self, record: logging.LogRecord) -> None:
        """Keeps the record's note, if it has one."""
        one = getattr(record, "note", None)
        if isinstance(one, Note) and all(vars(one) != vars(note) for note in self.notes):
            self.notes.append(one)

    def __enter__(self) -> NoteKeeper:
        logging.getLogger("tfg_drake").addHandler(self)
        return self

    def __exit__(self, *error: object) -> None:
        logging.getLogger("tfg_drake").removeHandler(self)
