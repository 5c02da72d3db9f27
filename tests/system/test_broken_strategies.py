"""An exception in a user's strategy: on either bus, the report has only the user's frames and the log's path."""

from __future__ import annotations

import gc
import subprocess
import sys
from pathlib import Path

import pytest

from murmur import RunFailed, explore

STRATEGY = """from agent.strategies.targets import TargetStrategy


class Torn(TargetStrategy):
    name, summary, source = "torn", "breaks in its third step", "our own"

    def choose(self, situation, goals, planner):
        if situation.step > 2:
            return self.worth(goals)
        x, y = goals[0]
        return int(x), int(y)

    def worth(self, goals):
        raise IndexError("index 7 of 7")
"""
COMMAND = (
    "explore",
    "--map",
    "em",
    "--robots",
    "2",
    "--steps",
    "40",
    "--strategy",
    "torn:Torn",
    "--out",
    "run",
)


@pytest.mark.parametrize("bus", ["memory", "zenoh"])
def test_an_exception_in_a_strategy_is_reported_with_only_the_author_s_frames(
    tmp_path: Path, bus: str
) -> None:
    (tmp_path / "torn.py").write_text(STRATEGY)
    done = subprocess.run(
        [sys.executable, "-m", "deploy.commands.main", *COMMAND, "--bus", bus],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={"PYTHONPATH": str(Path(__file__).parents[2]), "PATH": "/usr/bin:/bin", "HOME": str(tmp_path)},
        check=False,
    )
    assert done.returncode == 3, done.stderr
    lines = done.stderr.splitlines()
    assert lines[0] == "r0, r1 died: exit code 1; last output: Traceback (most recent call last):"
    frames = [line.strip().split(", ")[-1] for line in lines if line.startswith('  File "')]
    assert frames == ["in choose", "in worth"]
    assert f'"{tmp_path / "torn.py"}", line 14' in done.stderr
    assert "IndexError: index 7 of 7" in done.stderr
    assert "full output: run/logs/r0.log, run/logs/r1.log" in lines
    assert "IndexError" in (tmp_path / "run" / "logs" / "r0.log").read_text()
    assert done.stdout.startswith("Not finished after 3 steps: all robots are lost.")


def test_a_run_without_robots_left_raises_in_python_and_its_result_shows_the_exception(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "torn_too.py").write_text(STRATEGY)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RunFailed) as failed:
        explore(map="em", robots=1, strategy="torn_too:Torn", bus="memory", keep=False)
    assert str(failed.value).startswith("all robots were lost by step 3: robot 0: ")
    assert "IndexError: index 7 of 7" in str(failed.value)
    result = failed.value.result
    assert result is not None
    assert result.exit_code == 3
    assert str(result).splitlines()[-1].startswith("IndexError: index 7 of 7")
    assert "IndexError: index 7 of 7" in result._repr_html_()
    del result, failed, sys.modules["torn_too"]
    gc.collect()  # the strategy is not there for other tests
