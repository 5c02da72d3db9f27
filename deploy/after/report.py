"""`murmur report`: a self-contained HTML page of a run with its figures, or of two runs compared.

The template is ``report.html.jinja``; this module computes its contents, and `report_rows` the texts of its tables.
"""

from __future__ import annotations

import base64
import contextlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader
from PIL import Image

from deploy.after import report_rows
from deploy.after.archive import Archive, read
from deploy.after.figures import APPROXIMATION, CHANNEL_LOAD, MAPS_OVER_TIME, compared, write_figures
from deploy.after.frames import Frames, side_by_side
from deploy.after.robot_table import CAPTION, robot_table
from deploy.record import run_directory
from deploy.record.number_texts import counted
from protocol.temporary import temporary_folder
from worldsim.atomic_files import write_whole

REPORT = "report.html"

CAPTIONS = {
    CHANNEL_LOAD: "Explored area over time; bytes that were transmitted, and that were not; undelivered log entries.",
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
    "walls beside reachable cells that have a wall on the map within one cell. F1: their harmonic mean. Agreement: "
    "share of a teammate's settled walls that the robot's shared map has within the tolerance; the mean over "
    "teammates, and the smallest share. Walls that had not arrived by the end count as missing. All figures "
    "follow from the maps that the robots sent at the end."
)
MOST_FRAMES, FRAME_WIDTH, PAIR_WIDTH = 40, 1120, 840
"""Maximum number of frames of a slider; pixels of a frame's width, alone and beside another run."""
MOST_FRAME_BYTES = 3_000_000
"""Maximum bytes of all frames of a page; larger pages get fewer frames."""


@dataclass(frozen=True)
class Table:
    """A table: its lines, the first its head; whether the last line is a sum, and whether it is only text."""

    lines: list[list[str]]
    has_head: bool = True
    last_is_sum: bool = False
    is_text: bool = False

    @property
    def right(self) -> set[int]:
        """The right-aligned columns: those of numbers."""
        columns = () if self.is_text else enumerate(zip(*self.lines[self.has_head :], strict=True))
        return {c for c, texts in columns if all(text in ("", "-") or text[0].isdigit() for text in texts)}


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

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing below the title."""
        has_lines = any(len(table.lines) > table.has_head for table in self.tables)
        return not (has_lines or self.pictures or self.frames or self.texts)


def write_report(directory: Path, other: Path | None = None, out: Path | None = None) -> Path:
    """Draw the figures of a run and write its page, or a page that compares it with another run; return the page.

    With `out`, which names the page, nothing is written into `directory`.

    Raises ScenarioError if a directory is not a run directory, or a table is missing.
    """
    archive = read(directory)
    if other is None:
        with contextlib.ExitStack() as stack:
            pictures = stack.enter_context(temporary_folder()) if out else directory / run_directory.PICTURES
            figures = write_figures(archive, pictures)
            if (directory / run_directory.PICTURE).is_file():
                figures.append(directory / run_directory.PICTURE)
            text = page(archive, figures)
    else:
        text = comparison({directory: archive, other: read(other)})
    name = REPORT if other is None else f"compared-with-{other.resolve().name}.html"
    path = out or directory / name
    write_whole(path, lambda file: file.write(text.encode()))
    return path


def page(archive: Archive, figures: Sequence[Path]) -> str:
    """The page of a run, with all pictures embedded."""
    summary = archive.summary
    scenario = (archive.directory / run_directory.SCENARIO).read_text(encoding="utf-8")
    return _render(
        f"{counted(summary['robots'], 'robot')} {'in' if summary['range_m'] is None else 'on'} {summary['map']}",
        [report_rows.abstract(summary)],
        [
            Section("The run", [Table(report_rows.figure_rows(summary), has_head=False, is_text=True)]),
            Section("Step by step", frames=_frames([Frames(archive, FRAME_WIDTH)]), caption=FRAMES_CAPTION),
            Section("Pictures", pictures=[_picture(figure.read_bytes(), CAPTIONS[figure.name]) for figure in figures]),
            Section("The robots", [Table(robot_table(archive))], caption=CAPTION),
            Section("Walls on the robots' maps", [Table(report_rows.wall_rows(summary))], caption=WALLS_CAPTION),
            Section("Traffic", [
                Table(report_rows.kind_rows(summary), last_is_sum=True), Table(report_rows.undelivered_rows(summary)),
            ]),
            Section("The scenario", texts=[scenario]),
        ],
        {"": summary["digest"]} if archive.plan.has_truth else {},
    )  # fmt: skip


def comparison(runs: dict[Path, Archive]) -> str:
    """The page that compares runs, by their directories."""
    names = _names(list(runs))
    archives = list(runs.values())
    summaries = [archive.summary for archive in archives]
    named = dict(zip(names, archives, strict=True))
    file = io.BytesIO()
    compared(named).savefig(file, format="png", dpi=100)
    pictures = [_picture(file.getvalue(), "Explored area of each team over time, and its use of the radio.")]
    for name, archive in named.items():
        maps = archive.directory / run_directory.PICTURE
        if maps.is_file():
            pictures.append(_picture(maps.read_bytes(), f"{name}: {CAPTIONS[maps.name]}"))
    figures = [dict(report_rows.figure_rows(summary)) for summary in summaries]
    figure_names = dict.fromkeys(name for each in figures for name in each)
    rows = [[name, *(each.get(name, "-") for each in figures)] for name in figure_names]
    shown = [Frames(archive, PAIR_WIDTH) for archive in archives]
    differing = report_rows.differing_settings(archives)
    return _render(
        " and ".join(names),
        [f"{name}: {report_rows.abstract(summary)}" for name, summary in zip(names, summaries, strict=True)],
        [
            Section("The runs", [Table([["", *names], *rows], is_text=True)]),
            Section("Different settings", [Table([["", *names], *differing], is_text=True)]),
            Section("Step by step", frames=_frames(shown), caption=FRAMES_CAPTION),
            Section("Pictures", pictures=pictures),
            Section("Traffic", [Table(report_rows.traffic_rows(names, summaries), last_is_sum=True)]),
        ],
        {name: each.summary["digest"] for name, each in named.items() if each.plan.has_truth},
        wide=True,
    )


def _render(
    title: str, lead: list[str], sections: list[Section], digests: dict[str, str], *, wide: bool = False
) -> str:
    environment = Environment(
        loader=PackageLoader("deploy.after", "."), autoescape=True, trim_blocks=True, lstrip_blocks=True
    )
    template = environment.get_template("report.html.jinja")
    shown = [each for each in sections if not each.is_empty]
    return template.render(title=title, lead=lead, sections=shown, wide=wide, digests=digests)


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


def _picture(png: bytes, caption: str = "", step: int = 0) -> Picture:
    return Picture(f"data:image/png;base64,{base64.b64encode(png).decode()}", caption, step)
