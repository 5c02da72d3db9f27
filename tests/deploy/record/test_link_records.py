"""What a robot in the field records: a capture, a ledger, and the numbers of all frames."""

from __future__ import annotations

from pathlib import Path

import pytest
from pyarrow import parquet

from agent.radios.options import LinkOptions
from agent.radios.peer_medium import FrameRecord
from deploy.record.link_records import FRAMES, LinkRecorder, frame_log, read_frames
from netshaper import capture, pcapng
from protocol.nanoseconds import SECOND
from protocol.packet_codec import encode
from protocol.packets import HeldFirst, Pose
from tests.agent.radios.air_team import AirTeam
from tests.agent.radios.memory_air import Faults, MemoryAir
from tests.system.team import small_plan

POSE, REPORT = encode([Pose(3, 4, 0)]), encode([HeldFirst(1, 2)])


def test_every_robot_writes_what_it_sent_and_received(tmp_path: Path) -> None:
    plan = small_plan(side_m=10.0, map_encoding="predictive", dissemination="gossip", robots=2, seed=1)
    options = LinkOptions("udp", interface="lo", bytes_per_s=1000)
    air = MemoryAir(3, Faults(loss=0.2))
    team = AirTeam(plan, options, lambda number: air.join(number, 1400), tmp_path / "state")
    recorders = [LinkRecorder(tmp_path / f"r{number}", number) for number in range(2)]
    for member, recorder in zip(team.members.values(), recorders, strict=True):
        member.field.record = recorder.record
    for _ in range(20):
        team.play()
    for recorder in recorders:
        recorder.close()

    by_robot = [read_frames(tmp_path / f"r{number}") for number in range(2)]
    for number, member in team.members.items():
        mine = [line for line in by_robot[number] if line.sender == number]
        assert [line.bytes for line in mine] == [len(frame) for frame in member.sent]
        theirs = {line.counter for line in by_robot[1 - number] if line.sender == number}
        assert 0 < len(theirs) < len(mine)
        assert theirs <= {line.counter for line in mine}

    ledger = parquet.read_table(tmp_path / "r0" / "ledger.parquet").to_pylist()
    with (tmp_path / "r0" / "radio.pcapng").open("rb") as file:
        captured = list(capture.read(pcapng.Reader(file)))
    assert sum(row["bytes"] for row in ledger) == sum(packet.size for packet in captured)
    assert {(row["sender"], row["connection"]) for row in ledger} == {
        (packet.sender, packet.connection) for packet in captured
    }
    assert {packet.comment.split(":")[0] for packet in captured} == {"sent", "received by r0"}
    assert sum(line.broadcast + line.gossip for line in by_robot[0]) == sum(row["bytes"] for row in ledger)


def test_a_frame_is_two_packets_of_the_capture_and_a_malformed_one_is_kept(tmp_path: Path) -> None:
    recorder = LinkRecorder(tmp_path, 1)
    recorder.record(7, [FrameRecord(9 * SECOND, 7, 0, 2, 5, 30, POSE, REPORT)])
    recorder.record(8, [FrameRecord(9 * SECOND, 8, 0, 2, 6, 30, b"", b"\xff\xff\xff")])
    recorder.record(9, [FrameRecord(9 * SECOND, 9, 1, 3, 0, 14, b"", b"")])
    recorder.close()
    with (tmp_path / "radio.pcapng").open("rb") as file:
        captured = list(capture.read(pcapng.Reader(file)))
    assert [(each.step, each.payload) for each in captured] == [
        (7, POSE),
        (7, REPORT),
        (8, b"\xff\xff\xff"),
    ]
    assert captured[0].comment == "received by r1: frame 5 of session 2, 30 bytes sealed"
    assert captured[0].receivers == [1]
    kinds = parquet.read_table(tmp_path / "ledger.parquet").column("kind").to_pylist()
    assert kinds == ["pose", "conn", "malformed"]
    assert not len(frame_log(1, [FrameRecord(0, 9, 1, 3, 0, 14, b"", b"")]))


def test_an_existing_capture_is_never_overwritten(tmp_path: Path) -> None:
    LinkRecorder(tmp_path, 0).close()
    with pytest.raises(FileExistsError):
        LinkRecorder(tmp_path, 0)


HEAD = b"robot,time_ns,step,sender,session,counter,bytes,broadcast,gossip\n"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        (b"", "the first line must be robot"),
        (b"no end of a line", "the first line must be robot"),
        (HEAD + b"1\r2\n", "line 2: new-line character"),
        (HEAD + b"1,2\n", "line 2: has 2 values; must have 9"),
        (HEAD + b"1,0,one,0,1,0,14,0,0\n", "line 2: step = 'one': must be `int`$"),
        (HEAD + b'"' + b"1" * 200_000 + b"\n", "line 2: field larger than field limit"),
        (
            HEAD + b"1,0,1,0,1,0,14,0,0\n1,0,1,256,1,0,14,0,0\n",
            "line 3: sender = '256': must be `int` <= 255",
        ),
        (HEAD + b"1,0,-1,0,1,0,14,0,0\n", "line 2: step = '-1': must be `int` >= 0"),
        (HEAD + b"1," + b"9" * 30 + b",1,0,1,0,14,0,0\n", "line 2: time_ns = '9.*: must be `int` <= "),
    ],
)
def test_damaged_frame_lists_are_refused(tmp_path: Path, text: bytes, problem: str) -> None:
    (tmp_path / FRAMES).write_bytes(text)
    with pytest.raises(ValueError, match=problem):
        read_frames(tmp_path)


def test_a_line_that_was_being_written_is_ignored(tmp_path: Path) -> None:
    (tmp_path / FRAMES).write_bytes(HEAD + b"1,5,1,0,1,0,14,0,0\n1,6,1,0,1,")
    assert [line.time_ns for line in read_frames(tmp_path)] == [5]
