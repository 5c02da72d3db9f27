"""Limits of the code's structure: lengths of functions, attributes of classes, and no circle of imports."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("agent", "deploy", "murmur", "netshaper", "protocol", "worldsim")
MAX_LINES, MAX_ATTRIBUTES = 70, 20

Function = ast.FunctionDef | ast.AsyncFunctionDef


@cache
def modules() -> dict[str, ast.Module]:
    """The syntax trees of all modules, by name."""
    found = {}
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
            found[name] = ast.parse(path.read_text(encoding="utf-8"))
    return found


def attributes(kind: ast.ClassDef) -> set[str]:
    """The names that a class itself declares as fields, or assigns to `self`; those of its bases do not count."""
    declared = [item for item in kind.body if isinstance(item, ast.AnnAssign)]
    names = {
        item.target.id
        for item in declared
        if isinstance(item.target, ast.Name) and "ClassVar" not in ast.unparse(item.annotation)
    }
    return names | {
        item.attr
        for item in ast.walk(kind)
        if isinstance(item, ast.Attribute) and isinstance(item.ctx, ast.Store)
        and isinstance(item.value, ast.Name) and item.value.id == "self"
    }  # fmt: skip


def imports(tree: ast.Module, known: set[str]) -> Iterator[str]:
    """The modules that a module imports, also within functions, but not for type checking alone."""
    skipped = {
        id(inner)
        for item in ast.walk(tree)
        if isinstance(item, ast.If) and ast.unparse(item.test) == "TYPE_CHECKING"
        for inner in ast.walk(item)
    }
    for item in ast.walk(tree):
        if id(item) in skipped:
            continue
        if isinstance(item, ast.Import):
            yield from (each.name for each in item.names)
        elif isinstance(item, ast.ImportFrom):
            for each in item.names:
                inner = f"{item.module}.{each.name}"
                yield inner if inner in known else str(item.module)


def test_no_function_but_kernels_is_longer_than_the_limit() -> None:
    long = [
        (name, item.name)
        for name, tree in modules().items()
        for item in ast.walk(tree)
        if isinstance(item, Function)
        and not any("kernel" in ast.unparse(each) for each in item.decorator_list)
        and (item.end_lineno or 0) - item.lineno + 1 > MAX_LINES
    ]
    assert not long


def test_no_class_has_more_attributes_than_the_limit() -> None:
    wide = [
        (name, item.name)
        for name, tree in modules().items()
        for item in ast.walk(tree)
        if isinstance(item, ast.ClassDef) and len(attributes(item)) > MAX_ATTRIBUTES
    ]
    assert not wide


def test_imports_form_no_circle() -> None:
    trees = modules()
    graph = {
        name: {each for each in imports(tree, set(trees)) if each in trees} for name, tree in trees.items()
    }
    TopologicalSorter(graph).prepare()
