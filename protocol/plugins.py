"""Plug-ins: strategies, map encodings, disseminations, radio models, and radio presets, found by name.

A scenario names one in three ways, and `Plugins.find` returns it on each host and in each process:

    name          example              what
    built-in      meier                a part of this package
    entry point   farthest             a part of an installed package, under the name that the package declares
    module:Name   farthest:Farthest    a part of any module in the current folder or on PYTHONPATH

A package declares its parts as entry points::

    [project.entry-points."murmur.strategies"]
    farthest = "our_package.farthest:Farthest"
"""

from __future__ import annotations

import contextlib
import importlib.util
import inspect
import site
import sys
import sysconfig
import traceback
from collections.abc import Iterator, Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

from protocol.errors import shown, there_are

Part = TypeVar("Part")

MAX_NAME = 60
"""Most characters of the name of a file with a plug-in: file systems allow 255 bytes, characters take up to 4."""

MAIN = "__main__"
"""The module of a script or notebook. Other processes cannot import it."""


class PluginError(TypeError, ValueError):
    """A plug-in returned a wrong value; the message names the plug-in and the value."""


@dataclass(frozen=True)
class Plugins(Generic[Part]):
    """All parts of one kind that a scenario can name."""

    kind: str
    """The kind, for error messages: ``strategy``."""
    group: str
    """The group of entry points."""
    base: type[Any]
    """The base class of the parts, which define a ``name``; of parts that are no classes, their class."""
    built_in: Mapping[str, Part]
    """The parts of this package, by name."""
    stand_in: Any
    """The stand-in that `find` returns for a part outside this package, inside `without_import`."""
    unlisted: frozenset[str] = frozenset()
    """Built-in names that error messages do not suggest."""
    are_classes: bool = True
    """Whether the parts are classes."""

    def find(self, name: str) -> Part:
        """Return the part with this name: built in, installed, or given as ``package.module:Name``.

        ValueError: the name is unknown (the message lists similar names), or the part cannot be imported.
        """
        if name in self.built_in:
            return self.built_in[name]
        if not _may_import.get():
            return cast("Part", self.stand_in)
        if ":" in name:
            return self._imported(name)
        installed = self.installed()
        if name not in installed:
            module = Path(name.replace("-", "_")).stem[:MAX_NAME]
            if name.endswith(".py") or Path(f"{module}.py").is_file():
                raise ValueError(
                    f"{module}.py is a file: give the {self.kind} in it as {module}:{self._example}, from its folder"
                )
            listed = [each for each in (*self.built_in, *installed) if each not in self.unlisted]
            raise ValueError(
                f"no {self.kind} is called {shown(name)}; {there_are(listed, name)}; or give one "
                f"as package.module:{self._example}"
            )
        return self.load(installed[name])

    def name_of(self, part: object) -> str:
        """Return the name under which `find` returns a class: its own if it is built in, else ``package.module:Class``.

        ValueError: it is no class of this kind, or not at the top level of a module.
        """
        where = f"{self.kind} {shown(part)}"
        checked: Any = self._checked(part, where, "it")
        own = str(checked.name)
        if self.built_in.get(own) is checked:
            return own
        name = f"{checked.__module__}:{checked.__qualname__}"
        if getattr(sys.modules.get(checked.__module__), checked.__qualname__, None) is not checked:
            raise ValueError(
                f"{where}: must be defined at the top level of a module, a script, or a notebook, under its own name"
            )
        return name

    def check_new(self, name: str) -> None:
        """Raise ValueError if a new part cannot have this name because another one has it."""
        if name in self.built_in:
            raise ValueError(
                f"name = {name!r}: a built-in {self.kind} has this name; choose another, as my-{name}"
            )
        if name in self.installed():
            raise ValueError(
                f"name = {name!r}: the {self.kind} of package {package(self.installed()[name])} has this name; "
                f"choose another, as my-{name}"
            )

    def installed(self) -> dict[str, EntryPoint]:
        """Return the entry points of installed packages, by name; ValueError if a name is taken twice."""
        found: dict[str, EntryPoint] = {}
        for each in sorted(_entry_points(self.group), key=lambda each: each.name):
            if each.name in self.built_in:
                raise ValueError(
                    f"package {package(each)} has a {self.kind} called {each.name!r}, which is built in: uninstall it"
                )
            other = found.setdefault(each.name, each)
            if other.value != each.value:
                raise ValueError(
                    f"two packages have a {self.kind} called {each.name!r}, {package(other)} and {package(each)}: "
                    "uninstall one of them"
                )
        return found

    def local_code(self, name: str) -> str:
        """Return the module and the place of a part outside the installed packages, else an empty text.

        Nothing is imported.
        """
        point = None if name in self.built_in else self.installed().get(name)
        if name in self.built_in or (point is None and ":" not in name):
            return ""
        if point is not None and point.dist is not None and _is_installed(str(point.dist.locate_file(""))):
            return ""
        _import_from_here()
        module = (point.value if point is not None else name).partition(":")[0]
        try:
            spec = importlib.util.find_spec(module.partition(".")[0])
        except ValueError:
            return f"module {module}"
        places = [] if spec is None else [*(spec.submodule_search_locations or ()), spec.origin or ""]
        outside = [place for place in places if place and not _is_installed(place)]
        return f"module {module} ({outside[-1]})" if outside else ""

    def source(self, name: str) -> str:
        """Return the source of the module that has a plug-in; empty for a built-in part. ValueError as `find`."""
        if name in self.built_in:
            return ""
        self.find(name)
        value = name if ":" in name else self.installed()[name].value
        return inspect.getsource(sys.modules[value.partition(":")[0]])

    def load(self, point: EntryPoint) -> Part:
        """Import the part of an entry point; ValueError if the import fails, or it is not of this kind."""
        where = f"{self.kind} {point.name!r} of package {package(point)}"
        try:
            loaded = point.load()
        except (Exception, SystemExit):
            raise _import_failed(where) from None
        checked = self._checked(loaded, where, point.value)
        own: Any = getattr(checked, "name", point.name)
        if own != point.name:
            raise ValueError(
                f"{where}: {point.value} has the name {own!r}; the entry point must have the same name"
            )
        return checked

    @property
    def _example(self) -> str:
        return "Class" if self.are_classes else "NAME"

    def _imported(self, name: str) -> Part:
        module_name, _, part_name = name.partition(":")
        where = f"{self.kind} {name!r}"
        if not module_name or not part_name:
            raise ValueError(f"{where}: must be package.module:{self._example}")
        if module_name.endswith(".py"):
            raise ValueError(f"{where}: give the module without .py, as {Path(module_name).stem}:{part_name}")
        _import_from_here()
        try:
            module = importlib.import_module(module_name)
        except (Exception, SystemExit) as error:
            missing = error.name if isinstance(error, ModuleNotFoundError) else None
            if missing is None or not f"{module_name}.".startswith(f"{missing}."):
                raise _import_failed(where) from None
            raise ValueError(
                f"{where}: {error}; modules are imported from this folder and from PYTHONPATH"
            ) from None
        if not hasattr(module, part_name):
            if module_name == MAIN:
                raise ValueError(f"{where}: exists only in the script or notebook that defines it")
            there = [each for each, loaded in vars(module).items() if not self._mistake(loaded)]
            others = there_are(there, part_name) if there else f"no {self.kind} is in {module}"
            raise ValueError(f"{where}: {module_name} has no {part_name}; {others}")
        part = self._checked(getattr(module, part_name), where, part_name)
        self._check_name(part, name, where)
        return part

    def _check_name(self, part: Part, name: str, where: str) -> None:
        """Raise ValueError if a part given as ``module:Class`` has the name of another part."""
        own = getattr(part, "name", "")
        if own in self.built_in and self.built_in[own] is not part:
            raise ValueError(
                f"{where}: has the name {own!r} of a built-in {self.kind}; give it another one, as name = 'my-{own}'"
            )
        point = self.installed().get(own)
        if point is not None and point.value != name:
            raise ValueError(
                f"{where}: has the name {own!r} of the {self.kind} of package {package(point)}; give it another one"
            )

    def _mistake(self, loaded: object) -> str:
        """Return why an object is no part of this kind; empty if it is one."""
        base = f"{self.base.__module__}.{self.base.__name__}"
        if not self.are_classes:
            return "" if isinstance(loaded, self.base) else f"is not a {base}"
        if not (isinstance(loaded, type) and issubclass(loaded, self.base) and "name" in vars(loaded)):
            return f"is not a subclass of {base} with a name"
        members = inspect.getmembers(loaded)
        lacks = [name for name, each in members if getattr(each, "__isabstractmethod__", False)]
        return f"does not define the abstract methods {', '.join(lacks)}" if lacks else ""

    def _checked(self, loaded: object, where: str, named: str) -> Part:
        mistake = self._mistake(loaded)
        if mistake:
            raise ValueError(f"{where}: {named} {mistake}")
        return cast("Part", loaded)


_may_import: ContextVar[bool] = ContextVar("may_import", default=True)


@contextlib.contextmanager
def without_import() -> Iterator[None]:
    """Import no code of other packages: a scenario that has run is read, but not run again."""
    before = _may_import.set(False)
    try:
        yield
    finally:
        _may_import.reset(before)


def _import_from_here() -> None:
    """Let imports find modules of the current folder, last: a local file must not hide a module of this package."""
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)


def _is_installed(place: str) -> bool:
    """Return whether a file or folder belongs to this package, or to Python or its installed packages."""
    names = ("stdlib", "platstdlib", "purelib", "platlib")
    folders = [
        *(sysconfig.get_path(name) for name in names),
        *site.getsitepackages(),
        site.getusersitepackages(),
        *(str(Path(__file__).parents[1] / name) for name in PACKAGES),
    ]
    path = Path(place).resolve()
    return any(path.is_relative_to(Path(folder).resolve()) for folder in folders)


PACKAGES = ("agent", "deploy", "netshaper", "protocol", "worldsim")
"""The packages of this project that a run consists of; scenarios may name parts of them."""


def package(point: EntryPoint) -> str:
    """Return the name of the distribution of an entry point."""
    return point.dist.name if point.dist is not None else "?"


@cache
def _entry_points(group: str) -> tuple[EntryPoint, ...]:
    return tuple(entry_points(group=group))


def _import_failed(where: str) -> ValueError:
    """Return the error for foreign code that raised anything, with the traceback below the import system's frames."""
    kind, error, frames = sys.exc_info()
    while frames is not None and (
        frames.tb_frame.f_code.co_filename == __file__ or "importlib" in frames.tb_frame.f_code.co_filename
    ):
        frames = frames.tb_next
    text = "".join(traceback.format_exception(kind, error, frames)).rstrip()
    return ValueError(f"{where} cannot be imported:\n{text}")
