"""Shares as a person reads them."""


def percent(share: float, digits: int = 1) -> float:
    """A share in per cent, rounded to so many digits; less than all stays below 100: 99.9 of 0.9996."""
    rounded = round(100.0 * share, digits)
    return rounded if share >= 1.0 else min(rounded, 100.0 - 10.0**-digits)
