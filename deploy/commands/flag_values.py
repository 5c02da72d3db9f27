"""Parse the values of flags: lists, positions, durations, and settings as NAME=VALUE."""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Sequence
from typing import Any

from protocol.errors import shown


def items(text: str) -> list[str]:
    """The items of a comma-separated list, which may be empty."""
    return [item.strip() for item in text.split(",") if item.strip()]


def names(text: str | None, flag: str, default: Sequence[str]) -> list[str]:
    """The items of a flag, or its default without the flag; ValueError if the flag names none."""
    if text is None:
        return list(default)
    found = items(text)
    if not found:
        raise ValueError(f"{flag} = {text!r}: is empty; give values separated by commas, or omit --{flag}")
    return found


def whole_numbers(text: str, flag: str, most: int) -> list[int]:
    """Parse ``2..8`` or ``2,4,8``; ValueError if it is neither, or a number exceeds `most`."""
    first, dots, last = text.partition("..")
    try:
        numbers: Sequence[int] = (
            range(int(first), int(last) + 1) if dots else [int(item) for item in items(text)]
        )
    except ValueError:
        numbers = []
    if not numbers or max(numbers[0], numbers[-1]) > most:
        raise ValueError(f"{flag} = {text!r}: must be whole numbers of at most {most}, as 2..8 or 2,4,8")
    return list(numbers)


def position(text: str, flag: str = "start") -> tuple[float, float]:
    """Parse a position, X,Y in meters; ValueError if it is malformed."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        raise ValueError(f"{flag} = {text!r}: must be two numbers in meters, as 3.5,12") from None
    return x, y


def duration_s(text: str) -> float:
    """Parse a duration, as 200ms or 1.5s, in seconds; ValueError if it is malformed."""
    parts = re.fullmatch(r"([0-9]*\.?[0-9]+) ?(ms|s)", text.strip())
    if parts is None:
        raise ValueError(f"step = {text!r}: must be a duration, as 200ms or 1.5s")
    return float(parts[1]) / 1000 if parts[2] == "ms" else float(parts[1])


def named_values(texts: list[str], flag: str, example: str) -> dict[str, Any]:
    """Parse NAME=VALUE texts of a flag; ValueError if a text is malformed.

    Values are read as JSON, lists and tables also as TOML, and all others as text.
    """
    values: dict[str, Any] = {}
    for text in texts:
        name, sign, value = text.partition("=")
        if not sign or not name:
            raise ValueError(f"{flag} = {text!r}: must be NAME=VALUE, as {example}")
        if name in values:
            raise ValueError(f"{flag} = {text!r}: {name} is given twice")
        try:
            values[name] = json.loads(value)
            _visit(values[name])
        except RecursionError:
            raise ValueError(f"{flag} = '{name}=...': nested too deeply") from None
        except ValueError:
            is_nested = value.lstrip()[:1] in {"[", "{"}
            values[name] = _toml_value(value, f"{flag} = '{name}=...'") if is_nested else value
    return values


def _visit(value: Any) -> None:
    """Visit all parts of a value; RecursionError if it is nested too deeply, which JSON accepts since Python 3.12."""
    for each in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        _visit(each)


def _toml_value(text: str, where: str) -> Any:
    """Read a list or table in TOML; ValueError if it is malformed, with `where` it stands."""
    try:
        read = tomllib.loads(f"value = {text}")
    except RecursionError:
        raise ValueError(f"{where}: nested too deeply") from None
    except tomllib.TOMLDecodeError as error:
        raise ValueError(
            f"{where}: {shown(text)} is no list or table, neither in TOML nor in JSON: {error}"
        ) from None
    if len(read) > 1:
        raise ValueError(f"{where}: {shown(text)} has more than one value")
    return read["value"]
