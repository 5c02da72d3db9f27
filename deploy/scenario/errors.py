"""Errors of settings that users give: the key, its value, and the valid values, a line per error."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from typing import Any, get_args, get_type_hints

from pydantic import BaseModel, ValidationError

from protocol.errors import shown, there_are


class ScenarioError(ValueError):
    """An invalid scenario. The message has one line per error: the key, its value and the valid values."""

    def within(self, where: str) -> ScenarioError:
        """Return the error with `where` at the beginning of each line."""
        return ScenarioError("\n".join(f"{where}: {line}" for line in str(self).splitlines()))


def explained(error: ValidationError, kind: type[BaseModel]) -> ScenarioError:
    """Return one of pydantic's exceptions, raised for settings of this kind, as a ScenarioError."""
    keys = keys_of(kind)
    errors = [item for item in error.errors() if item["type"] != "default_factory_not_called"]
    return ScenarioError("\n".join(dict.fromkeys(_line(item, keys) for item in errors)))


@cache
def keys_of(kind: Any) -> dict[str, list[str]]:
    """Return the valid keys of each table of settings, which are a model or a dataclass.

    The name of a table is the keys that lead to it, as ``robot.laser``; that of the settings themselves is empty.
    """
    hints = get_type_hints(kind) if is_dataclass(kind) else {}
    names = [field.name for field in fields(kind)] if is_dataclass(kind) else list(kind.model_fields)
    found = {"": names}
    for name in names:
        for inner in _tables_in(hints[name] if hints else kind.model_fields[name].annotation):
            found |= {f"{name}.{table}".rstrip("."): keys for table, keys in keys_of(inner).items()}
    return found


def _tables_in(hint: Any) -> Iterator[Any]:
    """Yield the models and dataclasses in a type, as in an optional one or in that of a list."""
    if isinstance(hint, type) and (is_dataclass(hint) or issubclass(hint, BaseModel)):
        yield hint
    for part in get_args(hint):
        yield from _tables_in(part)


def _line(item: Any, keys: Mapping[str, list[str]]) -> str:
    """Return one of pydantic's errors as a line: the key, its value and the valid values, of `keys` by table."""
    key = ".".join(str(part) for part in item["loc"] if str(part) not in _KINDS)
    message = str(item["msg"]).removeprefix("Value error, ")
    for theirs, ours in _WORDING.items():
        message = message.replace(theirs, ours)
    path = [part for part in item["loc"] if isinstance(part, str)]
    known = keys.get(".".join(path), [])
    wanted = f"a table of {', '.join(known)}" if known else "a table"
    message = re.sub(r"a (dictionary|table) or (an )?instance of \w+", wanted, message)
    if item["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"{key}: unknown setting; {there_are(keys['.'.join(path[:-1])], path[-1])}"
    if item["type"] == "missing":
        return f"{key} is missing"
    if item["type"] == "value_error" and isinstance(item["input"], Mapping) and known and path:
        named = re.match(r"(\w+)(?: =|:) ", message)
        if named and named[1] in known:
            return f"{key}.{message}"
        if not message.startswith("must be "):  # it concerns keys of the table, not its type
            return f"{key}: {message}"
    return f"{key} = {shown(item['input'])}: {message}" if key else message


_WORDING = {
    "Input should be": "must be",
    "a valid integer": "a whole number",
    "a valid number": "a number",
    "a valid string": "text",
    ", unable to parse string as an integer": "",
    "a valid dictionary": "a table",
    "a valid tuple": "a list",
    "a valid list": "a list",
    "a valid boolean": "true or false",
    "List should have at least 1 item after validation, not 0": "must have at least one entry",
    "String should have at least 1 character": "must not be empty",
}
"""Phrases of pydantic's messages, and our replacements."""

_KINDS = ("int", "tuple", "tuple[int, ...]", "literal['unlimited']")
"""Parts of pydantic's locations that name an alternative of a value's type."""
