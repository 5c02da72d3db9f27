"""`murmur keys`, and a hub started by hand that asks for what it made."""

from __future__ import annotations

import socket
import threading
from pathlib import Path

import pytest
from typer.testing import CliRunner

from deploy.commands.main import app
from deploy.run.by_hand import serve_netshaper
from deploy.scenario.scenario import parse
from protocol import keys as names
from protocol.keys import Keys
from protocol.messages import Bye, pack
from protocol.zenoh_bus import Credential, join
from tests.deploy.commands.office_floor import murmur


def test_keys_are_written_once_and_say_what_they_are_for(tmp_path: Path) -> None:
    folder = tmp_path / "keys"
    result = murmur("keys", str(folder), "--robots", "2", "--address", "hub.example", "--address", "10.0.0.1")
    assert result.exit_code == 0, result.stderr
    said = " ".join(result.stdout.split())
    assert f"13 files in {folder}, for a hub at hub.example, 10.0.0.1; they hold 30 days." in said
    again = murmur("keys", str(folder))
    assert again.exit_code == 2
    assert "authority.pem: File exists" in again.stderr


def test_an_address_with_a_port_is_refused(tmp_path: Path) -> None:
    result = murmur("keys", str(tmp_path / "keys"), "--address", "10.0.0.1:7447")
    assert result.exit_code == 2
    assert "address = '10.0.0.1:7447': must be a host's name or IP address" in result.stderr
    assert not (tmp_path / "keys").exists()


def test_a_hub_by_hand_asks_for_the_keys_that_were_made(tmp_path: Path) -> None:
    murmur("keys", str(tmp_path / "keys"), "--robots", "1")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        listen = f"127.0.0.1:{probe.getsockname()[1]}"
    folder = tmp_path / "credentials"
    is_there = threading.Event()
    hub = threading.Thread(
        target=serve_netshaper,
        args=(parse({"map": "em", "robots": 1}), listen, folder, lambda _: is_there.set(), tmp_path / "keys"),
    )
    hub.start()
    assert is_there.wait(30)
    credential = Credential.read(folder / "lab.json")
    assert credential.hub == f"tls/{listen}"
    lab = join(credential)
    lab.put(Keys(credential.run).control_tx(names.LAB), pack(Bye()))
    lab.close()
    hub.join(30)
    assert not hub.is_alive()


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ("", "credential on standard input: not JSON"),
        ("{}", "credential on standard input: needs the texts run, name, hub, password"),
        (
            '{"run": "a", "name": "lab", "hub": "tcp/127.0.0.1:1", "password": "x"}',
            "'lab' is not a robot's name",
        ),
    ],
)
def test_a_robot_s_credential_on_standard_input_is_checked(said: str, message: str) -> None:
    result = CliRunner().invoke(app, ["run", "agent", "--credential", "-"], input=said)
    assert result.exit_code == 2
    assert message in result.stderr


def test_keys_of_a_smaller_run_are_refused_by_the_hub(tmp_path: Path) -> None:
    murmur("keys", str(tmp_path / "keys"), "--robots", "1")
    with pytest.raises(ValueError, match=r"r1\.pem: No such file"):
        serve_netshaper(
            parse({"map": "em", "robots": 2}),
            "127.0.0.1:7447",
            tmp_path / "credentials",
            print,
            tmp_path / "keys",
        )
    assert not (tmp_path / "credentials").exists()
