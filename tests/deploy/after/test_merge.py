"""`murmur merge`: recordings of several robots become one, on one clock."""

from __future__ import annotations

import dataclasses
import shutil
from functools import cache
from pathlib import Path

import pytest
from msgspec import structs
from pyarrow import parquet

from deploy.after.merge import (
    MAX_DRIFT_PPM,
    UNKNOWN,
    FrameId,
    RobotRecord,
    align,
    join,
    merge,
    read_robot_record,
)
from deploy.record.link_records import FRAMES, FrameLine
from netshaper import capture, pcapng
from netshaper.ledger import CAUSES
from protocol.nanoseconds import SECOND
from tests.agent.radios.memory_air import Faults, MemoryAir
from tests.deploy.after.recorded_team import RecordedTeam
from tests.deploy.commands.office_floor import murmur
from tests.system.team import small_plan

AHEAD = (0, 1000 * SECOND, -500 * SECOND)
"""How far each robot's clock is ahead."""


@cache
def sent_frames(folder: Path, seed: int = 1) -> dict[tuple[int, int], int]:
    """Let three robots record to ``folder/rN``, with clocks that differ; return the bytes of all sealed frames."""
    plan = small_plan(side_m=10.0, map_encoding="predictive", dissemination="gossip", robots=3, seed=seed)
    air = MemoryAir(3, Faults(loss=0.2, delay=SECOND // 10))
    team = RecordedTeam(plan, air, folder, dict(enumerate(AHEAD)))
    for _ in range(30):
        team.play()
    for number in team.members:
        team.end(number)
    return {
        (number, counter): len(frame)
        for number, member in team.members.items()
        for counter, frame in enumerate(member.sent)
    }


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("merge")
    sent_frames(made)
    return made


def start_of(folder: Path, number: int) -> Path:
    """The records of a robot's only start."""
    return folder / f"r{number}" / "start-1"


def test_frames_of_all_robots_are_joined_on_one_clock(folder: Path, tmp_path: Path) -> None:
    folders = [folder / f"r{number}" for number in range(3)]
    robot_records = [read_robot_record(start_of(folder, number)) for number in range(3)]
    offsets, error = align(robot_records)
    assert error < SECOND // 10
    for offset, ahead in zip(offsets, AHEAD, strict=True):
        assert abs(offset + ahead) <= error
    frames = join(robot_records, offsets)
    assert {(number.sender, number.counter): each.size for number, each in frames.items()} == sent_frames(
        folder
    )
    times = [each.time_ns for each in frames.values()]
    assert times == sorted(times)
    for number, each in frames.items():
        holders = {other.robot for other in robot_records if number in other.received}
        assert each.receivers == holders

    merged = merge(folders, tmp_path / "team").summary
    assert merged["frames"] == len(frames)
    assert 0 < merged["frames_lost"] < merged["frames"] / 4
    with (tmp_path / "team" / "radio.pcapng").open("rb") as file:
        captured = list(capture.read(pcapng.Reader(file)))
    assert {(each.sender, each.connection) for each in captured} <= {(n.sender, n.counter) for n in frames}
    by_frame = {(number.sender, number.counter): each for number, each in frames.items()}
    for packet in captured:
        assert set(packet.receivers) == by_frame[packet.sender, packet.connection].receivers
        assert CAUSES[packet.cause] == ("" if packet.receivers else "loss")
    ledger = parquet.read_table(tmp_path / "team" / "ledger.parquet").to_pylist()
    assert sum(row["bytes"] for row in ledger) == sum(sum(map(len, each.packets)) for each in frames.values())


def test_the_command_prints_what_it_joined_and_overwrites_nothing(folder: Path, tmp_path: Path) -> None:
    folders = [str(folder / f"r{number}") for number in range(3)]
    result = murmur("merge", *folders, "--out", str(tmp_path / "team"))
    assert result.exit_code == 0, result.stderr
    assert "clocks agree within" in result.stdout
    again = murmur("merge", *folders, "--out", str(tmp_path / "team"))
    assert again.exit_code == 2
    assert "already exists" in again.stderr
    shown = murmur("capture", str(tmp_path / "team"), "--robot", "2")
    assert shown.exit_code == 0
    assert "received by" in shown.stdout


def test_clocks_can_be_aligned_over_a_third_robot_and_by_frames_in_one_direction(folder: Path) -> None:
    one, two, three = (read_robot_record(start_of(folder, number)) for number in range(3))
    apart = [
        dataclasses.replace(one, received={k: v for k, v in one.received.items() if k.sender == 1}),
        two,
        dataclasses.replace(
            three, received={k: v for k, v in three.received.items() if k.sender == 1}, sent={}
        ),
    ]
    offsets, error = align(apart)
    assert error >= UNKNOWN
    assert all(abs(offset + ahead) < SECOND // 5 for offset, ahead in zip(offsets, AHEAD, strict=True))


def test_clocks_of_robots_that_exchanged_no_frames_agree_by_the_time_of_day(folder: Path) -> None:
    one, two, three = (read_robot_record(start_of(folder, number)) for number in range(3))
    silent = dataclasses.replace(two, received={}, sent={})
    offsets, error = align([dataclasses.replace(one, received={}), silent, three])
    assert error >= UNKNOWN
    assert offsets[1] == AHEAD[0] - AHEAD[1]


def test_robots_that_exchanged_no_frames_with_others_are_named(folder: Path, tmp_path: Path) -> None:
    complete = merge([folder / f"r{number}" for number in range(3)], tmp_path / "team")
    assert complete.summary["isolated_robots"] == []
    plan = small_plan(side_m=10.0, map_encoding="predictive", dissemination="gossip", robots=3, seed=1)
    team = RecordedTeam(plan, MemoryAir(3, Faults(loss=1.0)), tmp_path, dict(enumerate(AHEAD)))
    for _ in range(10):
        team.play()
    for number in team.members:
        team.end(number)
    folders = [str(tmp_path / f"r{number}") for number in range(2)]
    result = murmur("merge", *folders, "--out", str(tmp_path / "apart"))
    assert result.exit_code == 0, result.stderr
    assert (
        "exchanged no frames with other robots: 0, 1; if they were in range, their [radio], keys, or"
        in result.stdout
    )
    alone = merge([folder / "r0"], tmp_path / "one-record")
    assert alone.summary["isolated_robots"] == []  # it received frames of robots whose records are missing


@pytest.mark.parametrize("drift_ppm", [0, 10, 100, -400])
def test_the_bound_of_the_error_contains_the_drift_of_a_clock(folder: Path, drift_ppm: int) -> None:
    # For an hour, the robots send a frame every ten seconds each, and it takes 5 ms.
    def drifting(time: int) -> int:
        return time + AHEAD[1] + time * drift_ppm // 1_000_000

    delay, robot_records = SECOND // 200, []
    for number, clock in ((0, int), (1, drifting)):
        sent, received = {}, {}
        for count in range(720):
            sender, time = count % 2, count * 5 * SECOND
            frame = FrameId(sender, 1, count)
            if sender == number:
                sent[frame] = FrameLine(number, clock(time), 1, sender, 1, count, 9, 0, 0)
            else:
                received[frame] = FrameLine(number, clock(time + delay), 1, sender, 1, count, 9, 0, 0)
        record = read_robot_record(start_of(folder, number)).record
        robot_records.append(RobotRecord(record, sent, received, {}))
    (_, offset), error = align(robot_records)
    worst = max(abs(drifting(time) + offset - time) for time in (0, 3595 * SECOND))
    assert worst <= error <= worst + 2 * delay + 10 * SECOND * MAX_DRIFT_PPM // 1_000_000


def test_robots_on_one_host_have_one_clock(folder: Path) -> None:
    one, two = (read_robot_record(start_of(folder, number)) for number in range(2))
    setup = structs.replace(two.record.setup, clock=one.record.setup.clock)
    same = dataclasses.replace(two, record=dataclasses.replace(two.record, setup=setup))
    assert align([one, same]) == ([0, 0], 0)


def test_records_of_two_missions_with_other_keys_are_refused(folder: Path, tmp_path: Path) -> None:
    sent_frames(tmp_path, seed=2)  # a new key: sessions begin with 1 again
    with pytest.raises(
        ValueError, match=r"r1/start-1: frame \d+ of session 1 of robot \d .* not one mission"
    ):
        merge([folder / "r0", tmp_path / "r1"], tmp_path / "team")
    assert not (tmp_path / "team").exists()


def test_damaged_files_of_the_radio_are_refused(folder: Path, tmp_path: Path) -> None:
    lines = (start_of(folder, 0) / FRAMES).read_text().splitlines(keepends=True)
    first = next(at for at, line in enumerate(lines) if at and line.split(",")[-2:] != ["0", "0\n"])
    for text, problem in (
        ("a,b\n", "the first line must be robot,time_ns"),
        ("".join([*lines[:3], "1,2,x\n"]), "line 4: has 3 values; must have 9"),
        ("".join([lines[0], "1" + lines[1][1:]]), "has frames that robot 1 recorded, not robot 0"),
        ("".join(lines[:first] + lines[first + 1 :]), "is not the one in the capture"),
        ("".join([*lines, *lines[-9:]]), "the capture ends before frame"),
    ):
        shutil.copytree(start_of(folder, 0), tmp_path, dirs_exist_ok=True)
        (tmp_path / FRAMES).write_text(text)
        with pytest.raises(ValueError, match=problem):
            read_robot_record(tmp_path)


def test_what_a_killed_robot_recorded_is_read_up_to_the_last_whole_line(folder: Path, tmp_path: Path) -> None:
    text = (start_of(folder, 0) / FRAMES).read_bytes()
    shutil.copytree(start_of(folder, 0), tmp_path, dirs_exist_ok=True)
    (tmp_path / FRAMES).write_bytes(text[: len(text) // 2 + 3])
    robot_record, whole = read_robot_record(tmp_path), read_robot_record(start_of(folder, 0))
    assert 0 < len(robot_record.packets) < len(whole.packets)
    assert robot_record.packets.items() <= whole.packets.items()


def test_damaged_recordings_are_named_and_nothing_is_written(folder: Path, tmp_path: Path) -> None:
    def copied(name: str) -> list[Path]:
        copies = [tmp_path / name / f"r{number}" for number in range(2)]
        for copy in copies:
            shutil.copytree(start_of(folder, int(copy.name[1:])), copy)
        return copies

    cut, apart = copied("cut"), copied("apart")
    capture_file = cut[0] / "radio.pcapng"
    whole = capture_file.read_bytes()
    capture_file.write_bytes(whole[:500] + whole[503:])
    with pytest.raises(ValueError, match=r"cut/r0/radio.pcapng: malformed at byte"):
        merge(cut, tmp_path / "team")
    lines = (apart[0] / FRAMES).read_text().splitlines()
    first = lines[1].split(",")
    first[1] = str(-(2**62))
    (apart[0] / FRAMES).write_text("\n".join([lines[0], ",".join(first), *lines[2:], ""]))
    with pytest.raises(ValueError, match="seconds apart: one of the clocks was set"):
        merge(apart, tmp_path / "team")
    with pytest.raises(ValueError, match="folders is empty: name the record directory of at least one robot"):
        merge([], tmp_path / "team")
    assert not (tmp_path / "team").exists()
