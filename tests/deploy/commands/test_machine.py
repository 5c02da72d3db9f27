"""`murmur doctor`: its findings and its advice."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from importlib.machinery import ModuleSpec
from pathlib import Path

import pytest

from tests.deploy.commands.office_floor import murmur
from tests.deploy.field.robot_processes import settings, write


def test_the_doctor_names_the_extra_of_a_missing_package(monkeypatch: pytest.MonkeyPatch) -> None:
    found = importlib.util.find_spec

    def without_rerun(name: str, package: str | None = None) -> ModuleSpec | None:
        return None if name == "rerun" else found(name, package)

    monkeypatch.setattr(importlib.util, "find_spec", without_rerun)
    result = murmur("doctor")
    assert result.exit_code == 0, result.stdout
    assert "pip install 'murmur-robots[view]'" in result.stdout
    assert result.stdout.count("ok ") == 6


@pytest.mark.parametrize("command", [("serve-ros2",), ("robot", "FILE"), ("doctor", "--ros2", "FILE")])
def test_commands_for_ros_name_the_extra_of_a_missing_package(
    command: tuple[str, ...], tmp_path: Path
) -> None:
    file = str(write(tmp_path, settings()))
    program = "import sys; sys.modules['xxhash'] = None; from deploy.commands.main import main; main()"
    arguments = [file if word == "FILE" else word for word in command]
    done = subprocess.run(
        [sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=False
    )
    message = "murmur: ROS 2 needs the package xxhash: pip install 'murmur-robots[ros2]'\n"
    assert (done.returncode, done.stderr) == (2, message)
