"""Which things hang together, pair by pair (a numba kernel)."""

from __future__ import annotations

from numba import njit

from tfg_drake.messages import IntArray


@njit(cache=True)
def connect(first: IntArray, a: int, b: int) -> None:
    """Note that a and b hang together, in place: following first (n,) from entry to entry leads from either to the
    least of all that do, which is its own. Before the first pair it is 0, 1, ..., n - 1."""
    while first[a] != a:
        first[a] = first[first[a]]
        a = first[a]
    while first[b] != b:
        first[b] = first[first[b]]
        b = first[b]
    first[max(a, b)] = min(a, b)


@njit(cache=True)
def component_labels(first: IntArray) -> None:
    """Lead every entry to the least that it hangs together with in one step, in place; see `connect`."""
    for i in range(len(first)):
        first[i] = first[first[i]]
