from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from protocol.range_scans import NO_MEASUREMENT, NOTHING, TURN
from tests.worldsim.recorded.made_logs import (
    carmen_text,
    distances,
    drive,
    flaser,
    robotlaser,
    sick_angles,
    write_carmen,
)
from worldsim.recorded.log import LogError
from worldsim.recorded.reading import read


@pytest.mark.parametrize("name", ["room.log", "room.clf", "room.log.gz"])
def test_poses_times_and_ranges_are_read(tmp_path: Path, name: str) -> None:
    log = read(write_carmen(tmp_path / name, scans=5))
    assert log.name == "room"
    assert np.allclose(log.poses, drive(5))
    assert log.stamps.tolist() == [100, 101, 102, 103, 104]
    # beams run from left to right: clockwise, as the angles of `protocol.range_scans`
    wanted = distances(drive(5)[3], sick_angles(181))[::-1]
    assert np.abs(log.ranges[3] / 1000 - wanted).max() < 0.001


@pytest.mark.parametrize(
    ("beams", "first", "last"), [(180, 89, -90), (181, 90, -90), (361, 90, -90), (360, 89.5, -90)]
)
def test_an_even_number_of_beams_leaves_out_the_last_angle(
    tmp_path: Path, beams: int, first: float, last: float
) -> None:
    """Angles are those of the log, so that the first beam of a scan has the largest angle."""
    angles = read(write_carmen(tmp_path / "a.log", scans=1, beams=beams)).angles
    assert angles.beams == beams
    assert abs(angles.first + first * TURN / 360) <= 1
    assert abs(angles.first + angles.span + last * TURN / 360) <= 1


def test_readings_near_the_maximum_met_nothing_and_zeros_and_nan_are_no_measurements(tmp_path: Path) -> None:
    file = tmp_path / "a.log"
    file.write_text(flaser((0, 0, 0), [1.5, 81.83, 80.0, 79.0, 0.0]))
    assert read(file).ranges[0].tolist() == [NO_MEASUREMENT, NOTHING, NOTHING, NOTHING, 1500]
    file.write_text(flaser((0, 0, 0), [1.5, math.nan, math.inf]))
    assert read(file).ranges[0].tolist() == [NOTHING, NO_MEASUREMENT, 1500]


def test_every_takes_each_kth_scan(tmp_path: Path) -> None:
    log = read(write_carmen(tmp_path / "a.log", scans=10), every=4)
    assert np.allclose(log.poses, drive(10)[::4])
    assert log.stamps.tolist() == [100, 104, 108]


def test_a_log_may_lack_times(tmp_path: Path) -> None:
    assert not len(read(write_carmen(tmp_path / "a.log", scans=3, period_s=None)).stamps)


GOOD = flaser((0, 0, 0), [1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("text", "error"),
    [
        ("ODOM 0 0 0\n", "no laser scans: it has no FLASER lines, .*; docs/recorded.md shows how to convert"),
        ("", "is empty"),
        (
            GOOD.replace(" ", ","),
            "line 1: damaged FLASER line: it has 0 values; FLASER is followed by .* separated by spaces",
        ),
        (
            robotlaser((0, 0, 0), [1, 2], 0, 1, 9).replace(" 9.000 ", " x "),
            "line 1: damaged ROBOTLASER1 line: .*; ROBOTLASER1 is followed by",
        ),
        (robotlaser((0, 0, 0), [1, 2], 0, 1, 9)[:50], "line 1: damaged ROBOTLASER1 line: it has . values"),
        (flaser((0, 0, 0), [900.0] * 4), "no beam of its 1 scans met anything: .*; ranges must be in meters"),
        (
            GOOD + "FLASER 3 1.0 2.0\n",
            "line 2: damaged FLASER line: 2 numbers instead of 3 ranges and a pose",
        ),
        (
            GOOD + "\n" + GOOD.replace("2.000", "2.x"),
            "line 3: damaged FLASER line: could not convert .*; FLASER is followed by",
        ),
        (GOOD.replace("2.000", "-2.0"), "line 1: damaged FLASER line: range 2 is -2; ranges are 0 or more"),
        (flaser((0, math.nan, 0), [1.0, 2.0]), "x = 0, y = nan, heading = 0 is not a pose"),
        (flaser((0, 0, 1e300), [1.0, 2.0]), "heading = 1e\\+300 is not a pose"),
        (flaser((0, 0, 0), [1.0] * 3601), "line 1: .*: 3601 beams; a scan must have 2 to 3600"),
        ("FLASER\n", "line 1: damaged FLASER line: .*; FLASER is followed by the number of beams"),
    ],
)
def test_an_error_names_the_line_and_what_is_wrong(tmp_path: Path, text: str, error: str) -> None:
    (tmp_path / "a.log").write_text(text)
    with pytest.raises(LogError, match=f"a.log.*{error}"):
        read(tmp_path / "a.log")


def test_a_file_that_is_no_log_is_named(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text(carmen_text())
    (tmp_path / "folder").mkdir()
    whole = write_carmen(tmp_path / "cut.log.gz").read_bytes()
    (tmp_path / "cut.log.gz").write_bytes(whole[: len(whole) // 2])
    for name, error in (
        ("a.txt", "unknown format; known are logs of CARMEN"),
        ("b.log", "no such log; was it moved or renamed"),
        ("folder", "is a directory without metadata.yaml"),
        ("cut.log.gz", "not a complete gzip file"),
    ):
        with pytest.raises(LogError, match=f"{name}: {error}"):
            read(tmp_path / name)


def test_only_bags_have_topics(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="only bags have topics"):
        read(write_carmen(tmp_path / "a.log"), topic="/scan")


def test_headings_are_kept_in_radians(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text(flaser((1.0, -2.0, math.pi), [1.0, 2.0]))
    assert read(tmp_path / "a.log").poses[0].tolist() == pytest.approx([1.0, -2.0, math.pi])


def test_lines_that_state_angles_and_maximum_of_the_laser_are_read(tmp_path: Path) -> None:
    angles = np.radians(np.arange(-135.0, 135.1, 0.5))
    ranges = np.minimum(distances((2.0, 2.0, 1.0), angles), 4.0)
    line = robotlaser((2.0, 2.0, 1.0), ranges, angles[0], math.radians(0.5), 4.0)
    (tmp_path / "a.log").write_text(line * 3)
    log = read(tmp_path / "a.log")
    assert str(log.angles) == "541 beams from -135.0 to 135.0 degrees"
    assert np.allclose(log.poses, [(2.0, 2.0, 1.0)] * 3)
    assert log.stamps.tolist() == [7, 7, 7]
    is_met = ranges[::-1] < 4.0
    assert np.array_equal(log.ranges[0] < NOTHING, is_met)
    assert np.abs(log.ranges[0] / 1000 - ranges[::-1])[is_met].max() < 0.001
    assert log.notes == ()
    # a log with both kinds of lines has each scan twice
    (tmp_path / "a.log").write_text(line + GOOD + line)
    assert read(tmp_path / "a.log").ranges.tolist() == [[3000, 2000, 1000]]


def test_a_last_line_that_was_cut_off_is_left_out(tmp_path: Path) -> None:
    (tmp_path / "a.log").write_text(GOOD + GOOD + GOOD[:20])
    log = read(tmp_path / "a.log")
    assert (log.scans, log.notes[0]) == (
        2,
        f"{tmp_path / 'a.log'}: its last line, 3, was cut off, and is left out",
    )


def test_a_last_line_that_was_cut_off_behind_its_pose_takes_no_times_from_the_others(tmp_path: Path) -> None:
    text = carmen_text(scans=3)
    (tmp_path / "a.log").write_text(text[: text.rindex(" ", 0, text.rindex("102") + 1)])
    log = read(tmp_path / "a.log")
    assert log.stamps.tolist() == [100, 101]
    assert log.notes[0].endswith("was cut off, and is left out")


def test_a_negative_number_of_remissions_is_refused(tmp_path: Path) -> None:
    line = robotlaser((1, 1, 0), [1.0] * 5, -0.2, 0.1, 10.0).split()
    assert line[9 + 5] == "1"
    line[9 + 5] = "-4"
    (tmp_path / "a.log").write_text(" ".join(line) + "\n")
    with pytest.raises(LogError, match="line 1: damaged ROBOTLASER1 line: -4 remissions"):
        read(tmp_path / "a.log")


def test_scans_of_other_beams_are_read_at_the_angles_of_most_scans(tmp_path: Path) -> None:
    poses = drive(9)
    counts = [361, 181, 181, 181, 181, 361, 361, 181, 90]
    lines = [
        flaser(pose, distances(pose, sick_angles(beams))) for pose, beams in zip(poses, counts, strict=True)
    ]
    (tmp_path / "a.log").write_text("".join(lines))
    log = read(tmp_path / "a.log")
    assert log.ranges.shape == (9, 181)
    assert "4 of 9 scans do not have 181 beams from -90.0 to 90.0 degrees" in log.notes[0]
    for at in (0, 3, 6):
        wanted = distances(poses[at], sick_angles(181))[::-1]
        assert np.abs(log.ranges[at] / 1000 - wanted).max() < 0.001


def test_what_lines_do_not_state_about_the_laser_is_noted(tmp_path: Path) -> None:
    (tmp_path / "wide.log").write_text(flaser((0, 0, 0), np.linspace(1, 2, 541)))
    assert "its 541 beams are taken to cover 180 degrees" in read(tmp_path / "wide.log").notes[0]
    (tmp_path / "short.log").write_text(flaser((0, 0, 0), [*np.linspace(1, 2, 120), *[5.6] * 60]))
    assert "33 % of all ranges are 5.6 m: if that is the maximum" in read(tmp_path / "short.log").notes[0]
    assert read(write_carmen(tmp_path / "room.log")).notes == ()
