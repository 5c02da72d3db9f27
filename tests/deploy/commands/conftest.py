"""Fixtures of the tests of commands."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.deploy.commands.office_floor import make_floor


@pytest.fixture
def floor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A small floor of an office, in a file in the folder where the test works."""
    return make_floor(tmp_path, monkeypatch)
