"""The table of commands: complete help, and no import before a command is called."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.core import TyperOption

from deploy.commands.app import COMMANDS, app
from tests.deploy.commands.office_floor import murmur


def commands() -> dict[str, Any]:
    """All commands, by the words that call them."""
    root = typer.main.get_command(app)
    found: dict[str, Any] = {"": root}

    def walk(command: Any, words: tuple[str, ...]) -> None:
        found[" ".join(words)] = command
        for name, inner in getattr(command, "commands", {}).items():
            walk(inner, (*words, name))

    for name in COMMANDS:
        walk(root.get_command(None, name), (name,))
    return found


@pytest.mark.parametrize("words", commands())
def test_each_command_and_flag_has_help(words: str) -> None:
    command = commands()[words]
    for flag in ("--help", "-h"):
        result = murmur(*words.split(), flag)
        assert result.exit_code == 0
        assert result.stderr == ""
    output = " ".join(result.stdout.split())
    assert command.help
    assert command.help.split(".")[0].split()[0] in output
    for parameter in command.params:
        assert getattr(parameter, "help", None), f"{parameter.name} has no help"
        if isinstance(parameter, TyperOption):
            assert max(parameter.opts, key=len) in output
            assert parameter.is_flag or parameter.metavar, f"{parameter.name} shows a type of Python's"
    assert not re.search(r"<\w|\.\.\.[\]}]?\.\.\.", output), "a type of Python's, or dots twice"
    for name, inner in getattr(command, "commands", {}).items():
        assert f"{name} {inner.get_short_help_str(sys.maxsize)}" in output


def test_help_has_a_first_command_and_the_exit_codes() -> None:
    output = " ".join(murmur("--help").stdout.split())
    assert "Start with: murmur explore --robots 5" in output
    assert "0 explored, 1 not finished" in output
    assert "2 bad input, 3 a process died" in output


def test_usage_names_arguments_once_and_in_brackets_if_they_may_be_left_out() -> None:
    for words, usage in (
        (("play",), "play [OPTIONS] LOG..."),
        (("report",), "report [OPTIONS] DIR [OTHER]"),
        (("bench",), "bench [OPTIONS] [NAME...]"),
    ):
        output = murmur(*words, "--help").stdout
        assert output.splitlines()[0].endswith(usage)
        assert f"\nArguments:\n  {usage.partition('[OPTIONS] ')[2].strip('[').removesuffix('...]')}" in output


def test_without_arguments_help_is_printed() -> None:
    result = murmur()
    assert "Usage: " in result.stdout + result.stderr
    assert "explore" in result.stdout + result.stderr


def test_help_of_explore_names_defaults_and_choices() -> None:
    output = " ".join(murmur("explore", "--help").stdout.split())
    for words in (
        "number of robots (default 3)",
        "map encoding: polygons, scans, cells, predictive, slam-toolbox, zstd-maps, none (default predictive)",
        "bytes per step for the whole team (default 1000)",
        "communication range: meters, or % of the map's diagonal (default 100%)",
    ):
        assert words in output
    assert "None" not in output


def test_the_list_of_commands_agrees_with_their_help() -> None:
    for name, place in COMMANDS.items():
        own = commands()[name].help.split("\n")[0]
        assert own.split()[0] == place.line.split()[0], name
        assert place.line.endswith(".") and len(place.line) <= 80


def test_help_and_version_import_no_heavy_modules() -> None:
    for words in ("--help", "--version"):
        code = f"import sys; from deploy.commands.app import app; app({[words]!r}, standalone_mode=False); "
        code += "print('heavy:', sorted({'numpy', 'numba', 'zenoh', 'pydantic'} & set(sys.modules)))"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert done.stdout.endswith("heavy: []\n")


@pytest.mark.parametrize(
    ("words", "allowed"), [(("strategies",), set()), (("map", "show", "office"), {"scipy"})], ids=str
)
def test_light_commands_import_no_compiler(words: tuple[str, ...], allowed: set[str]) -> None:
    heavy = {"numba", "scipy", "zenoh", "pyarrow", "polars"} - allowed
    code = f"import sys; from deploy.commands.app import app; app({list(words)!r}, standalone_mode=False); "
    code += f"print('heavy:', sorted({heavy!r} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.endswith("heavy: []\n")


@pytest.mark.parametrize(
    ("module", "number"),
    [(name, signal.SIGINT) for name in ("typer", "rich", "pydantic", "numpy")] + [("numpy", signal.SIGTERM)],
)
def test_a_signal_during_an_import_ends_the_command_with_a_message(
    tmp_path: Path, module: str, number: signal.Signals
) -> None:
    # Short sleeps: Python handles a signal that arrives just before a sleep only after it.
    lines = ("import time", "print('importing', flush=True)", "for _ in range(6000):", "    time.sleep(0.01)")
    (tmp_path / f"{module}.py").write_text("\n".join(lines))
    with subprocess.Popen(
        [sys.executable, "-m", "deploy.commands.main", "explore", "--steps", "1"],
        env=os.environ | {"PYTHONPATH": f"{tmp_path}:{Path(__file__).parents[3]}"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        cwd=tmp_path,
        text=True,
    ) as started:
        assert started.stdout is not None
        assert started.stdout.readline() == "importing\n"
        started.send_signal(number)
        _, output = started.communicate(timeout=60)
    assert (started.returncode, output) == (130, "murmur: interrupted\n")


def test_ctrl_c_at_other_times_ends_the_command_with_the_same_message(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupt(_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("worldsim.generators.describe", interrupt)
    result = murmur("map", "list")
    assert (result.exit_code, result.stderr) == (130, "murmur: interrupted\n")


@pytest.mark.parametrize("closed", ["0<&-", "1>&-", "2>&-", "0<&- 1>&- 2>&-"])
def test_a_command_runs_with_closed_standard_streams(tmp_path: Path, closed: str) -> None:
    out = tmp_path / "run"
    words = [
        sys.executable,
        "-m",
        "deploy.commands.main",
        "explore",
        "--map",
        "em",
        "--robots",
        "1",
        "--out",
        out,
    ]
    done = subprocess.run(
        ["sh", "-c", f'exec "$@" {closed}', "sh", *words],
        capture_output=True, text=True, check=False,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[3])},
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    assert (out / "maps.png").exists()


def test_the_version_is_the_version_of_the_distribution() -> None:
    assert murmur("--version").stdout == f"murmur {version('murmur-robots')}\n"
