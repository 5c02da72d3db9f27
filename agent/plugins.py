"""Strategies and map encodings of other packages: entry points, or classes given as ``package.module:Class``.

A package registers its classes under the names that scenarios use::

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

Base = TypeVar("Base")

MAX_NAME = 200
"""Maximum length of the name of a file with a plugin."""


@dataclass(frozen=True)
class Plugins(Generic[Base]):
    """All classes of one kind that a scenario can name."""

    kind: str
    """The kind, for error messages: ``strategy``."""
    group: str
    """The group of entry points."""
    base: type[Base]
    """The base class; each subclass defines a ``name``."""
    stand_in: type[Base]
    """The class that `find` returns instead of one outside this package, inside `without_import`."""

    def find(self, name: str, known: Mapping[str, type[Base]]) -> type[Base]:
        """Return the class with this name: a `known` or an installed one, or ``package.module:Class``.

        ValueError: the name is unknown (the message lists similar names), or the class cannot be imported.
        """
        if name in known:
            return known[name]
        if not _may_import.get():
            return self.stand_in
        if ":" in name:
            return self._imported(name)
        installed = self.installed()
        if name not in installed:
            module = Path(name.replace("-", "_")).stem[:MAX_NAME]
            if name.endswith(".py") or Path(f"{module}.py").is_file():
                raise ValueError(
                    f"{module}.py is a file: give the {self.kind} in it as {module}:Class, from its folder"
                )
            raise ValueError(
                f"no {self.kind} is called {shown(name)}; {there_are([*known, *installed], name)}; or give one as "
                "package.module:Class"
            )
        return self.load(installed[name])

    def installed(self) -> dict[str, EntryPoint]:
        """Return the entry points of installed packages, by name; ValueError if two packages register the same name."""
        found: dict[str, EntryPoint] = {}
        for each in sorted(_entry_points(self.group), key=lambda each: each.name):
            other = found.setdefault(each.name, each)
            if other.value != each.value:
                raise ValueError(
                    f"two packages have a {self.kind} called {each.name!r}, {package(other)} and {package(each)}: "
                    "uninstall one of them"
                )
        return found

    def local_code(self, name: str, known: Mapping[str, type[Base]]) -> str:
        """Return the module and the place of a class outside the installed packages, else an empty text.

        Nothing is imported.
        """
        point = None if name in known else self.installed().get(name)
        if name in known or (point is None and ":" not in name):
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

    def load(self, point: EntryPoint) -> type[Base]:
        """Import the class of an entry point; ValueError if the import fails, or the class has the wrong base."""
        where = f"{self.kind} {point.name!r} of package {package(point)}"
        try:
            loaded = point.load()
        except (Exception, SystemExit):
            raise _import_failed(where) from None
        checked = self._checked(loaded, where, point.value)
        own: Any = vars(checked)["name"]
        if own != point.name:
            raise ValueError(
                f"{where}: {point.value} has the name {own!r}; the entry point must have the same name"
            )
        return checked

    def _imported(self, name: str) -> type[Base]:
        module_name, _, class_name = name.partition(":")
        where = f"{self.kind} {name!r}"
        if not module_name or not class_name:
            raise ValueError(f"{where}: must be package.module:Class")
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
        if not hasattr(module, class_name):
            there = [each for each, loaded in vars(module).items() if self._is_one(loaded)]
            raise ValueError(f"{where}: {module_name} has no {class_name}; {there_are(there, class_name)}")
        return self._checked(getattr(module, class_name), where, class_name)

    def _is_one(self, loaded: object) -> bool:
        return isinstance(loaded, type) and issubclass(loaded, self.base) and "name" in vars(loaded)

    def _checked(self, loaded: object, where: str, named: str) -> type[Base]:
        if not self._is_one(loaded):
            base = f"{self.base.__module__}.{self.base.__name__}"
            raise ValueError(f"{where}: {named} is not a subclass of {base} with a name")
        lacks = [
            name for name, each in inspect.getmembers(loaded) if getattr(each, "__isabstractmethod__", False)
        ]
        if lacks:
            raise ValueError(f"{where}: {named} does not define the abstract methods {', '.join(lacks)}")
        return cast("type[Base]", loaded)


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
    ]
    path = Path(place).resolve()
    return any(
        path.is_relative_to(Path(folder).resolve()) for folder in [*folders, str(Path(__file__).parent)]
    )


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
    shown = "".join(traceback.format_exception(kind, error, frames)).rstrip()
    return ValueError(f"{where} cannot be imported:\n{shown}")
