"""Tables in docs that follow from code: settings and settings of hosts.

Run ``python -m docs.code_tables`` after a change; `tests/deploy/test_docs.py` compares pages and code.
"""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterable, Iterator
from dataclasses import fields
from itertools import pairwise
from pathlib import Path
from typing import Any

from agent.encoding_options import THESIS_OPTIONS, PolygonOptions, PredictiveOptions
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
    "polygons": PolygonOptions(),
    "predictive": PredictiveOptions(),
    "radio": RadioOptions(),
    "laser": LaserOptions(),
    "pose": PoseOptions(),
    "people": PeopleOptions(),
    "recording": RecordingOptions(),
}
"""Tables of a scenario that are dataclasses, with their defaults."""

LINKS = {
    "laser.preset": "real-sensors.md#lasers",
    "pose.preset": "real-sensors.md#poses",
    "people.number": "real-sensors.md#people",
    "recording.files": "recorded.md",
    "radio.preset": "radios.md#radios-by-name",
    "radio.model": "plugins.md",
}
"""Pages with more on a setting."""

LISTS = {"robot": RobotOverride, "fault": FaultTable, "change": ChangeTable}
"""Settings that are lists of tables; the table lists their fields after all others."""


def plain(value: object) -> str:
    """Return a default as TOML; ``-`` for none."""
    if value is None:
        return "-"
    if isinstance(value, bool):
        return str(value).lower()
    if value == ():
        return "[]"
    return f'"{value}"' if isinstance(value, str) else str(value)


def settings() -> Iterator[tuple[str, str, str]]:
    """Yield name, default and meaning of each setting of a scenario."""
    for name, default, meaning in _fields(Scenario, ""):
        if name in OPTIONS:
            yield from _options(name, OPTIONS[name])
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


def _options(table: str, options: Any) -> Iterator[tuple[str, str, str]]:
    """Yield name, default and meaning of each field of a dataclass, as the first sentence of its docstring says it."""
    texts = _docstrings(type(options))
    for field in fields(options):
        meaning = re.split(r"\.(?: (?=[A-Z`])|$)", texts[field.name])[0].replace("``", "`")
        meaning = re.sub(r" \(`[A-Z]+`\)| \(`\w+\.\w+`\)", "", meaning)
        default = plain(getattr(options, field.name))
        if table == "polygons" and (thesis := plain(getattr(THESIS_OPTIONS, field.name))) != default:
            meaning += f"; thesis: {thesis}"
        name = f"{table}.{field.name}"
        more = f" ([more]({LINKS[name]}))" if name in LINKS else ""
        yield name, default, meaning[0].lower() + meaning[1:] + more


def _docstrings(kind: type) -> dict[str, str]:
    """Return the docstring of each field of a dataclass and its bases, on one line."""
    found = {}
    for each in kind.__mro__[:-1]:
        (definition,) = ast.parse(inspect.getsource(each)).body
        assert isinstance(definition, ast.ClassDef)
        for field, text in pairwise(definition.body):
            if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr):
                found[ast.unparse(field.target)] = " ".join(ast.literal_eval(text.value).split())
    return found


def _coded(rows: Iterable[tuple[str, str, str]]) -> Iterator[tuple[str, ...]]:
    for name, default, meaning in rows:
        yield f"`{name}`", default if default in ("required", "-") else f"`{default}`", meaning


if __name__ == "__main__":
    main()
