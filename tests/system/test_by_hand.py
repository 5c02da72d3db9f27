"""docs/several-terminals.md, done: its very commands make the run that `murmur explore` makes."""

from __future__ import annotations

import io
import json
import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from deploy.run.by_hand import STANDARD_INPUT, serve_netshaper, serve_recorder, serve_robot, serve_worldsim
from deploy.scenario.errors import ScenarioError
from deploy.scenario.scenario import parse
from netshaper import access, certificates
from protocol.zenoh_bus import Credential
from tests.deploy.commands.office_floor import murmur
from worldsim import generators, maps

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "several-terminals.md").read_text(encoding="utf-8")
SCENARIO = "".join(re.findall(r"^```toml\n(.*?)^```$", TEXT, re.M | re.S))
COMMANDS = re.findall(r"^\$ murmur (.*)$", TEXT, re.M)
ADDRESS = "127.0.0.1:7447"
PATIENCE_S = 180


def free_address() -> str:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{probe.getsockname()[1]}"


@contextmanager
def terminals(folder: Path) -> Iterator[dict[str, subprocess.Popen[str]]]:
    """Processes by their command, started in one folder; the context manager kills those that still run at its end."""
    running: dict[str, subprocess.Popen[str]] = {}
    (folder / "hand.toml").write_text(SCENARIO)
    try:
        yield running
    finally:
        for process in running.values():
            if process.poll() is None:
                process.kill()
            process.communicate()


def start(command: str, folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "deploy.commands.main", *shlex.split(command)],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def wait_for(path: Path, process: subprocess.Popen[str], size: int = 0) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not path.exists() or path.stat().st_size < size:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline, f"no {path.name}"
        time.sleep(0.05)


def digest(directory: Path) -> str:
    read: str = json.loads((directory / "summary.json").read_text())["digest"]
    return read


def test_the_commands_of_the_document_give_the_same_run_as_explore(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    address = free_address()
    *by_hand, in_memory = [command.replace(ADDRESS, address) for command in COMMANDS]
    assert [command.split()[1] for command in by_hand] == [
        "netshaper",
        "worldsim",
        "agent",
        "agent",
        "recorder",
    ]
    with terminals(tmp_path) as running:
        for command in by_hand:
            running[command] = start(command, tmp_path)
            wait_for(tmp_path / "credentials" / "scenario.toml", running[by_hand[0]])
        output = {command: process.communicate(timeout=PATIENCE_S) for command, process in running.items()}
        codes = {command: process.returncode for command, process in running.items()}
        assert set(codes.values()) == {0}, output
        relay, world, *agents, recorder = (output[command][0] for command in by_hand)
        assert re.match(
            rf"run \w+ at tcp/{address}; credentials in credentials: world, recorder, view, r0, r1\n", relay
        )
        assert "\nwaiting for r0, r1, recorder, world\n" in relay
        assert relay.endswith("\nall participants have joined\n")
        assert not world
        assert agents == ["", ""]
        assert recorder.lstrip().startswith("Explored in ")
        assert "Results: by-hand (pictures: by-hand/maps.png)" in recorder
    monkeypatch.chdir(tmp_path)
    done = murmur(*shlex.split(in_memory))
    assert done.exit_code == 0, done.stderr
    assert digest(tmp_path / "by-hand") == digest(tmp_path / "by-memory")


def test_ctrl_c_in_each_terminal_has_the_documented_effect(tmp_path: Path) -> None:
    address = free_address()
    netshaper, worldsim, r0, r1, recorder = [command.replace(ADDRESS, address) for command in COMMANDS[:-1]]
    with terminals(tmp_path) as running:
        (tmp_path / "hand.toml").write_text(SCENARIO + "speed = 0.005\n")  # not over before Ctrl-C
        for command in (netshaper, worldsim, r0, r1, recorder):
            running[command] = start(command, tmp_path)
            wait_for(tmp_path / "credentials" / "scenario.toml", running[netshaper])
        capture = tmp_path / "by-hand" / "radio.pcapng"
        wait_for(capture, running[recorder], size=10_000)
        running[r1].send_signal(signal.SIGINT)
        running[r1].wait(PATIENCE_S)
        running[recorder].send_signal(signal.SIGINT)
        output, faults = running[recorder].communicate(timeout=PATIENCE_S)
        assert running[recorder].returncode == 3
        assert "robot 1 was lost: its process ended" in faults
        assert "interrupted" in output
        assert "ending after this step; writing the run directory" in faults
        for others in (netshaper, worldsim, r0):
            assert running[others].wait(PATIENCE_S) == 0, others
    assert (tmp_path / "by-hand" / "maps.png").exists()


def test_a_relay_says_why_it_has_broken_off_the_run(tmp_path: Path) -> None:
    address = free_address()
    by_hand = [command.replace(ADDRESS, address) for command in COMMANDS[:-1]]
    netshaper, *_, recorder = by_hand
    with terminals(tmp_path) as running:
        (tmp_path / "hand.toml").write_text(SCENARIO + "speed = 0.005\n")  # not over before the recorder dies
        for command in by_hand:
            running[command] = start(command, tmp_path)
            wait_for(tmp_path / "credentials" / "scenario.toml", running[netshaper])
        wait_for(tmp_path / "by-hand" / "radio.pcapng", running[recorder], size=10_000)
        running[recorder].kill()
        _, faults = running[netshaper].communicate(timeout=PATIENCE_S)
    assert running[netshaper].returncode == 3
    assert faults == "murmur: the run was broken off: the recorder died\n"


def test_a_robot_that_is_started_again_ends_and_counts_as_lost(tmp_path: Path) -> None:
    """Within three seconds, the relay takes the new process for the old one, whose connection was restored."""
    address = free_address()
    netshaper, worldsim, r0, r1, recorder = [command.replace(ADDRESS, address) for command in COMMANDS[:-1]]
    with terminals(tmp_path) as running:
        (tmp_path / "hand.toml").write_text(SCENARIO + "speed = 0.005\n")  # not over before the robot ends
        for command in (netshaper, worldsim, r0, r1, recorder):
            running[command] = start(command, tmp_path)
            wait_for(tmp_path / "credentials" / "scenario.toml", running[netshaper])
        wait_for(tmp_path / "by-hand" / "radio.pcapng", running[recorder], size=10_000)
        running[r1].kill()
        running["again"] = start(r1, tmp_path)
        _, problem = running["again"].communicate(timeout=PATIENCE_S)
        assert running["again"].returncode == 3
        assert "an earlier process of this robot has begun the run" in problem
        running[recorder].send_signal(signal.SIGINT)
        _, faults = running[recorder].communicate(timeout=PATIENCE_S)
        assert running[recorder].returncode == 3
        assert "robot 1 was lost" in faults and "malformed message" not in faults


def test_a_scenario_that_differs_from_the_relay_s_is_rejected_by_setting(tmp_path: Path) -> None:
    credential = access.issue("run", "tcp/127.0.0.1:1", robots=2)
    for name in ("world", "recorder"):
        credential[name].write(tmp_path / f"{name}.json")
    theirs = tomllib.loads(SCENARIO)
    (tmp_path / "scenario.toml").write_text(parse(theirs).to_toml())
    ours = parse(theirs | {"robots": 3})
    with pytest.raises(
        ScenarioError, match=r"^robots = 3 here, but 2 in .*scenario\.toml: all processes need the same"
    ):
        serve_worldsim(ours, tmp_path / "world.json")
    with pytest.raises(
        ScenarioError, match=r"^robots = 3 here, but 2 in .*scenario\.toml: all processes need the same"
    ):
        serve_recorder(ours, tmp_path / "recorder.json", tmp_path / "run", None)
    assert not (tmp_path / "run").exists()


def test_a_map_that_differs_from_the_relay_s_is_rejected(tmp_path: Path) -> None:
    for host, seed in (("relay", 1), ("other", 2)):
        (tmp_path / host).mkdir()
        maps.save(
            generators.make("office", seed=seed, width_m=10, height_m=10), tmp_path / host / "floor.yaml"
        )
    theirs, ours = (parse({"map": str(tmp_path / host / "floor.yaml")}) for host in ("relay", "other"))
    credentials = tmp_path / "credentials"
    with pytest.raises(StopServingError):
        serve_netshaper(theirs, free_address(), credentials, stop_serving)
    message = r"^map = \S*floor.yaml: differs from the map of the relay: copy the same file to all hosts$"
    with pytest.raises(ScenarioError, match=message):
        serve_worldsim(ours, credentials / "world.json")
    with pytest.raises(ScenarioError, match=message):
        serve_recorder(ours, credentials / "recorder.json", tmp_path / "run", None)
    assert not (tmp_path / "run").exists()


class StopServingError(Exception):
    """The relay has written its credentials."""


def stop_serving(_: str) -> None:
    raise StopServingError


def test_a_credential_of_a_relay_with_other_code_is_rejected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, credential in access.issue("run", "tcp/127.0.0.1:1", robots=2).items():
        replace(credential, code="0123456789abcdef").write(tmp_path / f"{name}.json")
    scenario = parse(tomllib.loads(SCENARIO))
    message = (
        r"relay runs other code of Murmur \(0123456789abcdef; here [0-9a-f]{16}\): install the same version"
    )
    with pytest.raises(ScenarioError, match=message):
        serve_worldsim(scenario, tmp_path / "world.json")
    with pytest.raises(ScenarioError, match=message):
        serve_robot(tmp_path / "r0.json")
    monkeypatch.setattr("sys.stdin", io.StringIO((tmp_path / "r0.json").read_text()))
    with pytest.raises(ScenarioError, match=f"^credential on standard input: its {message}"):
        serve_robot(STANDARD_INPUT)


@pytest.mark.parametrize(
    ("days", "name", "fault"), [(0, "r0", r"valid from .*; set the clock"), (9, "r1", "of r0$")]
)
def test_a_certificate_that_a_hub_would_refuse_is_rejected_before_the_process_joins(
    tmp_path: Path, days: int, name: str, fault: str
) -> None:
    certificate = certificates.make(2, ["127.0.0.1"], days=days)["r0"]
    Credential("run", name, "tls/127.0.0.1:1", certificate=certificate).write(tmp_path / "robot.json")
    with pytest.raises(ScenarioError, match=rf"^credential \S*robot.json: its certificate is .*{fault}"):
        serve_robot(tmp_path / "robot.json")


def test_a_relay_that_cannot_listen_leaves_no_credentials(tmp_path: Path) -> None:
    scenario = parse(tomllib.loads(SCENARIO))
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        listen = f"127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(
            ScenarioError, match=r"^listen = '127\S+': .* Address already in use; it must be "
        ):
            serve_netshaper(scenario, listen, tmp_path / "credentials", print)
    with pytest.raises(ScenarioError, match=r"^listen = '192\.0\.2\.7:7447': cannot listen there: "):
        serve_netshaper(scenario, "192.0.2.7:7447", tmp_path / "credentials", print)
    assert not (tmp_path / "credentials").exists()


def test_a_recorder_that_cannot_join_leaves_no_directory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("protocol.zenoh_bus.CONNECT_S", 0.5)
    access.issue("run", "tcp/127.0.0.1:1", robots=2)["recorder"].write(tmp_path / "recorder.json")
    scenario = parse(tomllib.loads(SCENARIO))
    with pytest.raises(ConnectionError, match=r"recorder: cannot join"):
        serve_recorder(scenario, tmp_path / "recorder.json", tmp_path / "run", None)
    assert not (tmp_path / "run").exists()
