import logging

from tfg_drake.notes import Note, NoteKeeper, take_note


def test_notes_are_kept_in_order_and_each_once():
    with NoteKeeper() as keeper:
        take_note("jump", 2.0, "odometry jumps by 6.1 m")
        take_note("silence", 1.0, "no odometry for 6 s")
        take_note("jump", 2.0, "odometry jumps by 6.1 m")
        logging.getLogger("tfg_drake").warning("not a note")
    take_note("jump", 3.0, "after its time")
    kept = [(note.kind, note.time_s, note.text) for note in keeper.notes]
    assert kept == [("jump", 2.0, "odometry jumps by 6.1 m"), ("silence", 1.0, "no odometry for 6 s")]
    assert isinstance(keeper.notes[0], Note)
