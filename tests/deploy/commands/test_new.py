"""`murmur new`: the generated files work unchanged, in any directory."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.deploy.commands.office_floor import murmur

ROOT = Path(__file__).parents[3]

SHORT = ["--map", "em", "--robots", "1", "--bus", "memory", "--steps", "3", "--json"]


def elsewhere(*words: str) -> subprocess.CompletedProcess[str]:
    """Run Python in the working directory, with Murmur importable as if it was installed."""
    safe = {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1"}
    return subprocess.run(
        [sys.executable, *words], env=os.environ | safe, capture_output=True, text=True, check=False
    )


@pytest.fixture(autouse=True)
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_new_strategy_passes_its_test_and_explores_with_the_printed_command() -> None:
    output = murmur("new", "strategy", "my-way")
    assert output.exit_code == 0, output.stderr
    tested = elsewhere("-m", "pytest", "-q", "-p", "no:cacheprovider", "test_my_way.py")
    assert tested.returncode == 0, tested.stdout
    assert "2 passed" in tested.stdout
    done = elsewhere("-m", "deploy.commands.main", "explore", "--strategy", "my_way:MyWay", *SHORT)
    assert done.returncode == 1, done.stderr
    assert '"strategy": "my_way:MyWay"' in done.stdout


def test_a_local_file_with_the_name_of_a_package_does_not_shadow_it() -> None:
    Path("protocol.py").write_text("raise RuntimeError('the wrong one')\n")
    murmur("new", "strategy", "farthest")
    done = elsewhere("-m", "deploy.commands.main", "explore", "--strategy", "farthest:Farthest", *SHORT)
    assert done.returncode == 1, done.stderr


def test_an_error_in_a_user_s_strategy_is_shown_with_its_traceback() -> None:
    Path("broken.py").write_text("import numpy\n\nnumpy.unknown_name\n")
    done = elsewhere("-m", "deploy.commands.main", "explore", "--strategy", "broken:Broken")
    assert done.returncode == 2
    assert 'broken.py", line 3' in done.stderr and "unknown_name" in done.stderr
    assert "pydantic" not in done.stderr


@pytest.mark.parametrize(
    ("name", "output"), [("My Way", "must be lower-case"), ("class", "must be lower-case")]
)
def test_an_invalid_name_is_rejected(name: str, output: str) -> None:
    result = murmur("new", "strategy", name)
    assert result.exit_code == 2 and output in result.stderr
    assert list(Path().iterdir()) == []


def test_no_file_is_overwritten() -> None:
    Path("test_farthest.py").write_text("mine")
    result = murmur("new", "strategy", "farthest")
    assert result.exit_code == 2 and "test_farthest.py: is there already" in result.stderr
    assert not Path("farthest.py").exists()
