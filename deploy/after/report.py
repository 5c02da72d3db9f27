"""`murmur report`: a self-contained HTML page of a run with its figures, or of two runs compared.

The template is ``report.html.jinja``; this module computes its contents.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader
from matplotlib.figure import Figure
from PIL import Image

from deploy.after.archive import Archive, read
from deploy.after.figures import APPROXIMATION, CHANNEL_LOAD, MAPS_OVER_TIME, compared, write_figures
from deploy.after.frames import Frames, side_by_side
from deploy.after.robot_table import CAPTION, robot_table
from deploy.record import run_directory
from deploy.record.map_pictures import counted
from netshaper.ledger import CAUSES
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
    "scan": "part of a raw laser scan",
    "update": "part of a map update",
    "pose": "a robot's position",
    "sum": "checksum of a frame",
}
"""The meaning of each kind of packet."""
assert sorted(KINDS) == sorted(ALL_KINDS)

UNDELIVERED = {
    "budget": "the budget of the step was spent",
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

CAPTIONS = {
    CHANNEL_LOAD: "Explored area over time; transmitted bytes, bytes over the budget and undelivered packets.",
    MAPS_OVER_TIME: "Each robot's planning map over time, and in red the outlines that it sends, if any.",
    APPROXIMATION: "Robot 0's own map, and in red its approximation of it. White outside the line and gray inside "
    "it are errors.",
    run_directory.PICTURE: "The world with the robots' paths, and the errors of the team's map and of each robot's "
    "map at the end.",
}

FRAMES_CAPTION = (
    "The building, grayed where no robot knows anything yet. Robots at the ends of dark lines received data from each "
    "other in this step; those of pale lines were in range. Beside it the map of each robot; below, the explored area "
    "and the use of the radio."
)
WALLS_CAPTION = (
    "Precision: share of the walls on a robot's map that lie within one cell of a true wall. Recall: share of the true "
    "walls beside reachable cells that have a wall on the map within one cell. F1: their harmonic mean. Teammates' "
    "walls: share of a teammate's settled walls that the robot's shared map has within the tolerance; the "
    "mean over teammates, and the smallest share. Walls that had not arrived by the end count as missing. All figures "
    "follow from the maps that the robots sent at the end."
)
MOST_FRAMES, FRAME_WIDTH, PAIR_WIDTH = 40, 1120, 840
"""Maximum number of frames of a slider; pixels of a frame's width, alone and beside another run."""
MOST_FRAME_BYTES = 3_000_000
"""Maximum bytes of all frames of a page; larger pages get fewer frames."""


@dataclass(frozen=True)
class Table:
    """A table: its lines, the first its head; the right-aligned columns; whether the last line is a sum."""

    lines: list[list[str]]
    right: set[int]
    has_head: bool = True
    last_is_sum: bool = False


@dataclass(frozen=True)
class Picture:
    """A picture as a data URI, with its caption; for a slider, also its step."""

    source: str
    caption: str = ""
    step: int = 0


@dataclass(frozen=True)
class Section:
    """A part of the page."""

    title: str
    tables: Sequence[Table] = ()
    pictures: Sequence[Picture] = ()
    frames: Sequence[Picture] = ()
    caption: str = ""
    texts: Sequence[str] = ()


def write_report(directory: Path, other: Path | None = None) -> Path:
    """Draw the figures of a run and write its page, or a page that compares it with another run; return the page.

    Raises ScenarioError if a directory is not a run directory, or a table is missing.
    """
    archive = read(directory)
    if other is None:
        figures = write_figures(archive, directory / run_directory.PICTURES)
        if (directory / run_directory.PICTURE).is_file():
            figures.append(directory / run_directory.PICTURE)
        path, text = directory / REPORT, page(archive, figures)
    else:
        path = directory / f"compared-with-{other.resolve().name}.html"
        text = comparison({directory: archive, other: read(other)})
    write_whole(path, lambda file: file.write(text.encode()))
    return path


def page(archive: Archive, figures: Sequence[Path]) -> str:
    """The page of a run, with all pictures embedded."""
    summary = archive.summary
    scenario = (archive.directory / run_directory.SCENARIO).read_text(encoding="utf-8")
    return _render(
        f"{counted(summary['robots'], 'robot')} on {summary['map']}",
        [_abstract(summary)],
        [
            Section("The run", [_table(_figures(summary), right=(), has_head=False)]),
            Section(
                "Step by step", frames=_frames([Frames(archive, FRAME_WIDTH)]), caption=FRAMES_CAPTION
            ),
            Section("Pictures", pictures=[_picture(figure.read_bytes(), CAPTIONS[figure.name]) for figure in figures]),
            Section("The robots", [_table(robot_table(archive))], caption=CAPTION),
            Section("Walls on the robots' maps", [_table(_walls(summary))], caption=WALLS_CAPTION),
            Section("Traffic", [_table(_kinds(summary), last_is_sum=True), _table(_undelivered(summary))]),
            Section("The scenario", texts=[scenario]),
        ],
        {"": summary["digest"]} if archive.plan.has_truth else {},
    )  # fmt: skip


def comparison(runs: dict[Path, Archive]) -> str:
    """The page that compares runs, by their directories."""
    names = _names(list(runs))
    archives = list(runs.values())
    summaries = [archive.summary for archive in archives]
    file = io.BytesIO()
    curves: Figure = compared(dict(zip(names, archives, strict=True)))
    curves.savefig(file, format="png", dpi=100)
    pictures = [_picture(file.getvalue(), "Explored area of each team over time, and its use of the radio.")]
    for name, archive in zip(names, archives, strict=True):
        maps = archive.directory / run_directory.PICTURE
        if maps.is_file():
            pictures.append(_picture(maps.read_bytes(), f"{name}: {CAPTIONS[maps.name]}"))
    figures = [_figures(summary) for summary in summaries]
    rows = [[row[0], *(dict(each).get(row[0], "-") for each in figures)] for row in figures[0]]
    shown = [Frames(archive, PAIR_WIDTH) for archive in archives]
    return _render(
        " and ".join(names),
        [f"{name}: {_abstract(summary)}" for name, summary in zip(names, summaries, strict=True)],
        [
            Section("The runs", [_table([["", *names], *rows], right=())]),
            Section("Different settings", [_table([["", *names], *_differences(archives)], right=())]),
            Section("Step by step", frames=_frames(shown), caption=FRAMES_CAPTION),
            Section("Pictures", pictures=pictures),
            Section("Traffic", [_table(_traffic(names, summaries), last_is_sum=True)]),
        ],
        {
            name: archive.summary["digest"]
            for name, archive in zip(names, archives, strict=True)
            if archive.plan.has_truth
        },
        wide=True,
    )


def _render(
    title: str, lead: list[str], sections: list[Section], digests: dict[str, str], *, wide: bool = False
) -> str:
    environment = Environment(
        loader=PackageLoader("deploy.after", "."), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    shown = [
        each
        for each in sections
        if each.pictures or each.frames or each.texts or any(len(t.lines) > t.has_head for t in each.tables)
    ]
    return environment.get_template("report.html.jinja").render(
        title=title, lead=lead, sections=shown, wide=wide,
        digests=[{"run": run, "value": value} for run, value in digests.items()],
    )  # fmt: skip


def _frames(runs: list[Frames]) -> list[Picture]:
    """The pictures of a slider: evenly spaced over the longest run, as many as fit the page."""
    last = max(run.last_step for run in runs)
    steps = np.unique(np.linspace(1, max(1, last), min(MOST_FRAMES, max(1, last))).round().astype(int))
    pictures = [_png(side_by_side(runs, int(step))) for step in steps]
    while len(pictures) > 2 and sum(map(len, pictures)) > MOST_FRAME_BYTES * 3 / 4:
        steps, pictures = steps[::-2][::-1], pictures[::-2][::-1]
    return [_picture(data, step=int(step)) for step, data in zip(steps, pictures, strict=True)]


def _png(picture: Image.Image) -> bytes:
    """A picture as a small PNG of at most 128 colors."""
    file = io.BytesIO()
    small = picture.quantize(128, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    small.save(file, "PNG")
    return file.getvalue()


def _names(directories: list[Path]) -> list[str]:
    """Short but distinct names of runs."""
    short = [directory.resolve().name for directory in directories]
    return short if len(set(short)) == len(short) else [str(directory) for directory in directories]


def _differences(archives: list[Archive]) -> list[list[str]]:
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


def _traffic(names: list[str], summaries: list[dict[str, Any]]) -> list[list[str]]:
    """Bytes of each packet kind that any run has sent."""
    counts = [summary["bytes"] for summary in summaries]
    rows = [
        [kind, KINDS[kind], *(f"{each.get(kind, 0):,}" for each in counts)]
        for kind in ALL_KINDS
        if any(kind in each for each in counts)
    ]
    head = ["packet", "meaning", *(f"bytes, {name}" for name in names)]
    return [head, *rows, ["all", "", *(f"{each['total']:,}" for each in counts)]]


def _abstract(summary: dict[str, Any]) -> str:
    budget = summary["bandwidth"]
    medium = "unlimited bandwidth" if isinstance(budget, str) else f"at most {budget} bytes per step"
    reach = "in the field" if summary["range_m"] is None else f"range {summary['range_m']:.1f} m"
    radio = f"Radio: {medium}, {reach}; map encoding: {summary['map_encoding']}."
    if summary["finished"]:
        first = f"robot {summary['first_robot']} finished first"
        return f"Explored in {summary['steps']} steps; {first}. {radio}"
    return f"Not finished after {summary['steps']} steps: {summary['reason']}. {radio}"


def _figures(summary: dict[str, Any]) -> list[list[str]]:
    error = summary.get("approximation_error")
    return [
        *_true_map_figures(summary),
        *_wall_figures(summary),
        *_missed_figures(summary),
        ["strategy, seed", f"{summary['strategy']}, {summary['seed']}"],
        *([] if error is None else [["approximation error (Eq. 6.1)", f"{error:.2%} of the cells"]]),
        ["transmitted", f"{summary['bytes']['total']:,} bytes in {summary['packets']['total']:,} packets"],
        ["bus", f"{summary['bus']}, {summary['steps_per_s']} steps per second"],
    ]


def _true_map_figures(summary: dict[str, Any]) -> list[list[str]]:
    """What needs a true map; of robots in the field, how much of the team's map each robot has instead."""
    if summary.get("clock") == "field":
        worst = _percent(summary["worst_team_map_held"])
        return [
            [
                "free cells of the team's map that a robot has",
                f"mean {_percent(summary['team_map_held'])}, worst {worst}",
            ]
        ]
    return [
        ["reachable cells seen by the team", _percent(summary["coverage"])],
        ["map accuracy", _accuracy(summary)],
        ["team had seen 90 %, 99 %", f"step {summary['t90'] or '-'}, step {summary['t99'] or '-'}"],
        ["steps over the budget", str(summary["over_budget_steps"])],
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
        within = f"within {counted(summary['tolerance'], 'cell')}"
        rows.append(
            [
                "teammates' walls on a robot's shared map",
                f"mean {_percent(held)}, worst pair {worst}, {within}",
            ]
        )
    return rows


def _walls(summary: dict[str, Any]) -> list[list[str]]:
    """The fit of walls for each robot, with the mean and the minimum of all."""
    within = f"within {counted(summary.get('tolerance', 0), 'cell')}"
    names = {
        "wall_precision": "precision",
        "wall_recall": "recall",
        "wall_f1": "F1",
        "walls_within_tolerance": f"teammates' walls {within}",
        "worst_walls_within_tolerance": f"worst teammate's walls {within}",
    }
    maps: dict[str, dict[str, float | None]] = summary.get("robot_maps", {})
    rows = [[robot, *(_percent(figures[name]) for name in names)] for robot, figures in maps.items()]
    if len(maps) > 1:
        known = [[value for each in maps.values() if (value := each[name]) is not None] for name in names]
        rows.append(["mean", *(_percent(fmean(values) if values else None) for values in known)])
        rows.append(["worst", *(_percent(min(values, default=None)) for values in known)])
    return [["robot", *names.values()], *rows]


def _kinds(summary: dict[str, Any]) -> list[list[str]]:
    total = summary["bytes"]["total"]
    rows = [["packet", "meaning", "packets", "bytes", "share"]]
    for kind in ALL_KINDS:
        if kind in summary["bytes"]:
            size, count = summary["bytes"][kind], summary["packets"][kind]
            rows.append([kind, KINDS[kind], f"{count:,}", f"{size:,}", _percent(size / total)])
    return [*rows, ["all", "", f"{summary['packets']['total']:,}", f"{total:,}", ""]]


def _undelivered(summary: dict[str, Any]) -> list[list[str]]:
    rows = [[UNDELIVERED[cause], f"{count:,}"] for cause, count in summary["undelivered"].items()]
    return [["frames not delivered in full, because", "frames"], *rows]


def _table(
    lines: list[list[str]],
    *,
    right: Iterable[int] | None = None,
    has_head: bool = True,
    last_is_sum: bool = False,
) -> Table:
    """A table with right-aligned columns: `right`, or else those of numbers."""
    body = lines[1:] if has_head else lines
    columns = set(right) if right is not None else _numeric(body) if body else set()
    return Table(lines, columns, has_head, last_is_sum)


def _numeric(rows: list[list[str]]) -> set[int]:
    columns = enumerate(zip(*rows, strict=True))
    return {c for c, texts in columns if all(text in ("", "-") or text[0].isdigit() for text in texts)}


def _picture(png: bytes, caption: str = "", step: int = 0) -> Picture:
    return Picture(f"data:image/png;base64,{base64.b64encode(png).decode()}", caption, step)


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f} %"
