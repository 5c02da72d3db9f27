"""`murmur new`: what it writes works as it is, wherever one stands."""

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
    """Run Python in this folder, as it is for somebody who has installed Murmur."""
    safe = {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1"}
    return subprocess.run(
        [sys.executable, *words], env=os.environ | safe, capture_output=True, text=True, check=False
    )


@pytest.fixture(autouse=True)
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_new_strategy_passes_its_own_test_and_explores_by_the_command_that_it_names() -> None:
    output = murmur("new", "strategy", "my-way")
    assert output.exit_code == 0, output.stderr
    tested = elsewhere("-m", "pytest", "-q", "-p", "no:cacheprovider", "test_my_way.py")
    assert tested.returncode == 0, tested.stdout
    assert "2 passed" in tested.stdout
    done = elsewhere("-m", "deploy.commands.main", "explore", "--strategy", "my_way:MyWay", *SHORT)
    assert done.returncode == 1, done.stderr
    assert '"strategy": "my_way:MyWay"' in done.stdout


def test_a_file_called_as_a_room_of_ours_hides_nothing() -> None:
    Path("protocol.py").write_text("raise RuntimeError('the wrong one')\n")
    murmur("new", "strategy", "farthest")
    done = elsewhere("-m", "deploy.commands.main", "explore", "--strategy", "farthest:Farthest", *SHORT)
    assert done.returncode == 1, done.stderr


def test_what_is_wrong_in_a_strategy_of_ones_own_is_shown_as_its_own_traceback() -> None:
    Path("broken.py").write_text("import numpy\n\nnumpy.nonsense\n")
    done = elsewhere("-m", "deploy.commands.main", "explore", "--strategy", "broken:Broken")
    assert done.returncode == 2
    assert 'broken.py", line 3' in done.stderr and "nonsense" in done.stderr
    assert "pydantic" not in done.stderr


@pytest.mark.parametrize(
    ("name", "output"), [("My Way", "must be lower-case"), ("class", "must be lower-case")]
)
def test_a_name_that_is_none_is_refused(name: str, output: str) -> None:
    result = murmur("new", "strategy", name)
    assert result.exit_code == 2 and output in result.stderr
    assert list(Path().iterdir()) == []


def test_nothing_is_written_over() -> None:
    Path("test_farthest.py").write_text("mine")
    result = murmur("new", "strategy", "farthest")
    assert result.exit_code == 2 and "test_farthest.py: is there already" in result.stderr
    assert not Path("farthest.py").exists()
