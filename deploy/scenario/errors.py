"""Errors of settings that users give: the key, its value, and the valid values, a line per error."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import ValidationError

from protocol.errors import shown, there_are


class ScenarioError(ValueError):
    """An invalid scenario. The message has one line per error: the key, its value and the valid values."""


def explained(error: ValidationError, keys: Mapping[str, Iterable[str]]) -> ScenarioError:
    """Return one of pydantic's exceptions as a ScenarioError; `keys` are the known ones, by table."""
    errors = [item for item in error.errors() if item["type"] != "default_factory_not_called"]
    return ScenarioError("\n".join(dict.fromkeys(explain(item, keys) for item in errors)))


def explain(item: Any, keys: Mapping[str, Iterable[str]]) -> str:
    """Return one of pydantic's errors as a line: the key, its value and the valid values, of `keys` by table."""
    key = ".".join(str(part) for part in item["loc"] if str(part) not in _KINDS)
    message = str(item["msg"]).removeprefix("Value error, ")
    for theirs, ours in _WORDING.items():
        message = message.replace(theirs, ours)
    message = re.sub(r"a dictionary or an instance of \w+", "a table", message)
    if item["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        table = ".".join(str(part) for part in item["loc"][:-1] if isinstance(part, str))
        return f"{key}: unknown setting; {there_are(keys[table], str(item['loc'][-1]))}"
    if item["type"] == "missing":
        return f"{key} is missing"
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
}
"""Phrases of pydantic's messages, and our replacements."""

_KINDS = ("int", "tuple", "tuple[int, ...]", "literal['unlimited']")
"""Parts of pydantic's locations that name an alternative of a value's type."""
