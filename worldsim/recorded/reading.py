"""Read a log of any known format."""

from __future__ import annotations

from pathlib import Path

from protocol.range_scans import NO_MEASUREMENT, NOTHING
from worldsim.recorded import carmen, ros_bag, scan_file
from worldsim.recorded.log import LogError, RecordedLog

FORMATS = (
    "logs of CARMEN (.log, .clf, also with .gz), bags of ROS 1 (.bag), bags of ROS 2 (a directory with metadata.yaml, "
    ".mcap, .db3), scans of a run directory (.npz)"
)


def read(path: Path, every: int = 1, topic: str = "") -> RecordedLog:
    """Read each of `every` scans of a log; `topic` is the topic of the laser in a bag.

    Raises LogError if the log is missing, of an unknown format, or damaged, or lacks scans, measurements, or poses.
    """
    log = _read(path, every, topic)
    if (log.ranges == NO_MEASUREMENT).all():
        raise LogError(
            f"{path}: no beam of its {log.scans} scans measured anything: each range is 0, below the minimum of the "
            "laser, or not a number"
        )
    if ((log.ranges == NO_MEASUREMENT) | (log.ranges == NOTHING)).all():
        raise LogError(
            f"{path}: no beam of its {log.scans} scans met anything: each range is at the maximum of the laser, or "
            "beyond 65 m; ranges must be in meters"
        )
    return log


def _read(path: Path, every: int, topic: str) -> RecordedLog:
    """Read a log by the format that its name shows."""
    try:
        if not path.exists():
            raise LogError(f"{path}: no such log; was it moved or renamed?")
        if path.is_dir():
            if not (path / "metadata.yaml").is_file():
                raise LogError(
                    f"{path}: is a directory without metadata.yaml, so it is no bag; known are {FORMATS}"
                )
            return ros_bag.read(path, every, topic)
        if not path.stat().st_size:
            raise LogError(f"{path}: is empty; was its recorder ended before it wrote anything?")
        if path.name.endswith(ros_bag.SUFFIXES):
            return ros_bag.read(path, every, topic)
        if topic:
            raise LogError(f"{path}: topic = {topic!r}: only bags have topics")
        if path.name.endswith(carmen.SUFFIXES):
            return carmen.read(path, every)
        if path.suffix == scan_file.SUFFIX:
            return scan_file.read(path, every)
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror or error}") from None
    raise LogError(f"{path}: unknown format; known are {FORMATS}")
