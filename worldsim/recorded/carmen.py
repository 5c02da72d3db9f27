"""Read logs of CARMEN: text, one message per line, which may be compressed by gzip.

A line `FLASER n r_1 ... r_n x y theta odom_x odom_y odom_theta time host time` is a scan: ranges in meters, then the
pose, the raw odometry, and the time. Beams are evenly spaced from -90 to +90 degrees of the heading, counterclockwise;
with an even number of beams the last angle is left out. Ranges near 81 m, the maximum of the lasers of that time, and
infinite ones mean that nothing came back. Ranges of 0 and NaN are no measurements.
"""

from __future__ import annotations

import gzip
import math
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from protocol.files import open_file
from protocol.message_fields import MAX_BEAMS
from protocol.metric_scans import BeamAngles, millimeters
from worldsim.recorded.log import LogError, RecordedLog

SUFFIXES = (".log", ".clf", ".log.gz", ".clf.gz")

SCAN = b"FLASER"

NOTHING_M = 80.0
"""Ranges from here on mean that nothing came back."""

FORM = "after FLASER must stand the number of beams, a range each, x, y, and heading"

LARGEST_POSE = 1e9
"""Maximum of meters and radians in a pose."""

LONGEST_LINE = 1 << 17
"""Bytes of a line; longer ones are no text of CARMEN."""


def read(path: Path, every: int) -> RecordedLog:
    """Read each of `every` scans of a log.

    Raises LogError if the log has no scans, a line is damaged, or the number of beams changes; OSError if the file
    cannot be read.
    """
    found = [
        _scan(line.split(), path, number)
        for index, (number, line) in enumerate(_scan_lines(path))
        if index % every == 0
    ]
    if not found:
        raise LogError(f"{path}: no laser scans: it has no FLASER lines")
    beams = len(found[0][0])
    for ranges, _, _, number in found:
        if len(ranges) != beams:
            raise LogError(
                f"{path}, line {number}: a scan of {len(ranges)} beams, after scans of {beams}: "
                "the laser must stay the same"
            )
    stamps = [stamp for _, _, stamp, _ in found if stamp is not None]
    ranges = np.array([each for each, _, _, _ in found])
    return RecordedLog(
        path.name.split(".")[0] or "log",
        BeamAngles.of(beams, -math.pi / 2, math.pi / (beams - beams % 2)),
        np.array([pose for _, pose, _, _ in found]),
        millimeters(ranges[:, ::-1], least=0.0, nothing=NOTHING_M, reverse=False),
        np.array(stamps if len(stamps) == len(found) else [], np.float64),
    )


def _scan_lines(path: Path) -> Iterator[tuple[int, bytes]]:
    """Yield number and text of each line that is a scan."""
    try:
        with open_file(path) as file, gzip.open(file) if path.suffix == ".gz" else file as lines:
            number = 0
            while line := lines.readline(LONGEST_LINE):
                number += 1
                if len(line) == LONGEST_LINE:
                    raise LogError(
                        f"{path}, line {number}: longer than {LONGEST_LINE} bytes: no log of CARMEN"
                    )
                if line.startswith(SCAN):
                    yield number, line
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise LogError(f"{path}: not a complete gzip file: {error}") from None


def _scan(
    fields: list[bytes], path: Path, line: int
) -> tuple[NDArray[np.float64], tuple[float, ...], float | None, int]:
    """Return ranges, pose, time (None: unknown), and number of a line."""
    where = f"{path}, line {line}: damaged FLASER line"
    try:
        beams = int(fields[1])
        values = np.array([float(each) for each in fields[2 : beams + 5]])
        stamp = float(fields[beams + 8]) if len(fields) > beams + 8 else None
    except (IndexError, ValueError) as error:
        raise LogError(f"{where}: {error}; {FORM}") from None
    if not 2 <= beams <= MAX_BEAMS:
        raise LogError(f"{where}: {beams} beams; a scan must have 2 to {MAX_BEAMS}")
    if len(values) != beams + 3:
        raise LogError(f"{where}: {len(values)} numbers instead of {beams} ranges and a pose")
    ranges, pose = values[:beams], values[beams:]
    if (ranges < 0).any():
        beam = int(np.flatnonzero(ranges < 0)[0])
        raise LogError(f"{where}: range {beam + 1} is {ranges[beam]:g}; ranges are 0 or more")
    if not (np.abs(pose) <= LARGEST_POSE).all():
        x, y, heading = pose.tolist()
        raise LogError(f"{where}: x = {x:g}, y = {y:g}, heading = {heading:g} is not a pose")
    return ranges, tuple(pose.tolist()), stamp, line
