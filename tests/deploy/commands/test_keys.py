"""`murmur keys`, and a manually started hub that requires its certificates."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from agent.radios.team_key import read_key
from deploy.commands.app import app
from deploy.dashboard.windows import free_port
from deploy.run import preload  # noqa: F401  which the servers do, in threads with a time limit
from deploy.run.by_hand import serve_netshaper, serve_routing
from deploy.scenario.errors import ScenarioError
from deploy.scenario.scenario import parse
from protocol import keys as names
from protocol.bus import Bus
from protocol.keys import Keys
from protocol.message_codec import pack
from protocol.messages import Shutdown
from protocol.zenoh_bus import Credential, join
from tests.deploy.commands.office_floor import murmur


def test_certificates_are_written_once(tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    result = murmur("keys", str(folder), "--robots", "2", "--address", "hub.example", "--address", "10.0.0.1")
    assert result.exit_code == 0, result.stderr
    output = " ".join(result.stdout.split())
    assert f"13 files in {folder}, for a hub at hub.example, 10.0.0.1; valid for 30 days." in output
    again = murmur("keys", str(folder))
    assert again.exit_code == 2
    assert "authority.pem already exists, and is kept; name a new directory" in again.stderr


def test_an_address_with_a_port_is_refused(tmp_path: Path) -> None:
    result = murmur("keys", str(tmp_path / "keys"), "--address", "10.0.0.1:7447")
    assert result.exit_code == 2
    assert "address = '10.0.0.1:7447': must be a host's name or IP address" in result.stderr
    assert not (tmp_path / "keys").exists()


@pytest.fixture
def started(tmp_path: Path) -> Iterator[Callable[..., str]]:
    """Starts a hub or a router by hand, and returns where it listens once it does; all end with the hub."""
    threads: list[threading.Thread] = []

    def start(serve: Callable[..., None], first: object, folder: Path, *more: object) -> str:
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            listen = f"127.0.0.1:{probe.getsockname()[1]}"
        is_there = threading.Event()
        threads.append(
            threading.Thread(
                target=serve, args=(first, listen, folder, lambda _: is_there.set(), *more), daemon=True
            )
        )
        threads[-1].start()
        assert is_there.wait(30)
        return listen

    yield start
    for thread in threads:
        thread.join(30)
        assert not thread.is_alive()


def end_run(recorder: Bus, run: str) -> None:
    recorder.put(Keys(run).control_tx(names.RECORDER), pack(Shutdown()))
    recorder.close()


def test_a_manually_started_hub_requires_the_generated_keys(
    tmp_path: Path, started: Callable[..., str]
) -> None:
    murmur("keys", str(tmp_path / "keys"), "--robots", "1")
    folder = tmp_path / "credentials"
    listen = started(serve_netshaper, parse({"map": "em", "robots": 1}), folder, tmp_path / "keys")
    credential = Credential.read(folder / "recorder.json")
    assert credential.hub == f"tls/{listen}"
    end_run(join(credential), credential.run)


def test_robots_join_through_a_router_that_was_started_by_hand(
    tmp_path: Path, started: Callable[..., str]
) -> None:
    murmur("keys", str(tmp_path / "keys"), "--robots", "2", "--router", "rack=0")
    hub, routed = tmp_path / "credentials", tmp_path / "routed"
    started(serve_netshaper, parse({"map": "em", "robots": 2}), hub, tmp_path / "keys")
    assert not (hub / "r0.json").exists()
    listen = started(serve_routing, hub / "router@rack.json", routed)
    assert [path.name for path in routed.iterdir()] == ["r0.json"]
    credential = Credential.read(routed / "r0.json")
    assert credential.hub == f"tcp/{listen}"
    robot, recorder = join(credential), join(Credential.read(hub / "recorder.json"))
    received = None
    while received is None:  # until the router knows the recorder's subscription
        robot.put(Keys(credential.run).control(names.RECORDER, "r0"), b"through")
        received = recorder.receive(0.25)
    assert received.payload == b"through"
    robot.close()
    end_run(recorder, credential.run)
    with pytest.raises(ScenarioError, match=r"world\.json is that of world; a router's is needed here"):
        serve_routing(hub / "world.json", listen, tmp_path / "other", lambda _: None)


@pytest.mark.parametrize(
    ("output", "message"),
    [
        ("", "credential on standard input: not JSON"),
        ("{}", "credential on standard input: needs the strings run, name, hub, password"),
        (
            '{"run": "a", "name": "recorder", "hub": "tcp/127.0.0.1:1", "password": "x"}',
            "'recorder' is not the name of a robot",
        ),
    ],
)
def test_a_robot_s_credential_on_standard_input_is_checked(output: str, message: str) -> None:
    result = CliRunner().invoke(app, ["run", "agent", "--credential", "-"], input=output)
    assert result.exit_code == 2
    assert message in result.stderr


def test_keys_of_a_smaller_run_are_refused_by_the_hub(tmp_path: Path) -> None:
    murmur("keys", str(tmp_path / "keys"), "--robots", "1")
    with pytest.raises(ValueError, match=r"r1\.pem: No such file"):
        serve_netshaper(
            parse({"map": "em", "robots": 2}),
            f"127.0.0.1:{free_port()}",
            tmp_path / "credentials",
            print,
            tmp_path / "keys",
        )
    assert not (tmp_path / "credentials").exists()


def test_the_key_of_a_team_in_the_field_is_written_once(tmp_path: Path) -> None:
    path = tmp_path / "team.key"
    result = murmur("keys", "--team-key", str(path))
    assert result.exit_code == 0, result.stderr
    assert len(read_key(path)) == 32
    assert [each.name for each in tmp_path.iterdir()] == ["team.key"]
    again = murmur("keys", "--team-key", str(path))
    assert again.exit_code == 2
    assert "already exists" in again.stderr


def test_keys_and_credentials_that_others_may_read_cause_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "hand.toml").write_text("robots = 1\n")
    murmur("keys", "keys", "--robots", "1", "--address", "10.0.0.1")
    relay = ("run", "netshaper", "hand.toml", "--listen", "127.0.0.1:9", "--keys", "keys")
    assert "warning" not in murmur(*relay).stderr
    for key in (tmp_path / "keys").glob("*.key"):
        key.chmod(0o644)
    refused = murmur(*relay)
    warning = "warning: keys/r0.key has mode 644, so other users may use it: chmod 600 keys/r0.key"
    assert f"{warning}; the same holds for 4 more files there\n" in refused.stderr
    credential = tmp_path / "r0.json"
    credential.write_text("{}")
    credential.chmod(0o640)
    for command in ("agent", "router"):
        refused = murmur("run", command, "--credential", "r0.json")
        assert refused.exit_code == 2
        assert (
            "warning: r0.json has mode 640, so other users may use it: chmod 600 r0.json\n" in refused.stderr
        )
