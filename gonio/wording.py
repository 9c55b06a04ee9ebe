"""Numbers in sentences."""

from __future__ import annotations


def percent(share: float) -> str:
    """A share as a percentage with two significant digits, whatever its size.

    >>> percent(0.000123), percent(0.0374), percent(0.85), percent(2.5)
    ('0.012 %', '3.7 %', '85 %', '250 %')
    """
    value = 100.0 * float(share)
    return f"{value:.2g} %" if value < 99.5 else f"{value:.0f} %"
