"""The 33 bytes that accompany each message."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st
from zenoh import ext

from protocol.errors import ProtocolError
from protocol.ros2.attachments import Attachment, decode_attachment

numbers = st.integers(0, 2**63 - 1)
attachments = st.builds(Attachment, numbers, numbers, st.binary(min_size=16, max_size=16))


def test_an_attachment_has_the_bytes_of_rmw_zenoh() -> None:
    data = Attachment(1, 0x17_02_03_04_05_06_07_08, bytes(range(16))).encode()
    assert data.hex() == "0100000000000000080706050403021710000102030405060708090a0b0c0d0e0f"
    assert len(data) == 33


@given(attachments)
def test_an_attachment_is_what_zenoh_serializes(attachment: Attachment) -> None:
    fields = (ext.Int64(attachment.sequence), ext.Int64(attachment.stamp_ns), attachment.gid)
    serialized = ext.z_serialize(fields)
    assert attachment.encode() == serialized.to_bytes()


@given(attachments)
def test_attachments_are_decoded_to_what_they_were(attachment: Attachment) -> None:
    assert decode_attachment(attachment.encode()) == attachment


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (None, "none instead of 33 bytes"),
        (b"", "0 bytes instead of 33 bytes"),
        (bytes(34), "34 bytes instead of 33 bytes"),
        (bytes(16) + b"\x0f" + bytes(16), "at byte 16: length of the gid is 15 instead of 16"),
        (b"\xff" * 8 + bytes(8) + b"\x10" + bytes(16), "negative: sequence number -1"),
    ],
)
def test_a_malformed_attachment_gets_an_error(data: bytes | None, reason: str) -> None:
    with pytest.raises(ProtocolError, match=reason):
        decode_attachment(data)


@given(st.binary(min_size=33, max_size=33))
def test_any_33_bytes_are_decoded_to_themselves_or_refused(data: bytes) -> None:
    with contextlib.suppress(ProtocolError):
        assert decode_attachment(data).encode() == data
