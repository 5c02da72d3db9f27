"""Docstrings name only files that exist, and docs/architecture.md lists every module."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("agent", "deploy", "murmur", "netshaper", "protocol", "worldsim")
FILE = re.compile(r"`([\w/]+\.py)`")
MODULE = re.compile(rf"`((?:{'|'.join(PACKAGES)})(?:\.\w+)+)`")
ROW = re.compile(r"\| `([\w/]+)/` \|[^|]*\|([^|]*)\|")


def docstrings(path: Path) -> Iterator[str]:
    """The docstrings of a module, its classes, and its functions."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            yield ast.get_docstring(node) or ""


def exists(name: str) -> bool:
    """Whether a dotted name is that of a module, or of something in its text."""
    parts = name.split(".")
    for count in range(len(parts), 0, -1):
        path = ROOT.joinpath(*parts[:count])
        file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        if file.exists():
            text = file.read_text(encoding="utf-8")
            return all(re.search(rf"\b{part}\b", text) for part in parts[count:])
    return False


@pytest.mark.parametrize("package", PACKAGES)
def test_each_file_and_module_that_a_docstring_names_exists(package: str) -> None:
    for path in (ROOT / package).rglob("*.py"):
        text = "\n".join(docstrings(path))
        for name in FILE.findall(text):
            assert any((folder / name).exists() for folder in (path.parent, ROOT / package, ROOT)), (
                path,
                name,
            )
        for name in MODULE.findall(text):
            assert exists(name), (path, name)


def test_the_reading_order_has_each_module() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    listed = {(folder, name) for folder, cell in ROW.findall(page) for name in re.findall(r"`(\w+)`", cell)}
    assert listed == {
        (path.parent.relative_to(ROOT).as_posix(), path.stem)
        for package in PACKAGES
        for path in (ROOT / package).rglob("*.py")
        if path.stem != "__init__"
    }
