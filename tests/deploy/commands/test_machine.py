"""`murmur doctor`: its findings and its advice."""

from __future__ import annotations

import importlib.util
from importlib.machinery import ModuleSpec

import pytest

from tests.deploy.commands.office_floor import murmur


def test_the_doctor_names_the_extra_of_a_missing_package(monkeypatch: pytest.MonkeyPatch) -> None:
    found = importlib.util.find_spec

    def without_rerun(name: str, package: str | None = None) -> ModuleSpec | None:
        return None if name == "rerun" else found(name, package)

    monkeypatch.setattr(importlib.util, "find_spec", without_rerun)
    result = murmur("doctor")
    assert result.exit_code == 0, result.stdout
    assert "pip install 'murmur-robots[view]'" in result.stdout
    assert result.stdout.count("ok ") == 6
