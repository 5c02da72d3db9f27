"""Read logs of CARMEN: text, one message per line, which may be compressed by gzip.

A line `FLASER n r_1 ... r_n x y theta odom_x odom_y odom_theta time host time` is a scan: ranges in meters, then the
pose, the raw odometry, and the time. Beams are evenly spaced from -90 to +90 degrees of the heading, counterclockwise;
with an even number of beams the last angle is left out. Ranges near 81 m, the maximum of the lasers of that time, and
infinite ones mean that nothing came back. Ranges of 0 and NaN are no measurements.

Later logs have lines `ROBOTLASER1 type start_angle field_of_view resolution maximum_range accuracy remission_mode n
r_1 ... r_n m remission_1 ... remission_m x y theta robot_x robot_y robot_theta ...` instead, whose angles and maximum
may be those of any laser. They are read only if a log has no FLASER lines: the same scan may be in both.
"""

from __future__ import annotations

import gzip
import math
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from protocol.files import open_file
from protocol.message_fields import MAX_BEAMS
from protocol.metric_scans import MetricScan
from worldsim.recorded.log import LogError, RecordedLog

SUFFIXES = (".log", ".clf", ".log.gz", ".clf.gz")

OLD, NEW = b"FLASER", b"ROBOTLASER1"

NOTHING_M = 80.0
"""Ranges of FLASER lines from here on mean that nothing came back."""

HALF_TURN = (180, 181, 360, 361)
"""Numbers of beams of the lasers of FLASER lines, which cover 180 degrees."""

SHARE_AT_MAXIMUM = 0.02
"""If at least this share of all ranges equals the largest range, that seems to be the maximum of the laser."""

FORMS = {
    OLD: "FLASER is followed by the number of beams, their ranges, x, y, and heading, separated by spaces",
    NEW: "ROBOTLASER1 is followed by type, first angle, field of view, resolution, maximum, accuracy, mode, the "
    "number of beams, their ranges, the number of remissions, these, x, y, and heading, separated by spaces",
}

LARGEST_POSE = 1e9
"""Maximum of meters and radians in a pose."""

LONGEST_LINE = 1 << 17
"""Bytes of a line; longer ones are no text of CARMEN."""


class _Scan(NamedTuple):
    """What a line says."""

    scan: MetricScan
    pose: tuple[float, ...]
    stamp: float | None
    """Time; None: unknown."""
    values: int
    """Number of values from the pose on."""


def read(path: Path, every: int) -> RecordedLog:
    """Read each of `every` scans of a log; a last line that was cut off is left out.

    Raises LogError if the log has no scans, or a line is damaged; OSError if the file cannot be read.
    """
    kind = OLD
    found, notes = _scans(path, every, kind)
    if not found:
        kind = NEW
        found, notes = _scans(path, every, kind)
    if not found:
        raise LogError(
            f"{path}: no laser scans: it has no FLASER lines, and no ROBOTLASER1 lines; docs/recorded.md shows how to "
            "convert other formats"
        )
    if kind == OLD:
        notes += [f"{path}: {doubt}" for doubt in _doubts([each.scan for each in found])]
    stamps = [each.stamp for each in found if each.stamp is not None]
    return RecordedLog.of(
        path,
        path.name.split(".")[0] or "log",
        [each.scan for each in found],
        [each.pose for each in found],
        stamps if len(stamps) == len(found) else [],
        notes,
    )


def _scans(path: Path, every: int, kind: bytes) -> tuple[list[_Scan], list[str]]:
    """Return each of `every` scans that lines of a kind contain, and notes for the user."""
    found: list[_Scan] = []
    for index, (number, line) in enumerate(_lines(path, kind)):
        if index % every:
            continue
        may_be_cut_off = bool(found) and not line.endswith(b"\n")
        try:
            scan = _parsed(line.split(), kind)
            if may_be_cut_off and scan.values < found[-1].values:
                raise ValueError("it has fewer values than the line before")
            found.append(scan)
        except ValueError as error:
            if may_be_cut_off:
                return found, [f"{path}: its last line, {number}, was cut off, and is left out"]
            raise LogError(f"{path}, line {number}: damaged {kind.decode()} line: {error}") from None
    return found, []


def _lines(path: Path, kind: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield number and text of each line of a kind."""
    try:
        with open_file(path) as file, gzip.open(file) if path.suffix == ".gz" else file as lines:
            number = 0
            while line := lines.readline(LONGEST_LINE):
                number += 1
                if len(line) == LONGEST_LINE:
                    raise LogError(
                        f"{path}, line {number}: longer than {LONGEST_LINE} bytes: no log of CARMEN"
                    )
                if line.startswith(kind):
                    yield number, line
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise LogError(
            f"{path}: not a complete gzip file: {error}; zcat {path} > {path.stem} recovers the readable part"
        ) from None


def _parsed(fields: Sequence[bytes], kind: bytes) -> _Scan:
    """Return the scan of a line; ValueError if it is damaged."""
    at = 1 if kind == OLD else 8
    if len(fields) <= at:
        raise ValueError(f"it has {len(fields) - 1} values; {FORMS[kind]}")
    try:
        beams = int(fields[at])
        head = [float(each) for each in fields[1:at]]
        values = [float(each) for each in fields[at + 1 : at + 1 + beams]]
        behind = at + 1 + beams
        if kind == NEW:
            remissions = int(fields[behind])
            if remissions < 0:
                raise ValueError(f"{remissions} remissions")
            behind += 1 + remissions
        pose = tuple(float(each) for each in fields[behind : behind + 3])
        at_time = behind + (6 if kind == OLD else 11)
        stamp = float(fields[at_time]) if len(fields) > at_time else None
    except IndexError:
        raise ValueError(
            f"it has {len(fields) - 1} values for {beams} ranges and a pose; {FORMS[kind]}"
        ) from None
    except ValueError as error:
        raise ValueError(f"{error}; {FORMS[kind]}") from None
    if not 2 <= beams <= MAX_BEAMS:
        raise ValueError(f"{beams} beams; a scan must have 2 to {MAX_BEAMS}")
    if len(values) + len(pose) != beams + 3:
        raise ValueError(f"{len(values) + len(pose)} numbers instead of {beams} ranges and a pose")
    ranges = np.array(values)
    if (ranges < 0).any():
        beam = int(np.flatnonzero(ranges < 0)[0])
        raise ValueError(f"range {beam + 1} is {ranges[beam]:g}; ranges are 0 or more")
    if not all(abs(each) <= LARGEST_POSE for each in pose):
        x, y, heading = pose
        raise ValueError(f"x = {x:g}, y = {y:g}, heading = {heading:g} is not a pose")
    return _Scan(_metric(ranges, head), pose, stamp, len(fields) - behind)


def _metric(ranges: NDArray[np.float64], head: Sequence[float]) -> MetricScan:
    """Return a scan, with the angles and the maximum that its line has in front of the ranges, if any."""
    beams = len(ranges)
    if not head:
        return MetricScan(ranges, -math.pi / 2, math.pi / (beams - beams % 2), 0.0, NOTHING_M)
    _, first, span, increment, most, *_ = head
    return MetricScan(ranges, first, increment or span / (beams - 1), 0.0, most)


def _doubts(scans: Sequence[MetricScan]) -> Iterator[str]:
    """Yield what may be wrong with scans of FLASER lines, which state neither angles nor maximum of the laser."""
    beams = len(scans[0].ranges)
    if beams not in HALF_TURN:
        yield (
            f"FLASER lines do not state angles: its {beams} beams are taken to cover 180 degrees; ROBOTLASER1 lines "
            "have the angles of other lasers"
        )
    ranges = np.concatenate([each.ranges for each in scans])
    largest = ranges.max(where=~np.isnan(ranges), initial=0)
    share = np.count_nonzero(ranges == largest) / len(ranges)
    if largest < NOTHING_M and share >= SHARE_AT_MAXIMUM:
        yield (
            f"{100 * share:.0f} % of all ranges are {largest:g} m: if that is the maximum of the laser, maps get false "
            "walls there; ROBOTLASER1 lines state it"
        )
