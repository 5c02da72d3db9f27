"""The ledger rows of a step against a reference that decodes every packet."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from netshaper.ledger import ROW
from protocol.packet_codec import encode
from tests.netshaper import plain_ledger
from tests.netshaper.plain_ledger import LoggedFrame
from tests.protocol.test_packets import streams

logged_frames = plain_ledger.logged_frames(streams.map(encode) | st.binary(max_size=40))


@given(st.integers(0, 2**31 - 1), st.lists(logged_frames, max_size=8))
def test_rows_are_those_of_reading_every_packet(step: int, seen: list[LoggedFrame]) -> None:
    rows = np.frombuffer(plain_ledger.log_of(seen).ledger_rows(step), ROW)
    assert rows.tolist() == plain_ledger.rows(step, seen)
