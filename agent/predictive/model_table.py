"""Trained models of `agent.predictive.mixer` as tables, which hold only the contexts that have occurred."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.predictive.mixer import Model, new_model


def packed(model: Model) -> dict[str, NDArray[Any]]:
    """Return the arrays of a table, by name, that holds a model.

    `places`, int32 of shape (n,), are the flat indices of the contexts that have seen bits. `chances` and `ages` have
    the values at these places, `weights` all weights (`agent.predictive.mixer.Model`).
    """
    chances, ages, weights = model
    places = np.flatnonzero(ages).astype(np.int32)
    return {
        "places": places,
        "chances": chances.reshape(-1)[places],
        "ages": ages.reshape(-1)[places],
        "weights": weights,
    }


def unpacked(table: Mapping[str, NDArray[Any]], contexts: int, sets: int) -> Model:
    """Return the model of a table that `packed` made, with this many contexts per input and sets of weights."""
    chances, ages, weights = new_model(contexts, sets)
    chances.reshape(-1)[table["places"]] = table["chances"]
    ages.reshape(-1)[table["places"]] = table["ages"]
    weights[:] = table["weights"]
    return chances, ages, weights


def shipped_model(file: Path, contexts: int, sets: int) -> Model:
    """Return a copy of the model in the table of a file, with this many contexts per input and sets of weights."""
    chances, ages, weights = _loaded(file, contexts, sets)
    return chances.copy(), ages.copy(), weights.copy()


@cache
def _loaded(file: Path, contexts: int, sets: int) -> Model:
    with np.load(file) as table:
        return unpacked(table, contexts, sets)
