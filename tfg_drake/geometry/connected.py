"""Connected components by union-find (numba kernels)."""

from __future__ import annotations

from numba import njit

from tfg_drake.messages import IntArray


@njit(cache=True)
def connect(first: IntArray, a: int, b: int) -> None:
    """Merge the components of a and b, in place.

    first: (n,) the union-find forest; following it from entry to entry leads to the least member of a component, which
    is its own entry. Before the first pair it is 0, 1, ..., n - 1.
    """
    while first[a] != a:
        first[a] = first[first[a]]
        a = first[a]
    while first[b] != b:
        first[b] = first[first[b]]
        b = first[b]
    first[max(a, b)] = min(a, b)


@njit(cache=True)
def component_labels(first: IntArray) -> None:
    """Replace every entry of the forest (n,) by the least member of its component, in place; see `connect`."""
    for i in range(len(first)):
        first[i] = first[first[i]]
