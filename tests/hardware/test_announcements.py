"""What is to be published waits for nobody, and nobody waits for it."""

import threading
import time
from multiprocessing import Pipe

from tfg_drake.hardware.device import Outbox
from tfg_drake.hardware.driver_process import announce

LARGE = {"data": bytes(5_000_000)}


class Slow:
    """Publishes a message in a tenth of a second."""

    def __init__(self):
        self.published = []

    def publish(self, key, message):
        time.sleep(0.1)
        self.published.append((key, message))


def test_of_what_is_too_fast_the_newest_is_published():
    theirs, ours = Pipe(duplex=False)
    publisher = Slow()
    thread = threading.Thread(target=announce, args=(publisher, theirs))
    thread.start()
    announcements = Outbox(ours)
    announcements.put("map", LARGE)
    put = 0
    while len(publisher.published) < 5:
        announcements.put("pose", LARGE | {"number": time.monotonic()})
        put += 1
        time.sleep(0.005)
    last = time.monotonic()
    announcements.put("pose", {"number": last})
    while publisher.published[-1:] != [("pose", {"number": last})]:
        assert time.monotonic() < last + 60.0
        time.sleep(0.01)
    announcements.close()
    thread.join(60.0)
    assert not thread.is_alive()
    numbers = [message["number"] for key, message in publisher.published if key == "pose"]
    assert numbers == sorted(numbers)
    assert 4 <= len(numbers) < put
    assert publisher.published.count(("map", LARGE)) == 1


def test_nobody_reads():
    theirs, ours = Pipe(duplex=False)
    announcements = Outbox(ours)
    began = time.monotonic()
    for _ in range(10):
        announcements.put("map", LARGE)
    assert time.monotonic() - began < 20.0
    theirs.close()  # as the end of the process does
    announcements.close()
    announcements.put("map", LARGE)


def test_of_what_nobody_reads_the_oldest_is_lost():
    theirs, ours = Pipe(duplex=False)
    outbox = Outbox(ours, most=3)
    outbox.put("message", LARGE)  # which is as much as the pipe holds, and more
    time.sleep(0.5)
    for number in range(10):
        outbox.put("message", number)
    assert [theirs.recv() for _ in range(4)] == [("message", LARGE), *(("message", number) for number in (7, 8, 9))]
    outbox.close()
