"""How many threads the systems' dense linear algebra takes."""

from __future__ import annotations

from threadpoolctl import threadpool_limits


def keep_to_one_thread() -> None:
    """From now on BLAS keeps to one thread in this process; whoever wants another number sets it afterwards, with
    `threadpoolctl.threadpool_limits`.

    Small dense operations are many times slower when they are spread over the cores, and sums over several threads
    differ in their last bits.
    """
    threadpool_limits(limits=1)
