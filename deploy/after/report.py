"""`murmur report`: one self-contained HTML page of a run, with its figures."""

from __future__ import annotations

import base64
from collections.abc import Callable, Iterable, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from deploy.after.archive import Archive, read
from deploy.after.figures import APPROXIMATION, CHANNEL_LOAD, MAPS_OVER_TIME, write_figures
from deploy.record import run_directory
from netshaper.ledger import CAUSES, EVERYONE
from protocol.packets import ALL_KINDS
from worldsim.atomic_files import write_whole

REPORT = "report.html"

KINDS = {
    "ins": "a corner inserted into an outline",
    "rep": "a corner replaced",
    "del": "a corner deleted",
    "em": "a new object",
    "chg": "which object the next corners belong to",
    "rm": "an object removed",
    "conn": "handshake of a connection",
    "targ": "a robot's target",
    "save": "end of an update",
    "scan": "piece of a raw laser scan",
    "look": "piece of a unit of looks",
    "pose": "a robot's position",
    "sum": "checksum of a frame",
}
"""The meaning of each kind of packet."""
assert sorted(KINDS) == sorted(ALL_KINDS)

UNDELIVERED = {
    "budget": "the step's budget was spent",
    "range": "the receiver was out of range",
    "protocol": "they were malformed or out of turn",
    "lost": "the other robot had died",
    "limit": "the sender had said as much as it can",
    "loss": "they were lost on the air",
    "damaged": "they were damaged on the air",
    "full": "the receiver had heard as much as it can",
}
"""Why a frame was not delivered."""
assert ("", *UNDELIVERED) == CAUSES

CAPTIONS = {
    CHANNEL_LOAD: "Bytes on the air in each step, bytes that did not fit, and the explored area over the same steps.",
    MAPS_OVER_TIME: "Each robot's planning map over time, and in red the approximation that it sends of its own map.",
    APPROXIMATION: "What robot 0 has seen itself, and in red its approximation of it: white outside the line "
    "and grey within are its errors.",
    run_directory.PICTURE: "The world with the robots' paths, what the team has seen, and all maps at the end.",
}

STYLE = """
:root { color-scheme: light; }
body { font: 16px/1.5 system-ui, sans-serif; color: #1b1f24 }
body { max-width: 70rem; margin: 2rem auto; padding: 0 1rem }
h1 { font-size: 1.6rem } h2 { font-size: 1.2rem; margin-top: 2.5rem; border-bottom: 1px solid #d5d9de }
table { border-collapse: collapse; margin: 1rem 0 }
th, td { padding: .25rem .9rem .25rem 0; text-align: left }
th { border-bottom: 1px solid #9aa1a9; font-weight: 600 } td.n, th.n { text-align: right }
tr.sum td { border-top: 1px solid #9aa1a9; font-weight: 600 }
img { max-width: 100%; display: block } figure { margin: 1.5rem 0 } figcaption { color: #4a525b }
pre { background: #f3f5f7; padding: 1rem; overflow-x: auto; font-size: .85rem } code { font-size: .9em }
.lead { font-size: 1.1rem }
"""


def write_report(directory: Path, tell: Callable[[str], object] = lambda _: None) -> Path:
    """Draw the figures of a run and write its page; return the page.

    Raises
    ------
    ScenarioError
        It is no run directory, or too little came of the run.
    """
    archive = read(directory)
    figures = write_figures(archive, directory / run_directory.PICTURES, tell)
    if (directory / run_directory.PICTURE).is_file():
        figures.append(directory / run_directory.PICTURE)
    path = directory / REPORT
    text = page(archive, figures)
    write_whole(path, lambda file: file.write(text.encode()))
    return path


def page(archive: Archive, figures: Sequence[Path]) -> str:
    """The page of a run, with all pictures embedded."""
    summary = archive.summary
    title = f"{summary['robots']} robots on {summary['map']}"
    scenario = (archive.directory / run_directory.SCENARIO).read_text(encoding="utf-8")
    parts = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="lead">{escape(_in_words(summary))}</p>',
        *_section("The run", _rows(_figures(summary), numbers=())),
        *_section("The robots", _rows(_robots(archive))),
        *_section(
            "Traffic on the air", _rows(_kinds(summary), last_is_sum=True), _rows(_undelivered(summary))
        ),
        *_section("Pictures", *(_picture(figure) for figure in figures)),
        *_section("The scenario", f"<pre>{escape(scenario)}</pre>"),
        "<p>Repeat the run: <code>murmur replay</code> with this directory. Its digest, which two equal runs "
        f"share: <code>{escape(summary['digest'])}</code></p>",
    ]
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>{STYLE}</style>'
    return (
        f'<!doctype html>\n<html lang="en"><head>{head}</head>\n<body>\n'
        + "\n".join(parts)
        + "\n</body></html>\n"
    )


def _in_words(summary: dict[str, Any]) -> str:
    budget = summary["bandwidth"]
    medium = "unlimited bandwidth" if isinstance(budget, str) else f"at most {budget} bytes a step"
    told = f"Radio: {medium}, range {summary['range_m']:.1f} m ({summary['exchange']} exchange)."
    if summary["finished"]:
        first = f"robot {summary['first_robot']} finished first"
        return f"Explored in {summary['steps']} steps; {first}. {told}"
    return f"Not finished after {summary['steps']} steps: {summary['reason']}. {told}"


def _figures(summary: dict[str, Any]) -> list[list[str]]:
    agreement = summary["map_agreement"]
    rows = [
        ["reachable cells seen by the team", _percent(summary["coverage"])],
        ["correct on the planning map of the first robot", "-" if agreement is None else _percent(agreement)],
        ["team had seen 90 %, 99 %", f"step {summary['t90'] or '-'}, step {summary['t99'] or '-'}"],
        ["strategy, seed", f"{summary['strategy']}, {summary['seed']}"],
        ["on the air", f"{summary['bytes']['total']:,} bytes in {summary['packets']['total']:,} packets"],
        ["steps over the budget", str(summary["over_budget_steps"])],
        ["bus", f"{summary['bus']}, {summary['steps_per_s']} steps a second"],
    ]
    if summary.get("approximation_error") is not None:
        rows.insert(
            4, ["approximation error (Eq. 6.1)", f"{summary['approximation_error']:.2%} of the cells"]
        )
    return [["", ""], *rows]


def _robots(archive: Archive) -> list[list[str]]:
    ledger, summary = archive.ledger, archive.summary
    carried = ledger["carried"].astype(bool)
    rows = [["robot", "driven [m]", "sent [bytes]", "received [bytes]", "cells seen", "last status"]]
    for robot in range(summary["robots"]):
        mine = archive.of_robot(robot)
        said = int(ledger["bytes"][carried & (ledger["sender"] == robot)].sum())
        unicast = carried & (ledger["receiver"] == robot) & (ledger["receiver"] != EVERYONE)
        heard = int((ledger["bytes"] * ledger["heard"])[unicast].sum())
        seen = mine["known_cells"][~np.isnan(mine["known_cells"])]
        status = summary["lost"].get(str(robot)) or next((s for s in mine["status"][::-1] if s), "-")
        driven = f"{mine['driven'][-1]:.1f}" if len(mine["driven"]) else "-"
        known = f"{int(seen[-1]):,}" if len(seen) else "-"
        rows.append([str(robot), driven, f"{said:,}", f"{heard:,}", known, status])
    return rows


def _kinds(summary: dict[str, Any]) -> list[list[str]]:
    total = summary["bytes"]["total"]
    rows = [["packet", "meaning", "packets", "bytes", "share"]]
    for kind in ALL_KINDS:
        if kind in summary["bytes"]:
            size, count = summary["bytes"][kind], summary["packets"][kind]
            rows.append([kind, KINDS[kind], f"{count:,}", f"{size:,}", _percent(size / total)])
    return [*rows, ["all", "", f"{summary['packets']['total']:,}", f"{total:,}", ""]]


def _undelivered(summary: dict[str, Any]) -> list[list[str]]:
    rows = [["frames not delivered whole, because", "frames"]]
    return [
        *rows,
        *([UNDELIVERED[cause], f"{count:,}"] for cause, count in summary["undelivered"].items()),
    ]


def _section(title: str, *parts: str) -> list[str]:
    return [f"<h2>{escape(title)}</h2>", *(part for part in parts if part)]


def _rows(rows: list[list[str]], *, numbers: Iterable[int] | None = None, last_is_sum: bool = False) -> str:
    """A table whose first row is the header, figures right-aligned; nothing if there are no other rows."""
    if len(rows) < 2:
        return ""
    right = _numeric(rows[1:]) if numbers is None else set(numbers)
    lines = []
    for index, row in enumerate(rows):
        cell = "th" if index == 0 else "td"
        cells = "".join(
            f"<{cell}{' class=n' if column in right else ''}>{escape(text)}</{cell}>"
            for column, text in enumerate(row)
        )
        is_sum = last_is_sum and index == len(rows) - 1
        if any(row):
            lines.append(f"<tr{' class=sum' if is_sum else ''}>{cells}</tr>")
    return "<table>" + "\n".join(lines) + "</table>"


def _numeric(rows: list[list[str]]) -> set[int]:
    return {
        c
        for c in range(len(rows[0]))
        if all(not row[c] or row[c][0].isdigit() or row[c] == "-" for row in rows)
    }


def _picture(path: Path) -> str:
    data = base64.b64encode(path.read_bytes()).decode()
    words = CAPTIONS[path.name]
    return (
        f'<figure><img alt="{escape(words)}" src="data:image/png;base64,{data}">'
        f"<figcaption>{escape(words)}</figcaption></figure>"
    )


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"
