"""Figures of a ledger: bytes by kind of packet, use of the budget, duty cycles, and frames that were not delivered."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from netshaper.ledger import CAUSES
from netshaper.settings import Saving
from protocol.budget import Budget
from protocol.messages import Change
from protocol.packets import ALL_KINDS


def per_kind(ledger: NDArray[np.void], name: str) -> dict[str, int]:
    """The sum of a column over the transmitted rows by packet type, and in total."""
    rows = ledger[ledger["carried"] == 1]
    sums = np.bincount(rows["kind"], rows[name], len(ALL_KINDS)).astype(int).tolist()
    present = set(rows["kind"].tolist())
    return {kind: sums[n] for n, kind in enumerate(ALL_KINDS) if n in present} | {"total": sum(sums)}


def over_budget(ledger: NDArray[np.void], allowed: NDArray[np.float64], saving: Saving, *, each: bool) -> int:
    """Count the steps with more bytes than their budget and the bytes saved from earlier steps; there must be none.

    If each neighborhood has a budget (`each`), count the steps in which any robot sent more than that.
    """
    if not len(ledger):
        return 0
    sent = _sums(ledger["step"], ledger["sender"] * each, ledger["bytes"] * ledger["carried"], len(allowed))
    over, left = 0, np.full(sent.shape[1], np.inf)
    for budget, of_step in zip(allowed.tolist(), sent, strict=True):
        capacity = max(saving.steps * budget, saving.least) if budget else 0.0
        left = np.minimum(left + budget, capacity)
        over += bool((of_step > left).any())
        left = np.maximum(left - of_step, 0.0)
    return over


def duty_cycle(ledger: NDArray[np.void], allowed: NDArray[np.float64], hour: int) -> float | None:
    """Return the largest share of an hour in which a robot sent, by the budget of each step, from 0 on.

    Frames take their bytes' share of the budget; an hour has `hour` steps. None if there is no budget.
    """
    rows = ledger[ledger["carried"] == 1]
    if not np.isfinite(allowed).all():
        return None
    used = _sums(rows["step"], rows["sender"], rows["bytes"] / allowed[rows["step"]], len(allowed)).cumsum(
        axis=0
    )
    used[hour:] -= used[:-hour].copy()
    return float(used.max(initial=0.0) / hour)


def _sums(
    step: NDArray[np.integer], group: NDArray[np.integer], values: NDArray[Any], steps: int
) -> NDArray[np.float64]:
    """Return the sums of values by step and group, shape (steps, groups), with one group at least."""
    groups = int(group.max(initial=0)) + 1
    flat = step.astype(np.int64) * groups + group
    sums: NDArray[Any] = np.bincount(flat, values, steps * groups)
    return sums.reshape(steps, groups)


def budgets(budget: Budget, changes: Iterable[Change], steps: int) -> NDArray[np.float64]:
    """The budget of each step from 0 on, infinite where there is none."""
    allowed = np.full(steps, math.inf if budget.limit is None else float(budget.limit))
    for change in changes:
        if change.budget is not None:
            limit = change.budget.limit
            allowed[change.step :] = math.inf if limit is None else limit
    return allowed


def undelivered(ledger: NDArray[np.void]) -> dict[str, int]:
    """Count the frames that were not delivered completely, by cause."""
    cut = ledger[ledger["cause"] > 0]
    fields = ("step", "round", "connection", "frame", "sender", "receiver", "map", "cause")
    frames = np.array([cut[name] for name in fields], np.int64)
    connected = cut["connection"] >= 0
    # Frames without a connection end where the order of the rows breaks: within a frame kinds ascend.
    starts = np.ones(len(cut), np.bool_)
    starts[1:] = (frames[:, 1:] != frames[:, :-1]).any(axis=0) | (cut["kind"][1:] <= cut["kind"][:-1])
    distinct = np.unique(frames[:, connected], axis=1)
    causes = np.concatenate([distinct[-1], cut["cause"][starts & ~connected]])
    counts = np.bincount(causes, minlength=len(CAUSES)).tolist()
    return {cause: count for cause, count in zip(CAUSES, counts, strict=True) if cause and count}
