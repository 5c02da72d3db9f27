"""The capture: the file has every byte of the ledger, and a truncated file can be read."""

from __future__ import annotations

import io
from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import astuple

from netshaper import capture, pcapng
from netshaper.capture import KEPT, PART, VERDICTS, Captured
from netshaper.frame_log import comment
from netshaper.ledger import EVERYONE
from netshaper.pcapng import CaptureError, Reader
from netshaper.settings import RadioSettings
from protocol.budget import Budget
from protocol.messages import OutgoingFrame, RobotFrames
from protocol.packet_codec import encode
from protocol.packets import Delete, Save
from tests.netshaper import plain_ledger
from tests.netshaper.network import Network
from tests.netshaper.plain_ledger import LoggedFrame, received_by
from tests.netshaper.scripted_robots import ByzantineRobot, Robot

small = st.integers(-1, 63)
logged_frames = st.builds(
    LoggedFrame,
    round=st.integers(0, 15),
    connection=st.integers(-1, 2**31 - 1),
    frame=st.integers(0, 3),
    sender=st.integers(0, 63),
    receiver=small | st.just(-99),
    map=small,
    verdict=st.integers(0, len(VERDICTS) - 1),
    receivers=st.integers(0, 2**64 - 1),
    payload=st.binary(max_size=200),
    reason=st.text(max_size=30),
)
steps = st.lists(st.tuples(st.integers(0, 2**32 - 1), st.lists(logged_frames, max_size=5)), max_size=5)


def read(file: bytes) -> list[Captured]:
    reader = Reader(io.BytesIO(file))
    frames = list(capture.read(reader))
    assert reader.torn == 0
    return frames


def write(steps: list[tuple[int, list[LoggedFrame]]]) -> bytes:
    return capture.head("a test") + b"".join(
        capture.encode(step, plain_ledger.log_of(seen)) for step, seen in steps
    )


def test_a_file_begins_as_every_pcapng_file_does() -> None:
    head = capture.head("8 robots")
    assert head[:4] == bytes.fromhex("0a0d0d0a")
    assert head[8:12] == bytes.fromhex("4d3c2b1a")
    assert len(head) % 4 == 0
    assert b"8 robots" in head


@given(steps)
def test_decoding_inverts_encoding(frames_by_step: list[tuple[int, list[LoggedFrame]]]) -> None:
    wanted = [(step, seen) for step, frames in frames_by_step for seen in frames]
    for (step, seen), found in zip(wanted, read(write(frames_by_step)), strict=True):
        kept = seen.payload if seen.verdict == 0 else seen.payload[:KEPT]
        receivers = received_by(seen)
        assert found == Captured(
            step, *seen[:7], receivers, 0, len(seen.payload), kept,
            comment(seen.verdict, seen.receiver, tuple(receivers), seen.reason),
        )  # fmt: skip


wide_frames = plain_ledger.logged_frames(st.binary(max_size=200))


@given(st.integers(0, 2**32 - 1), st.lists(logged_frames | wide_frames, max_size=8))
def test_the_capture_is_that_of_the_plain_reference(step: int, seen: list[LoggedFrame]) -> None:
    assert capture.encode(step, plain_ledger.log_of(seen)) == plain_ledger.blocks(step, seen)


@given(st.lists(wide_frames, max_size=5))
def test_robots_beyond_the_short_header_are_read_back(seen: list[LoggedFrame]) -> None:
    for wanted, found in zip(seen, read(write([(1, seen)])), strict=True):
        kept = wanted.payload if wanted.verdict == 0 else wanted.payload[:KEPT]
        assert astuple(found)[1:9] == (*wanted[:7], received_by(wanted))
        assert found.payload == kept


@given(steps, st.integers(0, 10**6))
def test_a_file_that_was_cut_anywhere_opens_up_to_its_last_whole_packet(
    frames_by_step: list[tuple[int, list[LoggedFrame]]], cut: int
) -> None:
    head, whole = len(capture.head("a test")), write(frames_by_step)
    cut = head + cut % (len(whole) - head + 1)
    reader = Reader(io.BytesIO(whole[:cut]))
    found = list(capture.read(reader))
    assert found == read(whole)[: len(found)]
    assert read(whole[: cut - reader.torn]) == found


@given(st.integers(1, 4), st.integers(0, 2**32 - 1), st.sampled_from((None, 0, 7, 60, 500)))
def test_the_capture_has_every_byte_of_the_ledger(robots: int, seed: int, budget: int | None) -> None:
    script = {n: (ByzantineRobot if n == 0 else Robot)(n, robots, seed) for n in range(robots)}
    network = Network(RadioSettings(robots, seed, 6.0, Budget(budget)), script)
    file = capture.head("a test")
    logged: Counter[tuple[int, ...]] = Counter()
    frames_by_step = received = 0
    names = ("step", "round", "connection", "frame", "sender", "receiver", "map", "cause")
    for number in range(1, 4):
        step = network.step(number, {n: (2 * n, number) for n in range(robots)})
        file += step.report.frames
        for row in step.rows:
            logged[tuple(int(row[name]) for name in names)] += int(row["bytes"])
        frames_by_step += sum(len(payload) for _, payload in step.submitted)
        received += int((step.rows["bytes"] * step.rows["received_by"]).sum())
    found: Counter[tuple[int, ...]] = Counter()
    captured = 0
    for frame in read(file):
        found[astuple(frame)[:8]] += frame.size
        captured += frame.size * len(frame.receivers)
    assert +found == +logged
    assert captured == received


def test_frames_sent_between_steps_are_logged_in_the_next_one() -> None:
    network = Network(RadioSettings(2, 0, 9.0), {n: Robot(n, 2, 0) for n in range(2)})
    network.step(1, {0: (0, 0), 1: (1, 1)})
    late = OutgoingFrame(1, encode([Save(), Save(), Save()]))
    network.radio.submit(0, RobotFrames(1, 0, "offers", frames=[late]))
    step = network.step(2, {0: (0, 0), 1: (1, 1)})
    rows, first = step.rows, read(capture.head("") + step.report.frames)[0]
    assert (first.step, first.sender, first.verdict, first.size) == (2, 0, "protocol", 3)
    assert first.comment == "refused: spoke out of turn"
    assert int(rows["bytes"][rows["cause"] > 0].sum()) == 3


def test_times_are_the_step_in_seconds_and_the_position_in_it_in_microseconds() -> None:
    seen = LoggedFrame(0, 0, 2, 0, 1, 0, 0, 2, b"\xf0")
    reader = Reader(io.BytesIO(write([(7, [seen, seen]), (8, [seen])])))
    assert [packet.time_us for packet in reader] == [7_000_000, 7_000_001, 8_000_000]


def test_a_frame_too_long_for_one_packet_of_wireshark_is_several_that_hold_whole_packets() -> None:
    payload = encode([Delete(n % 4096) for n in range(PART + 1)])
    seen = [LoggedFrame(0, 0, 2, 0, 1, 0, 0, 2, payload)]
    assert capture.encode(1, plain_ledger.log_of(seen)) == plain_ledger.blocks(1, seen)
    frames = read(write([(1, seen)]))
    assert [frame.part for frame in frames] == [0, 1, 2]
    assert b"".join(frame.payload for frame in frames) == payload
    assert all(plain_ledger.HEAD.size + frame.size <= 262_144 for frame in frames)
    assert all(frame.size % 2 == 0 for frame in frames)


@pytest.mark.parametrize(
    ("receiver", "verdict", "receivers", "reason", "text"),
    [
        (3, 0, 0b1000, "", "delivered"),
        (EVERYONE, 0, 0b1011, "", "delivered to r0, r1, r3"),
        (EVERYONE, 0, 0, "", "on the air, but nobody was in range"),
        (3, 1, 0, "", "cut by budget"),
        (3, 2, 0, "", "out of range"),
        (3, 3, 0, "spoke out of turn", "refused: spoke out of turn"),
        (3, 4, 0, "", "a partner died"),
    ],
)
def test_the_comment_has_the_fate_of_a_frame(
    receiver: int, verdict: int, receivers: int, reason: str, text: str
) -> None:
    seen = LoggedFrame(0, 0, 0, 1, receiver, 0, verdict, receivers, b"\xc0\x00", reason)
    assert read(write([(1, [seen])]))[0].comment == text


@pytest.mark.parametrize(
    ("file", "reason"),
    [
        (b"", "not a pcapng file"),
        (b"a picture, perhaps", "not a pcapng file"),
        (
            pcapng.head(1, "x", "y", "z") + plain_ledger.packet(0, bytes(40), 40, ""),
            "link type 1 instead of 147",
        ),
        (capture.head("") + plain_ledger.packet(0, b"\x07", 1, ""), "without a header of version 1 or 2: 07"),
        (capture.head("") + plain_ledger.packet(0, b"\x01\x09" + bytes(22), 24, ""), "frame 9 and verdict 0"),
        (capture.head("") + b"\x06\x00\x00\x00\x0d\x00\x00\x00" + bytes(8), "a block of 13 bytes"),
        (capture.head("") + b"\x06\x00\x00\x00\x10\x00\x00\x00" + bytes(8), "whose two lengths differ"),
    ],
)
def test_other_files_are_refused_with_the_reason(file: bytes, reason: str) -> None:
    with pytest.raises(CaptureError, match=reason):
        read(file)
