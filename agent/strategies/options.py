"""Options of strategies: dataclasses whose fields have a line of help and are checked when a scenario is read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, make_dataclass
from typing import Any, TypeVar

Options = TypeVar("Options")

_WORDING = {bool: "true or false", int: "a whole number", float: "a number", str: "text"}
"""Types of options, as errors name them."""


def option(default: Any, help_line: str, choices: Iterable[str] = (), *, least: float | None = None) -> Any:
    """Declare a field of an options dataclass: default, help line, allowed texts, smallest number."""
    return field(default=default, metadata={"help": help_line, "choices": tuple(choices), "least": least})


def with_defaults(kind: type, **defaults: Any) -> type:
    """Return an options dataclass like `kind`, but with other defaults of some options."""
    changed = [
        (item.name, item.type, field(default=defaults[item.name], metadata=item.metadata))
        for item in fields(kind)
        if item.name in defaults
    ]
    return make_dataclass(kind.__name__, changed, bases=(kind,), frozen=True)


@dataclass(frozen=True)
class OptionLine:
    """Description of an option."""

    name: str
    default: Any
    help: str
    choices: tuple[str, ...]
    least: float | None


def option_lines(kind: type) -> list[OptionLine]:
    """Return the options that a dataclass declares, in its order."""
    return [OptionLine(item.name, item.default, **item.metadata) for item in fields(kind)]


def read_options(
    kind: type[Options], options: Mapping[str, Any], owner: str, refused: Mapping[str, str]
) -> Options:
    """Make an options dataclass, of fields made by `option`, from values by name.

    `owner` names the strategy in errors; `refused` has options of other strategies that do not apply, with the reasons.
    ValueError: an option is unknown, does not apply, has the wrong type, or has a value that is not allowed.
    """
    known = {line.name: line for line in option_lines(kind)}
    for name, value in options.items():
        if name in refused:
            raise ValueError(f"{owner} takes no option {name!r}: {refused[name]}")
        if name not in known:
            there_are = ", ".join(known) or "none"
            raise ValueError(f"{owner} has no option {name!r}; there are: {there_are}")
        wanted = type(known[name].default)
        if type(value) is not wanted and not (wanted is float and type(value) is int):
            raise ValueError(f"option {name} of {owner} must be {_WORDING[wanted]}, not {value!r}")
        choices = known[name].choices
        if choices and value not in choices:
            raise ValueError(f"option {name} of {owner} is one of {', '.join(choices)}; not {value!r}")
        least = known[name].least
        if least is not None and not value >= least:
            raise ValueError(f"option {name} of {owner} must be {least:g} or more, not {value:g}")
    return kind(**options)
