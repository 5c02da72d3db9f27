"""Tables in docs that follow from code: settings, settings of hosts, presets of radios, lasers, and poses.

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
from protocol.presets import PRESETS
from worldsim.people_options import PeopleOptions
from worldsim.recorded.options import RecordingOptions
from worldsim.sensor_options import LASERS, POSES, LaserOptions, PoseOptions

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


def radios() -> Iterator[tuple[str, ...]]:
    """Yield the row of each radio preset."""
    for name, preset in PRESETS.items():
        assert preset.link is not None
        yield (
            f"`{name}`", preset.description, f"{preset.bits_per_s:,}", f"{preset.bandwidth:,}", f"{preset.frame_bytes}",
            f"{1000 * preset.frame_s:.1f}", ", ".join(str(preset.link.range_m(walls)) for walls in (0, 2, 4)),
            f"{preset.link.db_per_wall:g}",
            f"{100 * preset.limit.duty_cycle:g} %" if preset.limit.duty_cycle < 1 else "none",
        )  # fmt: skip


def lasers() -> Iterator[tuple[str, ...]]:
    """Yield the row of each laser."""
    for name, keys in LASERS.items():
        laser = LaserOptions(**{key: value for key, value in keys.items() if key != "field_of_view"})
        share = f" + {100 * laser.range_error_share:g} %" if laser.range_error_share else ""
        yield (
            f"`{name}`", f"{1000 * laser.range_error_m:g} mm{share}" if keys else "none",
            f"{laser.short:g}", f"{laser.missing:g}", f"{laser.mixed:g}",
            f"{laser.min_range_m:g} to {laser.max_range_m:g}" if keys else "-",
            f"{laser.beams}, {keys['field_of_view']:g} degrees" if keys else "`beams`, `field_of_view`",
        )  # fmt: skip


def poses() -> Iterator[tuple[str, ...]]:
    """Yield the row of each localization method."""
    for name, keys in POSES.items():
        pose = PoseOptions(**keys)
        position, heading = f"{100 * pose.position_error_m:g} cm", f"{pose.heading_error_deg:g} degrees"
        yield f"`{name}`", position if keys else "0", heading if keys else "0"


def pages() -> dict[Path, str]:
    """Return the pages with tables from code, each with the text that it should have."""
    found: dict[Path, str] = {}
    for name, head, rows in (
        ("settings.md", "| setting | default |", _coded(settings())),
        ("hosts.md", "| setting | default |", _coded(host_settings())),
        ("radios.md", "| name | radio |", radios()),
        ("real-sensors.md", "| name | range error |", lasers()),
        ("real-sensors.md", "| name | position, ", poses()),
    ):
        page = DOCS / name
        found[page] = _updated(found.get(page) or page.read_text(encoding="utf-8"), head, rows)
    return found


def main() -> None:
    """Rewrite the tables in the pages."""
    for page, text in pages().items():
        page.write_text(text, encoding="utf-8")


def _updated(page: str, head: str, rows: Iterable[tuple[str, ...]]) -> str:
    """Return the page with other rows in the table whose first line begins with `head`."""
    table = "".join(f"| {' | '.join(row)} |\n" for row in rows)
    pattern = rf"^({re.escape(head)}.*\n\|[-|]*\n)(\|.*\n)*"
    text, count = re.subn(pattern, lambda match: match[1] + table, page, flags=re.M)
    assert count == 1, f"{count} tables begin with {head}"
    return text


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
