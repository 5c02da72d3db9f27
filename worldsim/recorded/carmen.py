"""Read laser scans with corrected poses from CARMEN text logs.

A line `FLASER n r_1 ... r_n x y theta ...` is a scan: ranges in meters, then the pose. Beams are evenly spaced from
-90 to +90 degrees of the heading, counterclockwise. With an even number of beams the last angle is left out.
"""

from __future__ import annotations

import gzip
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class RecordedScan:
    """One scan: pose in meters and radians, y up; ranges in meters and beam angles in radians, shape (beams,)."""

    x: float
    y: float
    heading: float
    ranges: NDArray[np.float64]
    angles: NDArray[np.float64]


def read(path: Path) -> list[RecordedScan]:
    """Read all scans of a log, which may be compressed by gzip; raise ValueError if it has none."""
    with gzip.open(path, "rt") if path.suffix == ".gz" else path.open() as file:
        scans = [
            _scan(line.split(), path, number)
            for number, line in enumerate(file, 1)
            if line.startswith("FLASER")
        ]
    if not scans:
        raise ValueError(f"{path} has no FLASER lines, so it has no laser scans")
    return scans


def _scan(fields: list[str], path: Path, line: int) -> RecordedScan:
    try:
        beams = int(fields[1])
        values = np.array(fields[2 : beams + 5], np.float64)
    except (IndexError, ValueError) as error:
        raise ValueError(f"{path}, line {line}: malformed FLASER line: {error}") from None
    if beams < 2 or len(values) != beams + 3:
        raise ValueError(f"{path}, line {line}: expected {beams} ranges and a pose")
    angles: NDArray[np.float64] = -math.pi / 2 + np.arange(beams, dtype=np.float64) * (
        math.pi / (beams - beams % 2)
    )
    x, y, heading = values[beams:].tolist()
    return RecordedScan(x, y, heading, values[:beams], angles)
