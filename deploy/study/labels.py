"""Labels of metrics and settings in figures, with their units."""

from __future__ import annotations

import re
from typing import Any, Final

from deploy.study.tables import MIN, RELATIVE
from netshaper.ledger import CAUSES
from protocol.packets import ALL_KINDS

SHARE: Final = "share"

NAMES: Final = {
    "steps": "exploration time", "explored": "explored area", "carried": "transmitted", "robots": "number of robots",
    "range": "communication range", "bytes.total": "transmitted", "t50": "time to 50 %", "t90": "time to 90 %",
    "t95": "time to 95 %", "t99": "time to 99 %", "longest_path_95": "longest path to 95 %",
    "longest_path_99": "longest path to 99 %", "overlap_sum": "overlap, summed",
    "seen_std": "standard deviation of seen shares", "known_at": "time until a robot knows the full map",
    "map_code_bytes": "context code of the map", "map_code_multiple": "transmitted",
    "steps_after_scans": "time after the last scan",
}  # fmt: skip
"""Names of metrics and settings, where they differ from their keys."""

UNITS: Final = {
    "t50": "steps", "t90": "steps", "t95": "steps", "t99": "steps", "explored_at": "steps", "known_at": "steps",
    "scans": "scans", "bytes_per_scan": "bytes per scan", "steps_after_scans": "steps", "backlog": "log entries",
    "backlog_after_scans": "log entries", "missed_phases": "phases", "protocol_errors": "errors", "tolerance": "cells",
    "coverage": "share of reachable cells", "explored": "share of reachable cells",
    "approximation_error": "share of cells", "approximation_error_net": "share of cells",
    "overlap": "share of seen cells", "overlap_sum": "share of seen cells", "seen_std": "share of reachable cells",
    "longest_path": "m", "longest_path_95": "m", "longest_path_99": "m",
    "duty_cycle": "share of an hour", "finished": "share of runs",
    "carried": "bytes per step", "bandwidth": "bytes per step",
    "map_code_multiple": "codes of the map", "sensor_range": "m", "range": "m",
    "speed": "m per step", "steps_per_s": "steps per s", "robots": "",
}  # fmt: skip
"""Units of metrics and settings that neither their table nor their suffix determines."""

TABLES: Final = {"bytes": "bytes", "packets": "packets", "undelivered": "frames", "load": SHARE}
"""Units of the nested tables of a summary."""

SUFFIXES: Final = {
    "steps": "steps", "ms": "ms", "us": "µs", "us_median": "µs", "s": "s", "m": "m", "bytes": "bytes", "f1": SHARE,
    "precision": SHARE, "recall": SHARE, "map_accuracy": "share of reachable cells",
    "walls_within_tolerance": SHARE, "ratio": SHARE,
}  # fmt: skip
"""Units by the last parts of a key, which underscores separate."""


def unit(key: str) -> str:
    """The unit of a metric or a setting; empty if it has none."""
    table, _, name = key.rpartition(".")
    if table in TABLES:
        return TABLES[table]
    if name in UNITS:
        return UNITS[name]
    return next((text for end, text in SUFFIXES.items() if re.search(rf"(^|_){end}$", name)), "")


def label(text: str) -> str:
    """The label of a metric or a setting: ``coverage (share of reachable cells)``.

    Metrics may be sums and quotients, or relative to a variant, as in tables (`deploy.study.tables`).
    """
    name, relative, against = text.removeprefix(MIN).partition(RELATIVE)
    parts = name.split(" / ")
    named = " / ".join(" + ".join(_name(key) for key in part.split(" + ")) for part in parts)
    units = [unit(part.split(" + ")[0]) for part in parts]
    if relative:
        return f"{named}, relative to {against} (ratio)"
    if len(units) == 2:
        of = "ratio" if units[0] == units[1] else f"{units[0]} per {units[1].removesuffix('s')}"
        return f"{named} ({of})" if any(units) else named
    return f"{named} ({units[0]})" if units[0] else named


def level(key: str, value: Any, text: str) -> str:
    """The label of a setting's value, as the title of a panel: ``sensor range 3 m``; `text` is the value as text."""
    is_number = isinstance(value, int | float) or (key == "range" and text.replace(".", "", 1).isdecimal())
    with_unit = f"{text} {unit(key)}".rstrip() if is_number else text
    return f"{key.rpartition('.')[2].replace('_', ' ')} {with_unit}"


def _name(key: str) -> str:
    table, _, name = key.rpartition(".")
    kinds = (*ALL_KINDS, *CAUSES)
    return NAMES.get(key, f"{name} {table}" if name in kinds else name.replace("_", " "))
