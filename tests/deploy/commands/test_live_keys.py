"""Keys that control a run: each prints its effect, and invalid input prints an error."""

from __future__ import annotations

import io
import json
import os
import pty
import re
import sys
import termios
import time
from pathlib import Path

import pytest
from rich.console import Console

from deploy.commands.live_keys import HELP, Keys
from deploy.commands.terminal import progress
from deploy.run.control import Control
from deploy.run.exploration import explore
from deploy.scenario.plan import make
from deploy.scenario.scenario import load, parse
from tests.deploy.commands.office_floor import murmur


@pytest.fixture
def control() -> Control:
    made = Control()
    made.attach(make(parse({"map": "em", "robots": 2})))
    return made


def press(keys: Keys, text: str) -> str:
    for key in text:
        keys.press(key)
    return keys.message


def test_space_pauses_and_resumes_and_s_runs_one_step(control: Control) -> None:
    keys = Keys(control)
    assert press(keys, " ") == "paused: space continues, s steps"
    assert control.paused
    assert press(keys, " ") == HELP
    assert not control.paused
    press(keys, "s")
    assert control._credit.value == 1


def test_plus_and_minus_change_the_speed(control: Control) -> None:
    keys = Keys(control)
    assert press(keys, "-") == "50 steps/s"
    assert press(keys, "--") == "10 steps/s"
    assert press(keys, "-" * 9) == "0.5 steps/s"
    assert press(keys, "+") == "1 steps/s"
    assert press(keys, "+" * 9) == "unlimited speed"
    assert control.speed is None


def test_values_are_typed_corrected_and_checked(control: Control) -> None:
    keys = Keys(control)
    assert press(keys, "b5x") == "bandwidth: 5x"
    assert press(keys, "\x7f00") == "bandwidth: 500"
    assert press(keys, "\n").startswith("bandwidth 500 B from the next step")
    assert press(keys, "r25%\n") == "range 25% from the next step"
    assert press(keys, "k1\n") == "robot 1 will be killed at the next step"
    assert press(keys, "k7\n") == "kill: unknown robot 7; the last one is 1"
    assert press(keys, "kx\n") == "kill: 'x' is not a robot number"
    assert "must be a whole number" in press(keys, "bmuch\n")
    assert press(keys, "k1\x1b") == HELP
    assert control._requests.qsize() == 3


@pytest.mark.parametrize("bus", [pytest.param("memory", marks=pytest.mark.long), "zenoh"])
def test_keys_control_a_run_which_can_be_replayed_and_the_terminal_is_restored(
    bus: str, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    words = ["explore", "--map", "em", "--robots", "2", "--bus", bus, "--steps", "40", "--out", str(out)]
    child, terminal = pty.fork()
    if child == 0:
        os.execv(sys.executable, [sys.executable, "-m", "deploy.commands.main", *words, "--pace", "20"])
    before = termios.tcgetattr(terminal)
    shown, presses = b"", [(b"space pause", b"k1\n"), (b"robot 1 will be killed", b"b50\n")]
    deadline = time.monotonic() + 120
    while time.monotonic() < deadline:
        try:
            shown += os.read(terminal, 4096)
        except OSError:
            break
        if presses and presses[0][0] in shown:
            os.write(terminal, presses.pop(0)[1])
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) in (0, 1), shown.decode()
    assert termios.tcgetattr(terminal) == before
    assert b"robot 1 will be killed" in shown
    scenario = load(out / "scenario.toml", {})
    assert [fault.robot for fault in scenario.fault] == [1]
    assert [change.bandwidth for change in scenario.change] == [50]
    repeated = murmur("replay", str(out))
    assert repeated.exit_code == 0, repeated.stderr
    assert json.loads((out / "summary.json").read_text())["digest"][:16] in repeated.stdout


@pytest.mark.parametrize("width", [40, 60, 80, 200])
def test_the_progress_line_fits_the_terminal(width: int, tmp_path: Path) -> None:
    text = io.StringIO()
    console = Console(file=text, force_terminal=True, width=width, soft_wrap=True, color_system=None)
    with progress(console, shown=True, message=lambda: HELP) as watch:
        assert watch is not None
        result = explore(parse({"robots": 1, "steps": 3, "bus": "memory"}), out=tmp_path / "run")
        watch(result.plan, result.records)
    lines = re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", text.getvalue()).replace("\r", "\n").splitlines()
    assert all(len(line.rstrip()) <= width for line in lines)
    assert not any("\N{HORIZONTAL ELLIPSIS}" in line for line in lines)
    first = next(line for line in lines if line.startswith("step"))
    assert first.split()[1] == "3" and "1 robot" in first and "1 robots" not in first
    assert "r range" in " ".join(lines)
