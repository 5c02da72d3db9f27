"""Tables in docs that follow from code: settings and settings of hosts.

Run ``python -m docs.code_tables`` after a change; `tests/deploy/test_docs.py` compares pages and code.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Any

from agent.encoding_options import PolygonOptions, PredictiveOptions
from deploy.run.hosts import Host, Hosts
from deploy.scenario.hardware import RobotOverride
from deploy.scenario.scenario import Scenario
from deploy.scenario.tables import ChangeTable, FaultTable
from netshaper.radio_options import RadioOptions
from worldsim.people_options import PeopleOptions
from worldsim.recorded.options import RecordingOptions
from worldsim.sensor_options import LaserOptions, PoseOptions

DOCS = Path(__file__).parent

OPTIONS = {
    "polygons": {
        "medium_use": "fraction u of the medium that the splitting frequency plans with (Eq. 5.5); thesis: 0.5",
        "bytes_per_split": "bytes d per split (Eq. 5.5); 0: measured during the run",
        "splits_per_step": "splits per step, s, also for one robot and without a budget; 0: by Eq. 5.5",
        "lazy": "log an edit script only once teammates in range hold the previous one; thesis: false",
        "mixed_first": "refine edges of mixed occupancy first; thesis: false",
        "value_function": "value of the edge refined first: `segment-distance` (Algorithm 6), `height`, `width`, "
        "or `area`",
        "free_inside_edges": "draw inside edges labeled free; thesis: true",
        "unknown_pairs": "send outside objects of two vertices without a wall; thesis: true",
        "wide_walls": "treat unknown cells beside the wall of a teammate in range as wall; thesis: false",
        "wide_seen_walls": "also beside walls that the robot has seen itself; false by default with `repairmen` and "
        "other strategies that set `looks_from_afar`: complete maps, some steps more",
        "close_slivers": "treat unknown slivers between free cells of teammates as free; thesis: false",
        "keep_walls": "let walls of outside objects override free inside edges, not the reverse; Algorithm 9: false",
        "scan_order": "also send `chg` for objects whose place in scan order changes (Algorithm 3)",
        "moving_starts": "start vertex lists of objects where Algorithm 3 starts them, which costs `del` and `ins`",
        "exact_error": "also measure the error of an exact approximation (`approximation_error_net`)",
    },
    "predictive": {
        "base": 'logs that an entry may depend on: `"team"`, all that its author has received; `"own"`, its own',
        "patience": "factor of the times for which changed tiles of noisy maps wait; recorded runs: 2",
    },
    "laser": {
        "preset": "a [laser by name](real-sensors.md#lasers), for values that the scenario does not give",
        "range_error_m": "standard deviation of a range, meters",
        "range_error_share": "the same as a share of the range; both add up",
        "short": "probability that a beam ends early, at something that passes by",
        "missing": "probability that a beam has no return",
        "mixed": "probability that a beam beside an edge measures between its two surfaces",
        "min_range_m": "shortest range, meters; below, there is no measurement",
        "max_range_m": "longest range, meters; 0: no limit",
        "beams": "beams over the field of view; 0: as many as `beams` has there",
        "rate": "scans per step, at most 1; 0.2: a scan every fifth step",
    },
    "pose": {
        "preset": "a [localization method](real-sensors.md#poses), for values that the scenario does not give",
        "position_error_m": "standard deviation of each coordinate, meters",
        "heading_error_deg": "standard deviation of the heading, degrees",
    },
    "people": {
        "number": "number of [people](real-sensors.md#people) who walk about in the building",
        "speed": "walking speed, meters per step",
        "radius": "radius of the disc that a person covers, meters",
    },
    "recording": {
        "files": "[logs](recorded.md), for the whole team or one per robot with scans; relative to the scenario file",
        "every": "1: replay all scans; 5: each fifth",
        "pace": '`"scan"`: one scan per robot and step; `"recorded"`: a step is a second of the log',
        "topic": "topic of the laser, if a bag has several",
        "resolution": "side of a cell, meters",
        "listeners": "how many of the robots, the last ones, have no scans, and only receive maps",
    },
    "radio": {
        "preset": "a [radio by name](radios.md#radios-by-name), for values that the scenario does not give",
        "frame_bytes": "bytes of packets per frame; 0: no limit",
        "model": "connectivity: disc, line-of-sight, log-distance, or a [plug-in](plugins.md)",
        "exponent": "log-distance: path loss exponent",
        "db_per_meter": "log-distance: loss per meter, dB",
        "db_per_wall": "log-distance: loss per wall, dB",
        "shadowing_db": "log-distance: standard deviation of shadowing, dB",
        "shadowing_m": "log-distance: side of the squares with constant shadowing, meters",
        "loss": "probability that a receiver loses a frame",
        "burst_loss": "the same during a burst",
        "burst_every": "mean steps between bursts of a link; 0: none",
        "burst_steps": "mean steps of a burst",
        "delay": "steps until a frame arrives",
        "jitter": "additional random delay, steps at most",
        "duplication": "probability that a frame arrives twice",
        "bit_errors": "probability of each bit to flip",
        "checksums": "checksums even without bit errors",
        "send_bytes": "bytes per step that a robot can send; 0: no limit of its own",
        "receive_bytes": "bytes per step that a robot can receive; 0: no limit of its own",
        "duty_cycle": "share of each hour in which a robot may send; 1: no limit",
        "reuse": "spatial reuse: the bandwidth applies to each neighborhood, not to the team",
        "partition": "steps in which groups of robots are out of each other's range",
    },
}
"""Meanings of options that a scenario's tables hold."""

LISTS = {"robot": RobotOverride, "fault": FaultTable, "change": ChangeTable}
"""Settings that are lists of tables; the table lists their fields after all others."""


def plain(value: object) -> str:
    """Return a default as TOML; ``-`` for none."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return str(value).lower()
    return f'"{value}"' if isinstance(value, str) else str(value)


def settings() -> Iterator[tuple[str, str, str]]:
    """Yield name, default and meaning of each setting of a scenario."""
    options = {
        "polygons": asdict(PolygonOptions()),
        "predictive": asdict(PredictiveOptions()),
        "radio": {**asdict(RadioOptions()), "partition": []},
        "laser": asdict(LaserOptions()),
        "pose": asdict(PoseOptions()),
        "people": asdict(PeopleOptions()),
        "recording": {**asdict(RecordingOptions()), "files": []},
    }
    for name, default, meaning in _fields(Scenario, ""):
        if name in options:
            yield from (
                (f"{name}.{key}", plain(value), OPTIONS[name][key]) for key, value in options[name].items()
            )
        elif name not in LISTS:
            yield name, default, meaning
    for name, kind in LISTS.items():
        yield from _fields(kind, f"{name}.")


def host_settings() -> Iterator[tuple[str, str, str]]:
    """Yield name, default and meaning of each setting of a hosts file."""
    yield from (row for row in _fields(Hosts, "") if row[0] != "host")
    yield from _fields(Host, "host.")


def updated(page: str, head: str, rows: Iterable[tuple[str, ...]]) -> str:
    """Return the page with the rows of the table below a head line replaced."""
    table = "".join(f"| {' | '.join(row)} |\n" for row in rows)
    return re.sub(rf"(?<={re.escape(head)}\n)(\|[-|]*\n)(\|[^\n]*\n)*", lambda match: match[1] + table, page)


def main() -> None:
    """Rewrite the tables in the pages."""
    for name, head, rows in (
        ("settings.md", "| setting | default | meaning |", _coded(settings())),
        ("hosts.md", "| setting | default | meaning |", _coded(host_settings())),
    ):
        page = DOCS / name
        page.write_text(updated(page.read_text(encoding="utf-8"), head, rows), encoding="utf-8")


def _fields(kind: Any, prefix: str) -> Iterator[tuple[str, str, str]]:
    earlier: dict[str, Any] = {}
    for name, info in kind.model_fields.items():
        default = "required"
        if not info.is_required():
            earlier[name] = info.get_default(call_default_factory=True, validated_data=earlier)
            default = plain(earlier[name])
        yield prefix + name, default, info.description or ""


def _coded(rows: Iterable[tuple[str, str, str]]) -> Iterator[tuple[str, ...]]:
    for name, default, meaning in rows:
        yield f"`{name}`", default if default in ("required", "-") else f"`{default}`", meaning


if __name__ == "__main__":
    main()
