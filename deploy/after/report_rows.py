"""The texts of a report's tables: rows of cells, the first of which is the head where a table has one."""

from __future__ import annotations

from collections.abc import Iterable
from statistics import fmean
from typing import Any

from deploy.after.archive import Archive
from deploy.record.number_texts import counted, percent
from deploy.record.summary import replayed
from netshaper.ledger import CAUSES
from protocol.packets import ALL_KINDS

KINDS = {
    "ins": "a corner inserted into an outline",
    "rep": "a corner replaced",
    "del": "a corner deleted",
    "em": "a new object",
    "chg": "which object the next corners belong to",
    "rm": "an object removed",
    "conn": "replication control: an offer, an answer, a log offset or digest, or a meeting",
    "targ": "a robot's target",
    "save": "end of an update",
    "scan": "part of a raw laser scan",
    "update": "part of a map update",
    "pose": "a robot's position",
    "sum": "checksum of a frame",
}
"""The meaning of each kind of packet."""
assert sorted(KINDS) == sorted(ALL_KINDS)

UNDELIVERED = {
    "budget": "the budget of the step was spent, or the share of poses and targets",
    "range": "the receiver was out of range",
    "protocol": "they were malformed or out of order",
    "lost": "the other robot was lost",
    "mute": "the sender's radio failed",
    "limit": "the sender had reached its limit",
    "loss": "they were lost by the channel",
    "damaged": "they were damaged by the channel",
    "full": "the receiver had reached its limit",
}
"""Causes for frames that were not delivered."""
assert ("", *UNDELIVERED) == CAUSES


def differing_settings(archives: list[Archive]) -> list[list[str]]:
    """Settings that differ between runs; the map by its name."""
    flat = []
    for archive in archives:
        settings = archive.plan.scenario.model_dump(mode="json") | {"map": archive.plan.map.name}
        flat.append(dict(_leaves(settings)))
    keys = dict.fromkeys(key for settings in flat for key in settings)
    rows = [[key, *(settings.get(key, "-") for settings in flat)] for key in keys]
    return [row for row in rows if len(set(row[1:])) > 1]


def _leaves(settings: dict[str, Any], before: str = "") -> Iterable[tuple[str, str]]:
    for key, value in settings.items():
        if isinstance(value, dict):
            yield from _leaves(value, f"{before}{key}.")
        else:
            yield before + key, "-" if value is None else str(value)


def traffic_rows(names: list[str], summaries: list[dict[str, Any]]) -> list[list[str]]:
    """Bytes of each packet kind that any run has sent."""
    counts = [summary["bytes"] for summary in summaries]
    rows = [
        [kind, KINDS[kind], *(f"{each.get(kind, 0):,}" for each in counts)]
        for kind in ALL_KINDS
        if any(kind in each for each in counts)
    ]
    head = ["packet", "meaning", *(f"bytes, {name}" for name in names)]
    return [head, *rows, ["all", "", *(f"{each['total']:,}" for each in counts)]]


def abstract(summary: dict[str, Any]) -> str:
    """How a run ended, and with which radio, in two sentences."""
    budget = summary["bandwidth"]
    medium = "unlimited bandwidth" if isinstance(budget, str) else f"at most {budget:,} bytes per step"
    reach = "in the field" if summary["range_m"] is None else f"range {summary['range_m']:.1f} m"
    radio = f"Radio: {medium}, {reach}; map encoding: {summary['map_encoding']}."
    if "scans" in summary:
        return f"{replayed(summary)} {radio}"
    if summary["finished"]:
        first = f"robot {summary['first_robot']} finished first"
        return f"Explored in {counted(summary['steps'], 'step')}; {first}. {radio}"
    return f"Not finished after {counted(summary['steps'], 'step')}: {summary['reason']}. {radio}"


def figure_rows(summary: dict[str, Any]) -> list[list[str]]:
    """The figures of a run, each with its name; without a head."""
    error = summary.get("approximation_error")
    return [
        *_true_map_figures(summary),
        *_wall_figures(summary),
        *_missed_figures(summary),
        ["strategy, seed", f"{summary['strategy']}, {summary['seed']}"],
        *([] if error is None else [["approximation error (Eq. 6.1)", f"{100 * error:.2f} % of the cells"]]),
        ["transmitted", f"{summary['bytes']['total']:,} bytes in {summary['packets']['total']:,} packets"],
        ["bus", f"{summary['bus']}, {summary['steps_per_s']} steps per second"],
    ]


def _true_map_figures(summary: dict[str, Any]) -> list[list[str]]:
    """What needs a true map, or that of all scans; of robots in the field, how much of the team's map each has."""
    if summary.get("clock") == "field":
        mean, worst = (_percent(summary[name]) for name in ("team_map_held", "worst_team_map_held"))
        return [["free cells of the team's map that a robot has", f"mean {mean}, worst {worst}"]]
    seen, right = "reachable cells seen by the team", "map accuracy"
    if "scans" in summary:
        seen, right = (
            "free cells of the map of all scans that the team saw",
            "map accuracy, relative to that map",
        )
    return [
        *_recorded_figures(summary),
        [seen, _percent(summary["coverage"])],
        [right, _accuracy(summary)],
        [
            "team had seen 90 %, 99 %",
            ", ".join(f"step {at}" if at else "not reached" for at in (summary["t90"], summary["t99"])),
        ],
        ["steps over the budget", str(summary["over_budget_steps"])],
    ]


def _recorded_figures(summary: dict[str, Any]) -> list[list[str]]:
    """What the maps of a log have cost; nothing of a simulated run."""
    if "scans" not in summary:
        return []
    per_scan = "-" if summary["bytes_per_scan"] is None else f"{summary['bytes_per_scan']} bytes"
    late = counted(summary["steps_after_scans"], "step") if summary["finished"] else "never"
    return [
        ["replayed", f"{counted(summary['scans'], 'scan')} of {', '.join(summary['logs'])}"],
        ["transmitted per scan", per_scan],
        ["after the last scan, teammates held all maps within", late],
    ]


def _missed_figures(summary: dict[str, Any]) -> list[list[str]]:
    """The steps that robots missed by their clocks; nothing with the barrier, or of older runs."""
    by_robot = summary.get("missed_steps_by_robot")
    if summary.get("clock", "barrier") == "barrier" or by_robot is None:
        return []
    name = (
        "steps that took robots too long" if summary.get("clock") == "field" else "steps that robots missed"
    )
    worst = max(range(len(by_robot)), key=by_robot.__getitem__)
    most = f", most by robot {worst}: {by_robot[worst]}" if by_robot[worst] else ""
    return [[name, f"{summary['missed_steps']} of {summary['steps'] * len(by_robot)}{most}"]]


def _accuracy(summary: dict[str, Any]) -> str:
    """The accuracy of planning grids: of the first robot, the mean, and the worst."""
    first = _percent(summary["map_accuracy"])
    if (mean := summary.get("mean_map_accuracy")) is None:
        return f"first robot {first}"
    return (
        f"mean {_percent(mean)}, worst robot {_percent(summary['worst_map_accuracy'])}, first robot {first}"
    )


def _wall_figures(summary: dict[str, Any]) -> list[list[str]]:
    """The fit of walls to the true ones and to each other, if it is known."""
    rows = []
    if (f1 := summary.get("claimed_mean_wall_f1")) is not None:
        worst = _percent(summary["claimed_worst_wall_f1"])
        rows.append(["F1 of walls within one cell", f"mean {_percent(f1)}, worst robot {worst}"])
    if (held := summary.get("walls_within_tolerance")) is not None:
        worst = _percent(summary["worst_walls_within_tolerance"])
        fit = f"mean {_percent(held)}, worst pair {worst}, within {counted(summary['tolerance'], 'cell')}"
        rows.append(["agreement of walls", fit])
    return rows


def wall_rows(summary: dict[str, Any]) -> list[list[str]]:
    """The fit of walls for each robot, with the mean and the minimum of all."""
    within = f"within {counted(summary.get('tolerance', 0), 'cell')}"
    names = {
        "wall_precision": "precision",
        "wall_recall": "recall",
        "wall_f1": "F1",
        "walls_within_tolerance": f"agreement {within}",
        "worst_walls_within_tolerance": f"worst agreement {within}",
    }
    maps: dict[str, dict[str, float | None]] = summary.get("robot_maps", {})
    rows = [[robot, *(_percent(figures[name]) for name in names)] for robot, figures in maps.items()]
    if len(maps) > 1:
        known = [[value for each in maps.values() if (value := each[name]) is not None] for name in names]
        rows.append(["mean", *(_percent(fmean(values) if values else None) for values in known)])
        rows.append(["worst", *(_percent(min(values, default=None)) for values in known)])
    return [["robot", *names.values()], *rows]


def kind_rows(summary: dict[str, Any]) -> list[list[str]]:
    """Number and bytes of each kind of packet, and their sum."""
    total = summary["bytes"]["total"]
    rows = [["packet", "meaning", "packets", "bytes", "share"]]
    for kind in ALL_KINDS:
        if kind in summary["bytes"]:
            size, count = summary["bytes"][kind], summary["packets"][kind]
            rows.append([kind, KINDS[kind], f"{count:,}", f"{size:,}", _percent(size / total)])
    return [*rows, ["all", "", f"{summary['packets']['total']:,}", f"{total:,}", ""]]


def undelivered_rows(summary: dict[str, Any]) -> list[list[str]]:
    """The number of frames that were not delivered, by cause."""
    rows = [[UNDELIVERED[cause], f"{count:,}"] for cause, count in summary["undelivered"].items()]
    return [["frames not delivered in full, because", "frames"], *rows]


def _percent(share: float | None) -> str:
    return "-" if share is None else percent(share)
