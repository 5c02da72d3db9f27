"""Packets of updates: narrow budgets are filled, and no packet is too long for a step."""

from __future__ import annotations

import math

from hypothesis import given
from hypothesis import strategies as st

from agent.encoding_options import PredictiveOptions
from agent.encodings.update_packets import (
    FULL_TILE_STEPS,
    NARROW,
    NARROW_APART,
    SHORTEST,
    UpdateLimits,
    content_in,
)
from agent.settings import EncodingSettings, MediumSettings, ReplicationSettings, Settings
from protocol.body import Body
from protocol.budget import Budget
from protocol.packet_codec import decode_kind
from protocol.packets import EARLY, From, FromEarly, Target, Update

LEAST = From.size + SHORTEST
"""The smallest budget of a step that holds any packet behind a header."""

messages = st.binary(min_size=1, max_size=400)
offsets = st.integers(0, 2 * EARLY)


def limits(
    budget: int,
    *,
    requires_acks: bool = False,
    frame_bytes: int | None = None,
    reach: float = math.inf,
    tolerance: int = 0,
) -> UpdateLimits:
    options = PredictiveOptions("team")
    return UpdateLimits.of(
        Settings(
            robot=0, bodies=8 * (Body(50.0, 360.0, 1.0),), width=20, height=20, beams=36, seed=0,
            strategy="meier", encoding=EncodingSettings("predictive", tolerance=tolerance, predictive=options),
            replication=ReplicationSettings("gossip", requires_acks=requires_acks),
            medium=MediumSettings(Budget(budget), reach, frame_bytes),
        )
    )  # fmt: skip


@given(st.integers(LEAST, 200), messages, st.integers(0, 9), offsets, st.booleans())
def test_a_step_holds_any_packet_behind_the_header_that_names_its_offset(
    budget: int, message: bytes, number: int, offset: int, requires_acks: bool
) -> None:
    packets = limits(budget, requires_acks=requires_acks).packets(message, number, offset)
    assert b"".join(packet.data for packet in decode_kind(b"".join(packets), Update)) == message
    for at, packet in enumerate(packets, offset):
        header = FromEarly if at < EARLY else From
        assert header.size + len(packet) <= budget


@given(st.integers(14, 20), messages, st.integers(0, EARLY // 2))
def test_a_packet_and_a_target_fill_a_budget_that_is_too_small_for_more(
    budget: int, message: bytes, offset: int
) -> None:
    *full, last = limits(budget).packets(message, 0, offset)
    assert all(len(packet) + Target.size == budget for packet in full)
    assert len(last) + Target.size <= budget


@given(st.integers(14, NARROW - 1), messages, st.integers(0, EARLY // 2))
def test_a_packet_of_tiles_and_a_target_fill_a_narrow_budget(
    budget: int, message: bytes, offset: int
) -> None:
    some = limits(budget, tolerance=1)
    *full, last = some.packets(message, 0, offset)
    assert all(len(packet) + Target.size == budget for packet in full)
    assert len(last) + Target.size <= budget
    content = content_in(budget - Target.size)
    assert some.step_bytes == FULL_TILE_STEPS * content


def test_with_a_short_range_packets_of_tiles_are_short_but_updates_are_as_long() -> None:
    some = limits(25, tolerance=1, reach=5.0)
    assert some.fills == 0
    assert some.step_bytes == FULL_TILE_STEPS * 25


@given(messages, offsets)
def test_packets_on_a_lossy_or_a_wide_medium_are_short(message: bytes, offset: int) -> None:
    for some in (
        limits(20, requires_acks=True),
        limits(21),
        limits(20, frame_bytes=SHORTEST),
    ):
        assert all(len(packet) <= SHORTEST for packet in some.packets(message, 0, offset))


@given(st.integers(1, 400))
def test_a_medium_is_narrow_below_its_limit_and_sooner_for_scans_where_robots_may_leave_each_others_range(
    budget: int,
) -> None:
    assert limits(budget).is_narrow == limits(budget, tolerance=1).is_narrow == (budget < NARROW)
    assert limits(budget, reach=20.0).is_narrow == (budget < NARROW_APART)
    assert limits(budget, tolerance=1, reach=20.0).is_narrow == (budget < NARROW)
