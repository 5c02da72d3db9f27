"""`murmur new`: the generated files work unchanged, in any directory."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.deploy.commands.office_floor import murmur

ROOT = Path(__file__).parents[3]

SHORT = ["--map", "em", "--robots", "2", "--steps", "3", "--json"]


def elsewhere(*words: str) -> subprocess.CompletedProcess[str]:
    """Run Python in the working directory, with Murmur importable as if it was installed."""
    safe = {"PYTHONPATH": str(ROOT), "PYTHONSAFEPATH": "1"}
    return subprocess.run(
        [sys.executable, *words], env=os.environ | safe, capture_output=True, text=True, check=False
    )


@pytest.fixture(autouse=True)
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_templates_pass_their_tests_and_run_together_on_both_buses_with_equal_results() -> None:
    commands = [
        line.removeprefix("run:  murmur explore ").split()
        for kind in ("strategy", "encoding", "radio")
        for line in murmur("new", kind, f"my-{kind}").stdout.splitlines()
        if line.startswith("run:")
    ]
    assert [words[1] for words in commands] == [
        "my_strategy:MyStrategy",
        "my_encoding:MyEncoding",
        "my_radio:PRESET",
    ]
    tested = elsewhere("-m", "pytest", "-q", "-p", "no:cacheprovider", *map(str, Path().glob("test_*.py")))
    assert tested.returncode == 0, tested.stdout
    assert "7 passed" in tested.stdout
    digests = set()
    for bus in ("memory", "zenoh"):
        together = [word for words in commands for word in words]
        done = elsewhere("-m", "deploy.commands.main", "explore", *together, *SHORT, "--bus", bus)
        assert done.returncode == 1, done.stderr
        summary = json.loads(done.stdout)
        assert (summary["strategy"], summary["map_encoding"]) == (
            "my_strategy:MyStrategy",
            "my_encoding:MyEncoding",
        )
        assert summary["bytes"]["scan"] > 0
        digests.add(summary["digest"])
    assert len(digests) == 1


@pytest.mark.parametrize(
    "words", ["strategy meier", "strategy playback", "encoding predictive", "radio lora-sf9", "radio disc"]
)
def test_the_name_of_a_built_in_part_is_rejected(words: str) -> None:
    result = murmur("new", *words.split())
    assert result.exit_code == 2, result.stdout
    name = words.split()[1]
    assert f"name = {name!r}: a built-in " in result.stderr and f"as my-{name}" in result.stderr
    assert list(Path().iterdir()) == []


def test_a_local_file_with_the_name_of_a_package_does_not_shadow_it() -> None:
    Path("protocol.py").write_text("raise RuntimeError('the wrong one')\n")
    murmur("new", "strategy", "farthest")
    done = elsewhere(
        "-m", "deploy.commands.main", "explore", "--strategy", "farthest:Farthest", *SHORT, "--bus", "memory"
    )
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
    assert result.exit_code == 2 and "test_farthest.py: already exists" in result.stderr
    assert not Path("farthest.py").exists()
