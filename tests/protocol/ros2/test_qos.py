"""Quality of service in liveliness tokens."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.errors import ProtocolError
from protocol.ros2.qos import (
    DEFAULT,
    FOREVER_NS,
    LATCHED,
    SENSOR,
    Durability,
    History,
    Liveliness,
    Qos,
    Reliability,
    parse_qos,
)

durations = st.just(FOREVER_NS) | st.integers(0, FOREVER_NS) | st.integers(0, 10**10)
profiles = st.builds(
    Qos,
    st.sampled_from(Reliability),
    st.sampled_from(Durability),
    st.sampled_from(History),
    st.integers(1, 100),
    durations,
    durations,
    st.sampled_from(Liveliness),
    durations,
)


@pytest.mark.parametrize(
    ("qos", "text"),
    [
        (DEFAULT, "::,10:,:,:,,"),
        (LATCHED, ":1:,1:,:,:,,"),
        (SENSOR, "2::,5:,:,:,,"),
        (Qos(depth=7), "::,7:,:,:,,"),
        (Qos(depth=42), "::,:,:,:,,"),
        (Qos(history=History.KEEP_ALL), "::2,10:,:,:,,"),
        (Qos(deadline_ns=1_500_000_000), "::,10:1,500000000:,:,,"),
        (Qos(liveliness=Liveliness.MANUAL_BY_TOPIC, lease_ns=2 * 10**9), "::,10:,:,:3,2,0"),
    ],
)
def test_profiles_have_the_text_of_rmw_zenoh(qos: Qos, text: str) -> None:
    assert str(qos) == text
    assert parse_qos(text) == qos


@given(profiles)
def test_profiles_are_parsed_to_what_they_were(qos: Qos) -> None:
    assert parse_qos(str(qos)) == qos


def test_explicit_defaults_mean_the_same_as_empty_fields() -> None:
    assert parse_qos("1:2:1,10:9223372036,854775807:,:1,,") == DEFAULT


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "1 fields between colons instead of 6"),
        ("::,10:,:,", "5 fields"),
        ("::10:,:,:,,", "history has 1 numbers between commas instead of 2"),
        ("::,10:,:,:,", "liveliness has 2 numbers"),
        ("9::,10:,:,:,,", "9 is not a valid Reliability"),
        ("::,-1:,:,:,,", "'-1' is not a number"),
        ("::,0:,:,:,,", "depth 0 is not from 1"),
        ("::,10:99999999999,0:,:,,", "is not from 0 to"),
    ],
)
def test_a_malformed_profile_gets_an_error_that_names_the_field(text: str, reason: str) -> None:
    with pytest.raises(ProtocolError, match=reason):
        parse_qos(text)


@given(st.text("0123456789:,-", max_size=30))
def test_any_text_is_parsed_or_refused(text: str) -> None:
    with contextlib.suppress(ProtocolError):
        assert parse_qos(str(parse_qos(text))) == parse_qos(text)
