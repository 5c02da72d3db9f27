"""Train the factors and counts with which the predictive encoding codes poses, and other parts, on narrow media.

``python -m deploy.study.narrow_table FILE.npz`` writes them to a file.

The program runs explorations of generated maps, encodes them as `deploy.study.wall_table` does, and decodes them again.
It notes the features of all candidate cells of each pose (`agent.predictive.pose_model`). With the fitted factors, the
poses are most likely; large logarithms of factors are penalized. The counts are those of all decoded decisions. The
result is shipped as `agent.predictive.contexts.NARROW_TABLE`; encoder and decoder must have the same table.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from agent.predictive import pose_model
from agent.predictive.coder import NUMBER, Coder
from agent.predictive.contexts import BASES, MORE_SCANS_NARROW, SAME_MOTION
from agent.predictive.pose_model import FEATURES, RINGS, VALUES, Factors
from agent.predictive.scan_stream import ScanStream
from agent.predictive.scan_updates import DX, DY, SCANS
from agent.predictive.wall_model import start_model
from deploy.scenario.plan import Plan
from deploy.study.training import explorations
from deploy.study.wall_table import FIRST_SEED, RUNS, make_streams, train_on
from protocol.messages import Sense

PENALTY = 3e-4
"""Weight of half the sum of the squared logarithms of the factors, against the mean code length in nats."""

COUNTED = np.array(
    [*range(SAME_MOTION, BASES + 2 * NUMBER), *range(MORE_SCANS_NARROW, MORE_SCANS_NARROW + 4)], np.int32
)
"""Contexts that begin with other counts than on wide media: those of far poses, of dependencies, and of more scans."""

MOST_COUNTED = 12
"""Maximum sum of the initial counts of a context."""

Example = tuple[NDArray[np.int16], int]
"""A choice: the columns of the table of each candidate's features, shape (n, `FEATURES`), and the index of the chosen
candidate. The last candidate, with the same column in all places, is a pose beyond the ring."""


class _Receiver(ScanStream):
    """A decoder that notes the candidates of each pose that it decodes."""

    def __init__(self, *args: Any, examples: Sequence[list[Example]], **options: Any) -> None:
        super().__init__(*args, **options)
        self._examples = examples
        """By ring."""

    def _read_pose(self, coder: Coder) -> tuple[int, int]:
        assert self._narrow is not None
        before, grid = self._motion.copy(), self.grid.copy()
        pose = super()._read_pose(coder)
        if before[SCANS]:
            went = int(self._motion[DX]), int(self._motion[DY])
            for ring in range(RINGS):
                outer = pose_model.FIRST_RING << ring
                side = 2 * outer + 1
                features = np.empty((side * side, FEATURES), np.int16)
                pose_model.describe(grid, before, self._narrow.milli_speed, ring, features)
                chosen = (went[1] + outer) * side + went[0] + outer
                leaves = max(map(abs, went)) > outer
                places = np.flatnonzero(features[:, 0] >= 0)
                index = len(places) if leaves else int(np.searchsorted(places, chosen))
                others = np.full((1, FEATURES), pose_model.beyond(before), np.int16)
                self._examples[ring].append((np.concatenate([features[places], others]), index))
                if not leaves:
                    break
        return pose


def examine(plan: Plan, senses: list[list[Sense]]) -> tuple[list[list[Example]], NDArray[np.int64]]:
    """Encode an exploration and decode it again; return examples by ring, and the counts of `COUNTED`."""
    examples: list[list[Example]] = [[] for _ in range(RINGS)]
    authors, receivers = make_streams(plan), make_streams(plan, _Receiver, examples=examples)
    for stream in (*authors, *receivers):
        stream.counts[COUNTED] = 0
    model = start_model()
    for robot, message in train_on(authors, senses, model)[1]:
        receiver = receivers[robot]
        receiver.model = model
        assert receiver.decode(message) is not None
        receiver.commit()
        model = receiver.model
    return examples, np.sum([each.counts[COUNTED] for each in receivers], axis=0, dtype=np.int64)


def fitted(examples: Sequence[Example]) -> NDArray[np.float64]:
    """Return the logarithms of the factors, shape (`VALUES`,), with which the chosen candidates are most likely."""
    columns = np.concatenate([features for features, _ in examples]).astype(np.int64)
    sizes = np.array([len(features) for features, _ in examples])
    first = np.cumsum(sizes) - sizes
    chosen = first + np.array([index for _, index in examples])
    is_beyond = np.zeros(len(columns), np.bool_)
    is_beyond[first + sizes - 1] = True
    once = np.where(is_beyond[:, None], [1.0] + [0.0] * (FEATURES - 1), 1.0)
    observed = np.bincount(columns[chosen].ravel(), once[chosen].ravel(), VALUES)

    def loss(logs: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
        scores = (logs[columns] * once).sum(axis=1)
        scores -= np.repeat(np.maximum.reduceat(scores, first), sizes)
        weights = np.exp(scores)
        sums = np.add.reduceat(weights, first)
        chances = weights / np.repeat(sums, sizes)
        expected = np.bincount(columns.ravel(), (chances[:, None] * once).ravel(), VALUES)
        nats = (np.log(sums) - scores[chosen]).mean()
        penalty = PENALTY / 2 * (logs**2).sum()
        return nats + penalty, (expected - observed) / len(examples) + PENALTY * logs

    result = minimize(loss, np.zeros(VALUES), jac=True, method="L-BFGS-B", options={"maxiter": 80})
    logs: NDArray[np.float64] = result.x
    return logs


def rounded(logs: NDArray[np.float64]) -> Factors:
    """Round natural logarithms, shape (`RINGS`, `VALUES`), to the units of the table."""
    factors: Factors = np.clip(np.rint(logs / np.log(2) * pose_model.LOG_UNIT), -127, 127).astype(np.int8)
    return factors


def train() -> dict[str, NDArray[Any]]:
    """Train the arrays of the table."""
    examples: list[list[Example]] = [[] for _ in range(RINGS)]
    total = np.zeros((len(COUNTED), 2), np.int64)
    for title, plan, senses in explorations(RUNS, FIRST_SEED):
        found, counts = examine(plan, senses)
        for ring, new in enumerate(found):
            examples[ring] += new
        total += counts
        print(f"{title}, {len(found[0])} poses", flush=True)
    weight = np.minimum(1, MOST_COUNTED / np.maximum(total.sum(axis=1), 1))
    trained = np.rint(total * weight[:, None]).astype(np.uint16)
    used = total.any(axis=1)
    factors = rounded(np.stack([fitted(ring) for ring in examples]))
    return {"factors": factors, "contexts": COUNTED[used], "counts": trained[used]}


if __name__ == "__main__":
    np.savez_compressed(sys.argv[1], **train())  # type: ignore[arg-type]
