"""The process that drives a robot, started by tfg_drake.hardware.device.Device: `python -m ... ORDERS ANNOUNCEMENTS`.

ORDERS and ANNOUNCEMENTS are file descriptors of pipes. The first carries to the process the function that opens the
driver, then ("command", sent, speed, turn_rate), ("enable", sent), ("lock", reason) and ("close",); and from it
("message", message) if plausible, ("locked", reason or None), ("answer", reason or None) to an enable, ("remark", line)
for the operator, ("alive", None) twice a second from its beginning, and ("ended", line). When the other end is gone the
robot stands and the process ends. The second carries messages to publish: as a pipe of its own, with a thread at either
end, a map of a large building holds up neither the planner nor the watchdog.
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
import sys
import threading
import time
from multiprocessing.connection import Connection

from tfg_drake.hardware.device import ANSWER_TIMEOUT, WAITING, BaseState, DeviceError, Driver, Outbox
from tfg_drake.hardware.plausible import Judge
from tfg_drake.hardware.process import LAST_WORDS, TICK
from tfg_drake.hardware.remarks import alarms
from tfg_drake.hardware.watchdog import SILENCE, Watchdog
from tfg_drake.messages import Hazards, Odometry

# Greatest time for reading orders before the robot is served again, s.
_ORDERS_WITHIN = TICK


def serve(driver: Driver, connection: Connection) -> None:
    """Drive the robot until the other end of the connection is closed or its process has ended."""
    watchdog, outbox, parent = Watchdog(driver.limits), Outbox(connection, WAITING), os.getppid()
    judge = Judge(driver.sources)
    told, moved, said_alive = watchdog.locked, False, -math.inf
    try:
        while os.getppid() == parent:
            driver.spin(TICK)
            for taken in driver.take():
                if (message := judge.judged(taken, now := time.monotonic())) is None:
                    continue
                if isinstance(message, Odometry):
                    watchdog.hear(min(message.stamp, now))
                elif isinstance(message, Hazards):
                    watchdog.hear_hazards(message)
                elif isinstance(message, BaseState):
                    watchdog.hear_alarms(alarms(message), now)
                outbox.put("message", message)
            for line in (*driver.remarks(), *judge.refusals.take()):
                outbox.put("remark", line)
            if fault := driver.fault():
                watchdog.lock(fault)
            end = time.monotonic() + _ORDERS_WITHIN
            while connection.poll() and time.monotonic() < end:
                order = connection.recv()
                if order[0] == "close":
                    return
                if order[0] == "enable":
                    # Older requests have timed out.
                    if (now := time.monotonic()) - order[1] < ANSWER_TIMEOUT:
                        watchdog.enable(now)
                    if fault:
                        watchdog.lock(fault)
                    moved = True
                    told = watchdog.locked
                    outbox.put("answer", told)
                elif order[0] == "lock":
                    watchdog.lock(order[1])
                else:
                    watchdog.command(*order[1:])
            velocity = watchdog.velocity(time.monotonic())
            if moved:  # until it is first enabled, others may drive the robot
                driver.send(*velocity)
            if watchdog.locked != told:
                told = watchdog.locked
                outbox.put("locked", told)
            if time.monotonic() - said_alive > SILENCE:
                said_alive = time.monotonic()
                outbox.put("alive", None)
            driver.show(told is None)
    except (EOFError, OSError):
        pass  # the other end is gone
    finally:
        for _ in range(LAST_WORDS if moved else 0):
            with contextlib.suppress(Exception):  # if one command is lost, the next may arrive
                driver.send(0.0, 0.0)
                driver.spin(TICK)


def announce(driver: Driver, connection: Connection) -> None:
    """Publish the arriving messages until the other end of the connection is closed."""
    while True:
        try:
            key, message = connection.recv()
        except (EOFError, OSError):
            return
        driver.publish(key, message)


def main() -> None:
    """Run the process."""
    for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP):
        signal.signal(number, lambda *_: sys.exit(0))
    connection = Connection(int(sys.argv[1]))
    try:
        driver = connection.recv()()
    except DeviceError as error:
        connection.send(("ended", str(error)))
        return
    threading.Thread(target=announce, args=(driver, Connection(int(sys.argv[2]))), daemon=True).start()
    try:
        serve(driver, connection)
    finally:
        driver.close()


if __name__ == "__main__":
    main()
