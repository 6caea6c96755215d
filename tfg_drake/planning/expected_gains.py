"""The expected gains of candidates, computed only as far as it takes to find the best of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tfg_drake.messages import BoolArray, FloatArray, IntArray
from tfg_drake.planning.information_gain import Gains
from tfg_drake.table import put

# Candidates that may be the best are judged so many at a time.
AT_ONCE = 12


class ExpectedGains:
    """The gains of candidates. Each is an upper bound until it is asked for, then exact.

    gains: (c,) of all of them, nats.
    """

    def __init__(
        self,
        gains: Gains,
        judged: BoolArray | None = None,
        expected: Callable[[IntArray], Gains] | None = None,
        *,
        pay: bool = True,
    ) -> None:
        """gains: of those that are judged already (c,), of the others the most. expected: the gains of some rows (r,);
        none where all are judged. pay: the price of the pose."""
        self.gains = gains
        self._judged = np.ones(len(gains.gain), dtype=np.bool_) if judged is None else judged.copy()
        self._expected = expected
        self._pay = pay

    @property
    def paid(self) -> FloatArray:
        """The gain (c,), nats, by which goals are preferred: with the pose's price, or without it."""
        return self.gains.gain if self._pay else self.gains.gain + self.gains.pose_price

    def ask(self, rows: IntArray) -> None:
        """Judge these rows (r,), if they are not yet."""
        rows = rows[~self._judged[rows]]
        if not len(rows) or self._expected is None:
            return
        self.gains = put(self.gains, rows, self._expected(rows))
        self._judged[rows] = True

    def best(self, value: Callable[[FloatArray], FloatArray]) -> tuple[int, float]:
        """The row of most value, and that; -1 and -inf where none is in question. value: of all candidates (c,) by what
        they are preferred by (c,), more for more of it, and -inf for those that are out of the question.

        Only those are judged that might be the best by what they can bring at the most.
        """
        while True:
            of_each = value(self.paid)
            best = int(np.argmax(of_each)) if len(of_each) else -1
            if best < 0 or of_each[best] == -np.inf:
                return -1, -np.inf
            if self._judged[best]:
                return best, float(of_each[best])
            beaten = of_each[self._judged].max(initial=-np.inf)
            rows = np.flatnonzero(~self._judged & (of_each > beaten))
            self.ask(rows[np.argsort(-of_each[rows], kind="stable")[:AT_ONCE]])
