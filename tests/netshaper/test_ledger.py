"""The ledger: the order of rows does not depend on the order of logging, and the balance conserves bytes."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from netshaper.ledger import CAUSES, EVERYONE, KIND_NUMBER, ROW, balance, sort_rows
from protocol.packets import ALL_KINDS

rows = st.lists(st.tuples(*[st.integers(-2, 3)] * len(ROW.names or ())), max_size=12)


@given(rows, st.randoms())
def test_sorting_does_not_depend_on_the_order_of_logging(
    logged: list[tuple[int, ...]], random: object
) -> None:
    shuffled = list(logged)
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    ours, theirs = sort_rows(np.array(logged, ROW)), sort_rows(np.array(shuffled, ROW))
    assert ours.tobytes() == theirs.tobytes()
    assert ours.tolist() == sorted(logged)


def test_the_balance_of_each_step_has_sent_carried_cut_and_received_bytes() -> None:
    def row(step: int, receiver: int, size: int, carried: int, received: int) -> tuple[int, ...]:
        return (step, 0, 0, 0, 0, receiver, 0, 0, 1, size, carried, 0 if carried else 1, received)

    logged = [row(1, 1, 5, 1, 1), row(1, 1, 7, 0, 0), row(1, EVERYONE, 3, 1, 4), row(2, 1, 2, 1, 1)]
    assert balance(np.array(logged, ROW)) == {1: (15, 8, 7, 5), 2: (2, 2, 0, 2)}


def test_every_kind_and_every_cause_has_a_number() -> None:
    assert [KIND_NUMBER[kind] for kind in ALL_KINDS] == list(range(len(ALL_KINDS)))
    assert CAUSES[0] == ""
    assert len(set(CAUSES)) == len(CAUSES)


def test_an_empty_ledger_balances() -> None:
    assert balance(np.empty(0, ROW)) == {}
