"""Logs in a run directory: the scans that were replayed, in one NumPy archive per log.

With them, a run can be repeated without the original logs. Poses and ranges are those that the run used, to the bit.
"""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from protocol.errors import shown
from protocol.files import open_file
from protocol.message_fields import MAX_BEAMS
from protocol.metric_scans import BeamAngles
from protocol.range_scans import TURN
from worldsim.atomic_files import write_whole
from worldsim.recorded.log import LogError, RecordedLog

SUFFIX = ".npz"

_TYPES = {"name": "U", "angles": "i", "poses": "f", "ranges": "u", "stamps": "f"}
"""Arrays of a file, and the kind of their values."""


def write(log: RecordedLog, path: Path) -> None:
    """Write a log; OSError if the file cannot be written."""
    arrays: dict[str, Any] = {
        "name": np.array(log.name),
        "angles": np.array([log.angles.first, log.angles.span], np.int64),
        "poses": log.poses,
        "ranges": log.ranges,
        "stamps": log.stamps,
    }
    write_whole(path, lambda file: np.savez_compressed(file, allow_pickle=False, **arrays))


def read(path: Path, every: int) -> RecordedLog:
    """Read each of `every` scans of a log; LogError if the file is damaged, OSError if it cannot be read."""
    try:
        with open_file(path) as file, np.load(file, allow_pickle=False) as archive:
            found = {name: archive[name] for name in _TYPES}
        log = _checked(found)
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise LogError(f"{path}: not the scans of a run: {error}") from None
    stamps = log.stamps[::every]
    return RecordedLog(log.name, log.angles, log.poses[::every], log.ranges[::every], stamps)


def _checked(found: dict[str, Any]) -> RecordedLog:
    """Return the log of these arrays; ValueError if they do not fit together."""
    for key, kind in _TYPES.items():
        if found[key].dtype.kind != kind:
            raise ValueError(f"{key} are {found[key].dtype}")
    name = str(found["name"])
    if not name or Path(name).name != name:
        raise ValueError(f"name {shown(name)}")
    poses, ranges, stamps = found["poses"], found["ranges"], found["stamps"]
    scans = len(poses)
    if not scans or poses.shape != (scans, 3) or not np.isfinite(poses).all():
        raise ValueError(f"poses of shape {poses.shape}")
    if ranges.ndim != 2 or len(ranges) != scans or not 2 <= ranges.shape[1] <= MAX_BEAMS:
        raise ValueError(f"ranges of shape {ranges.shape} for {scans} scans")
    if stamps.shape not in ((0,), (scans,)):
        raise ValueError(f"stamps of shape {stamps.shape} for {scans} scans")
    first, span = (int(value) for value in found["angles"])
    if not (abs(first) <= 2 * TURN and 0 < span <= 2 * TURN):
        raise ValueError(f"angles {first} and {span}")
    angles = BeamAngles(ranges.shape[1], first, span)
    return RecordedLog(
        name, angles, poses.astype(np.float64), ranges.astype(np.uint16), stamps.astype(np.float64)
    )
