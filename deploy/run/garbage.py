"""How often the interpreter looks for garbage in cycles during a run: hardly, for a run makes next to none."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

OBJECTS = 20_000
"""More objects after which the interpreter looks for garbage during a run."""


def look_seldom() -> None:
    """Leave all that there is by now alone, and look at what is new after `OBJECTS` of it only."""
    often, *seldom = gc.get_threshold()
    gc.set_threshold(max(often, OBJECTS), *seldom)
    gc.freeze()


@contextmanager
def seldom_looking() -> Iterator[None]:
    """`look_seldom`, until the run is over."""
    before = gc.get_threshold()
    look_seldom()
    try:
        yield
    finally:
        gc.unfreeze()
        gc.set_threshold(*before)
