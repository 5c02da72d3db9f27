"""The report's table of a run's robots: distance, idle steps, discovered cells, map accuracy, and bytes."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from deploy.after.archive import Archive, Table
from deploy.after.capture import opened
from netshaper import capture
from netshaper.pcapng import CaptureError
from protocol.grid import FREE, UNKNOWN

HEAD: Final = (
    "robot", "driven [m]", "idle steps", "cells seen", "seen first", "map accuracy", "sent [bytes]",
    "received [bytes]", "last status",
)  # fmt: skip

CAPTION: Final = (
    "Idle steps: the robot neither drove nor turned. Seen first: cells that the robot saw before any teammate, or in "
    "the same five steps. Map accuracy: share of the reachable cells that are free on its planning map at the end. "
    "Received: bytes of all frames that arrived, broadcasts included."
)


def robot_table(archive: Archive) -> list[list[str]]:
    """The lines of the table, its head first; a dash stands for what a run does not have."""
    summary, ledger = archive.summary, archive.ledger
    robots = range(summary["robots"])
    reachable = archive.plan.reachable if archive.plan.has_truth else None
    carried = ledger["carried"].astype(bool)
    sent = np.bincount(ledger["sender"][carried], ledger["bytes"][carried], len(robots)).astype(int)
    received, first = received_bytes(archive), seen_first(archive)
    lines = [list(HEAD)]
    for robot in robots:
        track = archive.of_robot(robot)
        seen = track["known_cells"][~np.isnan(track["known_cells"])]
        planning = archive.maps.planning(robot, archive.last_step)
        status = summary["lost"].get(str(robot)) or next((s for s in track["status"][::-1] if s), "-")
        lines.append(
            [
                str(robot),
                f"{track['driven'][-1]:.1f}" if len(track["driven"]) else "-",
                f"{idle_steps(track):,}",
                f"{int(seen[-1]):,}" if len(seen) else "-",
                f"{first[robot]:,}",
                "-"
                if planning is None or reachable is None
                else f"{100 * (planning[reachable] == FREE).mean():.1f} %",
                f"{sent[robot]:,}",
                "-" if received is None else f"{received[robot]:,}",
                status,
            ]
        )
    return lines


def idle_steps(track: Table) -> int:
    """The number of steps in which a robot neither drove nor turned, of its rows of ``steps.parquet``."""
    pose = np.column_stack([track[name] for name in ("x", "y", "heading")])
    return int((np.diff(pose, axis=0) == 0).all(axis=1).sum())


def seen_first(archive: Archive) -> list[int]:
    """For each robot the number of cells that it saw before any teammate, or at the same time.

    The times are those of the reports of maps, every few steps.
    """
    never = np.iinfo(np.int32).max
    shape = archive.plan.map.cells.shape
    first: NDArray[np.int32] = np.full((archive.summary["robots"], *shape), never, np.int32)
    for robot, when in enumerate(first):
        for step in archive.maps.steps(robot):
            own = archive.maps.own(robot, step)
            if own is not None:
                when[(own != UNKNOWN) & (when == never)] = step
    earliest = first.min(axis=0)
    counts: list[int] = ((first == earliest) & (earliest < never)).sum(axis=(1, 2)).tolist()
    return counts


def received_bytes(archive: Archive) -> list[int] | None:
    """For each robot the bytes of the frames that it received, by the capture; None without a readable one."""
    received: list[Any] = [0] * archive.summary["robots"]
    try:
        with opened(archive.directory) as reader:
            for frame in capture.read(reader):
                for robot in frame.receivers:
                    received[robot] += frame.size
    except CaptureError:
        return None
    return received
