"""Numbers as text, for people: shares, and numbers of things."""

from __future__ import annotations

MARGIN = 1e-9
"""Largest rounding error of a computed share."""


def percent(share: float, decimals: int = 1) -> str:
    """A share as text, rounded; as 100 % only if it is complete."""
    most = 100 - (10**-decimals if share < 1 - MARGIN else 0)
    return f"{min(100 * share, most):.{decimals}f} %"


def counted(number: int, noun: str) -> str:
    """A number with its noun in singular or plural."""
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
