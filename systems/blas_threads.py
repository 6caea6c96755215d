"""Limits the number of BLAS threads in the process."""

from __future__ import annotations

from threadpoolctl import threadpool_limits


def keep_to_one_thread() -> None:
    """Limit BLAS to one thread in this process; `threadpoolctl.threadpool_limits` can change that afterwards.

    Small dense operations are many times slower when spread over the cores, and sums over several threads differ in
    their last bits.
    """
    threadpool_limits(limits=1)
