"""Helpers for tests of commands: a function that calls one, and a small floor to explore."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import Result
from typer.testing import CliRunner

from deploy.commands.app import app
from worldsim import generators, maps


def murmur(*arguments: str) -> Result:
    """Call the command in this process."""
    return CliRunner().invoke(app, arguments)


def make_floor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.chdir(tmp_path)
    maps.save(generators.make("office", width_m=10, height_m=10), tmp_path / "floor.yaml")
    return "floor.yaml"


def explore(floor: str, *more: str) -> Result:
    return murmur("explore", "--map", floor, "--bus", "memory", "--robots", "2", *more)
