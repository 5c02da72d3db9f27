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
LOOP = STRATEGY.replace("return self.worth(goals)", "while True: pass")
STILL = STRATEGY.replace("if situation.step > 2:", "if print(goals) is None:").replace("return self", "self")
STILL = STILL.replace("self.worth(goals)", "return None")
SHIFTED = STRATEGY.replace("return self.worth(goals)", "goals += 1000; x, y = goals[0]; return x, y")
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


def run_strategy(folder: Path, source: str, *more: str) -> subprocess.CompletedProcess[str]:
    (folder / "torn.py").write_text(source)
    return murmur(folder, *COMMAND, *more)


def murmur(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "deploy.commands.main", *words],
        capture_output=True,
        text=True,
        cwd=folder,
        env={"PYTHONPATH": str(Path(__file__).parents[2]), "PATH": "/usr/bin:/bin", "HOME": str(folder)},
        check=False,
    )


def test_the_log_of_a_robot_that_never_decides_has_the_line_of_its_loop(tmp_path: Path) -> None:
    done = run_strategy(tmp_path, LOOP, "--set", "reply_timeout_s=2")
    assert "robot 0 was lost: timed out after 2 s" in done.stderr
    assert done.stdout.endswith("Output of the processes: run/logs\n")
    assert f'File "{tmp_path / "torn.py"}", line 9 in choose' in (tmp_path / "run/logs/r0.log").read_text()
    assert Path(tmp_path / "run/logs/r0.log").stat().st_mode & 0o111 == 0, "not executable"


def test_the_place_of_printed_output_and_a_team_that_stands_still_are_reported(tmp_path: Path) -> None:
    done = run_strategy(tmp_path, STILL, "--steps", "60")
    assert done.stdout.endswith("Output of the processes: run/logs\n")
    assert done.stderr == "no robot moved in the last 59 steps: none had a target\n"


def test_goals_that_a_strategy_has_changed_are_no_goals(tmp_path: Path) -> None:
    done = run_strategy(tmp_path, SHIFTED)
    assert "last output: strategy torn chose (1" in done.stderr
    assert "which is not one of its goals" in done.stderr


def test_a_replay_that_differs_names_the_strategy_because_it_may_draw_random_numbers(tmp_path: Path) -> None:
    seen = f"pathlib.Path({str(tmp_path / 'seen')!r})"  # other goals in the replay, not by chance
    choice = f"x, y = goals[-1 if {seen}.exists() else 0]; {seen}.touch()"
    source = "import pathlib\n" + STRATEGY.replace("x, y = goals[0]", choice)
    run_strategy(tmp_path, source, "--bus", "memory", "--steps", "2")
    done = murmur(tmp_path, "replay", "--trust", "run")
    assert done.returncode == 1
    assert done.stderr.endswith("  torn:Torn may have changed since, draw random numbers, or read a clock\n")


@pytest.mark.parametrize("bus", ["memory", "zenoh"])
def test_a_wrong_value_of_a_strategy_is_reported_without_frames_of_murmur(tmp_path: Path, bus: str) -> None:
    done = run_strategy(tmp_path, STRATEGY.replace("return self.worth(goals)", "return goals"), "--bus", bus)
    first, *more = done.stderr.splitlines()
    assert first.startswith(
        "r0, r1 died: exit code 1; last output: strategy torn: choose must return a goal (x, y), or None; it returned "
    )
    assert not any("Traceback" in line or "File" in line for line in more)


@pytest.mark.parametrize("bus", ["memory", "zenoh"])
def test_an_exception_in_a_strategy_is_reported_with_only_the_author_s_frames(
    tmp_path: Path, bus: str
) -> None:
    done = run_strategy(tmp_path, STRATEGY, "--bus", bus)
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
