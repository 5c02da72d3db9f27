"""`murmur new`: templates of plug-ins, each with a test that passes."""

from __future__ import annotations

import keyword
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from string import Template
from typing import Annotated

from deploy.commands.console import screen
from deploy.commands.flags import argument, command_family, subcommands
from deploy.scenario.plugins import kinds

app = command_family()
new_app = subcommands(app, "new", "Write a template of new code, with its test.")

NameArgument = Annotated[str, argument("NAME", "its name, as farthest or my-way")]


@new_app.command("strategy")
def new_strategy(name: NameArgument) -> None:
    """Write a strategy and its test into the current folder: one class to change."""
    _write("strategy", name, "--strategy {part}", "strategy")


@new_app.command("encoding")
def new_encoding(name: NameArgument) -> None:
    """Write a map encoding and its test into the current folder: one class to change."""
    _write("encoding", name, "--map-encoding {part}", "map_encoding")


@new_app.command("radio")
def new_radio(name: NameArgument) -> None:
    """Write a radio, its figures and its connectivity, and its test into the current folder."""
    flags = "--radio {module}:PRESET --set radio.model={part}"
    _write("radio", name, flags, "radio.model", "radio.preset")


def _write(template: str, name: str, flags: str, *settings: str) -> None:
    """Write a template and its test into the current folder; print how to run them with `flags`.

    Raises ValueError if the name is invalid, or a part that one of the `settings` can name has it.
    """
    module = name.replace("-", "_")
    if not module.isidentifier() or keyword.iskeyword(module) or not module.islower():
        raise ValueError(f"name = {name!r}: must be lower-case letters, digits and hyphens, as my-way")
    for setting in settings:
        kinds()[setting].check_new(name)
    file, test = Path(f"{module}.py"), Path(f"test_{module}.py")
    if not file.exists() and find_spec(module) is not None:
        raise ValueError(
            f"name = {name!r}: would hide the Python module of this name; choose another name, as my-{name}"
        )
    for path in (file, test):
        if path.exists():
            raise ValueError(f"{path}: already exists; choose another name")
    kind = "".join(part.capitalize() for part in module.split("_"))
    for path, source in ((file, f"{template}.py.txt"), (test, f"test_{template}.py.txt")):
        text = (files("deploy.commands") / "templates" / source).read_text(encoding="utf-8")
        filled = Template(text).substitute(
            name=name, module=module, kind=kind, title=name.replace("-", " "), test=test
        )
        path.write_text(filled, encoding="utf-8")
    screen.print(f"{file}: the {template}; {test}: its test")
    screen.print(f"run:  murmur explore {flags.format(module=module, part=f'{module}:{kind}')}")
    screen.print(f"test: python -m pytest {test}")
