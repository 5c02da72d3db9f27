"""Terminal output of a run: its progress, and its figures at the end."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, ProgressColumn, TaskID, TextColumn, TimeElapsedColumn
from rich.text import Text

from deploy.record.number_texts import counted, percent
from deploy.record.records import Records
from deploy.record.run_directory import LOGS, PICTURE, PICTURES
from deploy.record.summary import replayed
from deploy.scenario.plan import Plan

Watch = Callable[[Plan, Records], object]

KIND_LABELS = {
    "ins": "inserted corners", "rep": "replaced corners", "del": "deleted corners", "em": "new objects",
    "rm": "removed objects", "chg": "choices of an object",
    "conn": "replication control", "targ": "targets", "save": "ends of updates", "scan": "scans",
    "update": "map updates", "pose": "poses", "sum": "checksums",
}  # fmt: skip
"""Labels of packet kinds."""


WIDE = 80
"""Columns of a terminal that the whole progress line needs; narrower ones show only its figures."""

STANDSTILL = 50
"""Steps without a motion that are reported."""


class _ProgressWithMessage(Progress):
    def __init__(self, message: Callable[[], str], console: Console, *columns: ProgressColumn) -> None:
        self._message, self._terminal = message, console
        super().__init__(*columns, console=console, transient=True)

    def get_renderables(self) -> Iterator[RenderableType]:
        """The progress line, and the message if there is one."""
        yield self.make_tasks_table(self.tasks)
        if message := self._message():
            yield from Text(message, style="dim").wrap(self._terminal, self._terminal.width)


@contextlib.contextmanager
def progress(
    console: Console, *, shown: bool, message: Callable[[], str] = lambda: ""
) -> Iterator[Watch | None]:
    """A progress line, if `console` is a terminal: step, explored share, bytes of the budget, robots alive.

    `message` returns a line to print below it. The progress line starts with the first step, so that other output is
    possible before it, for example that kernels are compiled.
    """
    if not shown or not console.is_terminal:
        yield None
        return
    is_wide = console.width >= WIDE
    figures = ("{task.fields[medium]}", "{task.fields[alive]}")
    if is_wide:
        texts = ("step {task.fields[step]:>5}", "{task.percentage:>5.1f} % explored", *figures)
    else:
        texts = ("step {task.fields[step]}", "{task.percentage:.0f} %", *figures)
    step, *others = map(TextColumn, texts)
    columns = (step, BarColumn(), *others, TimeElapsedColumn()) if is_wide else (step, *others)
    bar = _ProgressWithMessage(message, console, *columns)
    task: TaskID = bar.add_task("explore", total=1.0, step=0, medium="", alive="")

    def watch(plan: Plan, records: Records) -> None:
        budgets = [plan.radio.budget, *(each.budget for each in records.changes if each.budget is not None)]
        of = "" if budgets[-1].unlimited else f" of {budgets[-1]}"
        alive = plan.scenario.robots - len(records.lost.keys() | records.killed)
        bar.update(
            task,
            completed=records.explored,
            step=records.step,
            medium=f"{records.carried}{of} B" + (" transmitted" if is_wide else ""),
            alive=counted(alive, "robot"),
        )
        if records.step:
            bar.start()

    try:
        yield watch
    finally:
        bar.stop()


def standstill(records: Records) -> str:
    """How many steps at the end of a run passed without a motion, and why; empty if they are few."""
    if not records.world or not all(records.statuses):
        return ""
    driven = records.world[-1].driven
    first = next(report.step for report in records.world if report.driven == driven)
    if records.step - first < STANDSTILL:
        return ""
    has_target = any(statuses[-1].target_x >= 0 for statuses in records.statuses)
    why = "none came closer to its target" if has_target else "none had a target"
    return f"no robot moved in the last {records.step - first} steps: {why}"


def summary_lines(summary: dict[str, Any], directory: Path | None, *, noisy: bool) -> list[str]:
    """The figures of a run as lines of text; with `noisy` sensors, also how well the walls on its maps fit."""
    lines = []
    if "scans" in summary:
        lines.append(replayed(summary))
    elif summary["finished"]:
        by = " by all robots" if summary["finish"] == "all" else ""
        lines.append(
            f"Explored in {counted(summary['steps'], 'step')}{by}; robot {summary['first_robot']} finished first."
        )
    else:
        lines.append(f"Not finished after {counted(summary['steps'], 'step')}: {summary['reason']}.")
    area = "map of all scans" if "scans" in summary else "reachable area"
    lines.append(f"The team saw {_percent(summary['coverage'])} of the {area}.")
    lines += _accuracy_line(summary)
    if noisy:
        lines += _wall_line(summary)
    total = summary["bytes"]["total"]
    kinds = [(kind, size) for kind, size in summary["bytes"].items() if kind != "total"]
    shares = ", ".join(
        f"{KIND_LABELS.get(kind, kind)} {100 * size / total:.1f} %" for kind, size in kinds if size
    )
    lines.append(f"Transmitted: {total:,} B" + (f" ({shares})." if shares else "."))
    if summary["clock"] == "wall":
        lines.append(_missed_line(summary))
    lines.append(f"{summary['wall_s']:.1f} s, {summary['steps_per_s']} steps/s on the {summary['bus']} bus.")
    if directory is not None:
        shown = [str(directory / name) for name in (PICTURE, PICTURES) if (directory / name).exists()]
        lines.append(f"Results: {directory}" + (f" (pictures: {', '.join(shown)})" if shown else ""))
        if (directory / LOGS).exists():
            lines.append(f"Output of the processes: {directory / LOGS}")
    return lines


def _accuracy_line(summary: dict[str, Any]) -> list[str]:
    """How much of the area is right on the robots' maps: mean, worst robot, and the first to finish.

    The map of all scans of a recorded run may be wrong itself.
    """
    name = "Map accuracy, relative to that map" if "scans" in summary else "Map accuracy"
    accuracies = {robot: each["map_accuracy"] for robot, each in summary["robot_maps"].items()}
    if not accuracies:
        return []
    worst = min(accuracies, key=accuracies.__getitem__)
    least = _percent(accuracies[worst])
    if accuracies[worst] == max(accuracies.values()):
        return [f"{name}: {least}{' on each robot' if len(accuracies) > 1 else ''}."]
    text = f"{name}: mean {_percent(summary['mean_map_accuracy'])}, worst {least} (robot {worst})"
    first = summary["first_robot"]
    if first is not None and summary["map_accuracy"] is not None:
        text += f", first to finish {_percent(summary['map_accuracy'])} (robot {first})"
    return [f"{text}."]


def _missed_line(summary: dict[str, Any]) -> str:
    by_robot = {robot: steps for robot, steps in enumerate(summary["missed_steps_by_robot"]) if steps}
    steps = ", ".join(f"robot {robot}: {steps}" for robot, steps in by_robot.items())
    return (
        f"Steps of {1000 * summary['step_s']:g} ms; missed steps: {summary['missed_steps']}"
        + (f" ({steps})" if steps else "")
        + f", missed phases of the radio: {summary['missed_phases']}."
    )


def _wall_line(summary: dict[str, Any]) -> list[str]:
    """How well the walls on the robots' maps fit the true ones and each other, as far as either is known."""
    parts = []
    if (f1 := summary["claimed_mean_wall_f1"]) is not None:
        worst = _percent(summary["claimed_worst_wall_f1"])
        which = "those of that map" if "scans" in summary else "the true ones"
        parts.append(f"F1 {_percent(f1)} within one cell of {which} (worst robot {worst})")
    if (held := summary["walls_within_tolerance"]) is not None:
        cells, worst = summary["tolerance"], _percent(summary["worst_walls_within_tolerance"])
        within = f"within {counted(cells, 'cell')}"
        parts.append(f"agreement {_percent(held)} {within} (worst pair {worst})")
    return [f"Walls: {'; '.join(parts)}."] if parts else []


def _percent(share: float) -> str:
    return percent(share, 2)
