"""Train the table of features by which the predictive encoding codes poses on narrow media.

``python -m deploy.study.pose_table FILE.npz`` writes it to a file.

The program runs explorations of generated maps, encodes them as `deploy.study.wall_table` does, and notes the features
of all candidate cells of each pose (`agent.predictive.pose_model`). The table has the factors with which the
chosen cells are most likely; large factors are penalized. The result is shipped as
`agent.predictive.pose_model.TABLE`; encoder and decoder must have the same table.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from agent.predictive.coder import Coder
from agent.predictive.contexts import CONTEXTS, MORE_SCANS_NARROW
from agent.predictive.pose_model import (
    FEATURES,
    FIRST_RING,
    LOG_UNIT,
    RINGS,
    VALUES,
    Factors,
    describe,
    leaving,
)
from agent.predictive.scan_stream import ScanStream
from agent.predictive.scan_updates import DX, DY, SCANS
from agent.predictive.wall_model import start_model
from deploy.scenario.plan import Plan
from deploy.study.wall_table import explorations, make_streams, train_on

PENALTY = 2e-3
"""Weight of the mean square of the logarithms of the factors, against the mean code length in nats."""

MOST_COUNTED = 48
"""Maximum sum of the initial counts of a context."""

Example = tuple[NDArray[np.int16], int]
"""A choice: the columns of the table of each candidate's features, shape (n, `FEATURES`), and the index of the chosen
candidate. The last candidate, with the same column in all places, is leaving the ring."""


class _Receiver(ScanStream):
    """A decoder that notes the candidates of each pose that it decodes."""

    def __init__(self, *args: Any, examples: Sequence[list[Example]], **options: Any) -> None:
        super().__init__(*args, **options)
        self._examples = examples
        """By ring."""

    def _read_pose(self, coder: Coder) -> tuple[int, int]:
        before, grid = self._motion.copy(), self.grid.copy()
        pose = super()._read_pose(coder)
        if before[SCANS]:
            went = int(self._motion[DX]), int(self._motion[DY])
            for ring in range(RINGS):
                outer = FIRST_RING << ring
                side = 2 * outer + 1
                features = np.empty((side * side, FEATURES), np.int16)
                describe(grid, before, self._speed, ring, features)
                chosen = (went[1] + outer) * side + went[0] + outer
                leaves = max(map(abs, went)) > outer
                places = np.flatnonzero(features[:, 0] >= 0)
                index = len(places) if leaves else int(np.searchsorted(places, chosen))
                leaving_row = np.full((1, FEATURES), leaving(before), np.int16)
                self._examples[ring].append((np.concatenate([features[places], leaving_row]), index))
                if not leaves:
                    break
        return pose


def decoded(plan: Plan, updates: Iterable[tuple[int, bytes]]) -> tuple[list[list[Example]], NDArray[np.int64]]:
    """Decode the updates of `train_on`; return examples by ring, and the counts of contexts of more scans."""
    examples: list[list[Example]] = [[] for _ in range(RINGS)]
    receivers, model = make_streams(plan, _Receiver, examples=examples), start_model()
    first = receivers[0].counts[MORE_SCANS_NARROW:].astype(np.int64)
    for robot, message in updates:
        receivers[robot].model = model
        assert receivers[robot].decode(message) is not None
        receivers[robot].commit()
        model = receivers[robot].model
    return examples, sum((each.counts[MORE_SCANS_NARROW:] - first for each in receivers), start=0 * first)


def fitted(examples: Sequence[Example]) -> NDArray[np.float64]:
    """Return the logarithms of the factors, shape (`VALUES`,), with which the chosen candidates are most likely."""
    columns = np.concatenate([features for features, _ in examples]).astype(np.int64)
    sizes = np.array([len(features) for features, _ in examples])
    first = np.cumsum(sizes) - sizes
    chosen = first + np.array([index for _, index in examples])
    is_leaving = np.zeros(len(columns), np.bool_)
    is_leaving[first + sizes - 1] = True
    once = np.where(is_leaving[:, None], [1.0] + [0.0] * (FEATURES - 1), 1.0)
    observed = np.bincount(columns[chosen].ravel(), once[chosen].ravel(), VALUES)

    def loss(logs: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        scores = (logs[columns] * once).sum(axis=1)
        scores -= np.repeat(np.maximum.reduceat(scores, first), sizes)
        weights = np.exp(scores)
        sums = np.add.reduceat(weights, first)
        chances = weights / np.repeat(sums, sizes)
        expected = np.bincount(columns.ravel(), (chances[:, None] * once).ravel(), VALUES)
        nats = (np.log(sums) - scores[chosen]).mean()
        penalty = PENALTY * (logs**2).mean()
        return nats + penalty, (expected - observed) / len(examples) + 2 * PENALTY * logs / VALUES

    result = minimize(loss, np.zeros(VALUES), jac=True, method="L-BFGS-B", options={"maxiter": 80})
    logs: NDArray[np.float64] = result.x
    return logs


def rounded(logs: NDArray[np.float64]) -> Factors:
    """Round natural logarithms, shape (`RINGS`, `VALUES`), to the units of the table."""
    return np.clip(np.rint(logs / np.log(2) * LOG_UNIT), -127, 127).astype(np.int8)


def train() -> tuple[Factors, NDArray[np.uint16]]:
    """Train the factors and the counts."""
    examples: list[list[Example]] = [[] for _ in range(RINGS)]
    counts = np.zeros((CONTEXTS - MORE_SCANS_NARROW, 2), np.int64)
    for title, plan, senses in explorations():
        found, more = decoded(plan, train_on(plan, senses, start_model())[1])
        for ring, new in zip(examples, found, strict=True):
            ring += new
        counts += more
        print(f"{title}, {len(found[0])} poses", flush=True)
    weight = np.minimum(1, MOST_COUNTED / np.maximum(counts.sum(axis=1), 1))
    return rounded(np.stack([fitted(ring) for ring in examples])), np.rint(counts * weight[:, None]).astype(np.uint16)


if __name__ == "__main__":
    factors, counts = train()
    np.savez_compressed(sys.argv[1], factors=factors, counts=counts)
