"""The memory that a run needs, estimated from its plan before anything starts (docs/reliability.md#memory).

Each robot needs some bytes per cell for its grids and for planning. With some encodings it also needs a grid per
teammate. The figures were measured with robots that have explored a generated office.
"""

from __future__ import annotations

import math
import os
import resource
from dataclasses import dataclass
from pathlib import Path

from deploy.run.limits import DATA_BYTES, MEMORY_BYTES, soft_limit
from deploy.scenario.errors import ScenarioError
from deploy.scenario.plan import Plan

MB = 1_000_000

PROCESS_BYTES, PROCESS_CELL_BYTES = 18 * MB, 58
"""Memory of a robot's process, in bytes and bytes per cell, without the grids of its teammates' maps."""

GRID_PER_TEAMMATE = {"zenoh": ("predictive", "polygons"), "memory": ("polygons",)}
"""Encodings with which a robot has a grid per teammate, of a byte per cell; in one process, robots share decoders."""

RUN_BYTES = {"zenoh": 500 * MB, "memory": 220 * MB}
"""Memory of a run without its robots, by bus: libraries, and all other processes."""

RECORD_CELL_BYTES = 3
"""Bytes per cell and robot of the recorder: both maps, and their last recorded state."""

SHARED_CELL_BYTES, MEMBER_CELL_BYTES = 40, 57
"""On the memory bus: bytes per cell of what the robots share, and of each robot."""


@dataclass(frozen=True)
class Need:
    """The memory of a run in bytes: of all its processes, and the address space and data of the largest one."""

    total: float
    address_space: float
    data: float


def needed(robots: int, cells: float, bus: str, grids: int) -> Need:
    """Estimate the memory of a run with this many robots on this host, and a map of this many cells.

    `grids` is the number of grids that each robot has for the maps of its team.
    """
    if bus == "memory":
        largest = cells * (SHARED_CELL_BYTES + robots * (MEMBER_CELL_BYTES + grids))
        total = RUN_BYTES[bus] + largest
    else:
        robot, records = cells * (PROCESS_CELL_BYTES + grids), robots * cells * RECORD_CELL_BYTES
        largest = max(robot, records)
        total = RUN_BYTES[bus] + records + robots * (PROCESS_BYTES + robot)
    return Need(total, MEMORY_BYTES + largest, DATA_BYTES + largest)


def check(plan: Plan, elsewhere: int = 0) -> None:
    """Raise ScenarioError if a run cannot fit into the memory of this host; `elsewhere` robots run on other hosts."""
    team, bus, resolution = plan.scenario.robots, plan.scenario.bus, plan.map.resolution
    height, width = plan.map.cells.shape
    limits = memory_limits()

    def lack(team: int = team, scale: float = 1.0, bus: str = bus) -> str:
        """Return which memory is too small for a team on a map of scaled sides; empty if none is."""
        grids = team if plan.scenario.map_encoding in GRID_PER_TEAMMATE[bus] else 0
        need = needed(team - elsewhere, scale * scale * height * width, bus, grids)
        return next(
            (
                f"needs about {_shown(each)}, and {name} {_shown(limit)}"
                for name, limit, of in limits
                if (each := getattr(need, of)) > limit
            ),
            "",
        )

    if not lack():
        return
    smaller = next((n for n in reversed(range(elsewhere + 1, team)) if not lack(team=n)), 0)
    percent = next((n for n in reversed(range(1, 100)) if not lack(scale=n / 100)), 0)
    fitting = [f"{smaller} robots"] if smaller else []
    fitting += [f"cells of {math.ceil(1e4 * resolution / percent) / 100:g} m"] if percent else []
    fitting += ["bus = 'memory'"] if not elsewhere and not lack(bus="memory") else []
    hint = f"; use {' or '.join(fitting)}" if fitting else ""
    raise ScenarioError(f"robots = {team} on {width} x {height} cells: bus = {bus!r} {lack()}{hint}")


def memory_limits() -> list[tuple[str, float, str]]:
    """Return what limits memory, the limit in bytes, and which attribute of `Need` it limits."""
    machine = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    return [
        ("this machine has", machine, "total"),
        ("its control group allows", control_group_bytes(), "total"),
        ("ulimit -v allows", soft_limit(resource.RLIMIT_AS), "address_space"),
        ("ulimit -d allows", soft_limit(resource.RLIMIT_DATA), "data"),
    ]


def control_group_bytes(
    root: Path = Path("/sys/fs/cgroup"), groups: Path = Path("/proc/self/cgroup")
) -> float:
    """Return the smallest memory limit of this process's control groups (Linux), of version 1 or 2."""
    try:
        lines = groups.read_text(encoding="utf-8").splitlines()
    except OSError:
        return math.inf
    files = []
    for _, controllers, group in (line.split(":", 2) for line in lines):
        if "memory" in controllers.split(","):
            top, file = root / "memory", "memory.limit_in_bytes"
        elif not controllers:
            top, file = root, "memory.max"
        else:
            continue
        inner = top / group.lstrip("/")
        files += [folder / file for folder in (inner, *inner.parents) if folder.is_relative_to(top)]
    limits = [path.read_text(encoding="utf-8").strip() for path in files if path.is_file()]
    return min((float(limit) for limit in limits if limit.isdecimal()), default=math.inf)


def _shown(size: float) -> str:
    """Return a size as text, with two digits."""
    return f"{float(f'{size / 1e9:.2g}'):g} GB"
