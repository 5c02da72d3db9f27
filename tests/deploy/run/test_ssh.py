"""The launcher's end and the far end together, on one host: `ssh` is a script that runs what it is given."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from deploy.run.exploration import explore
from deploy.run.hosts import Hosts, parse
from deploy.run.remote_agents import hello
from deploy.run.ssh import Fleet, HostError
from deploy.scenario import scenario as scenarios
from deploy.scenario.scenario import ScenarioError
from netshaper.hub import open_hub
from protocol import keys as names
from protocol.bus import Bus, Message
from protocol.keys import Keys

ROOT = Path(__file__).parents[3]
MURMUR = f"exec env PYTHONPATH={ROOT} {sys.executable} -m deploy.commands.main"
PATIENCE_S = 60


@pytest.fixture(autouse=True)
def ssh_that_stays_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "bin"
    folder.mkdir()
    script = folder / "ssh"
    script.write_text('#!/bin/sh\nfor last; do :; done\nexec sh -c "$last"\n')
    script.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}:{os.environ['PATH']}")


def hosts(*commands: str) -> Hosts:
    listed = [{"name": f"h{n}", "robots": 1, "command": command} for n, command in enumerate(commands)]
    return parse({"address": "127.0.0.1", "host": listed})


def wait_until(true: Callable[[], object]) -> None:
    deadline = time.monotonic() + PATIENCE_S
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("murmurr-is-not-there", r"h0: there is no Murmur: .*not found; install it there, or say in"),
        ("echo no; exit 255;", r"h0: ssh cannot get to h0: no$"),
        (
            "echo Welcome; echo 'No such command' >&2; exit 2;",
            r"takes no robots \(exit code 2\): No such command",
        ),
        (
            """echo Welcome; echo '{"murmur": "0.0.9", "code": "abc"}'; cat; exit;""",
            rf"h0: has Murmur 0\.0\.9 of other code \(abc; here \S+, {hello()['code']}\): install the same",
        ),
    ],
)
def test_a_host_that_cannot_take_robots_says_why(command: str, message: str) -> None:
    with pytest.raises(HostError, match=message), Fleet(hosts(command), 3):
        pytest.fail("it was taken for a host")


def test_all_hosts_that_cannot_take_robots_are_named_at_once() -> None:
    with pytest.raises(HostError) as caught, Fleet(hosts("nothing-a", "nothing-b"), 3):
        pytest.fail("they were taken for hosts")
    first, second = str(caught.value).splitlines()
    assert first.startswith("host h0: ")
    assert second.startswith("host h1: ")


def test_a_host_that_says_nothing_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("deploy.run.ssh.HELLO_S", 0.2)
    with pytest.raises(HostError, match=r"h0: said nothing for 0\.2 s"), Fleet(hosts("cat;"), 3):
        pytest.fail("it was taken for a host")


def test_other_versions_of_packages_are_told_of_and_no_hindrance() -> None:
    there = hello() | {"versions": hello()["versions"] | {"numpy": "1.0"}}
    command = f"echo '{json.dumps(there)}'; cat; exit;"
    told: list[str] = []
    with Fleet(hosts(command), 3, told.append):
        pass
    assert len(told) == 1
    assert told[0].startswith("host h0: has numpy 1.0, here it is ")


def test_what_far_robots_print_and_how_they_end_comes_back(tmp_path: Path) -> None:
    """Two robots lose their hub before a run begins; each says so in its log, and that it is its end."""
    logs = tmp_path / "logs"
    logs.mkdir()
    both = parse({"address": "127.0.0.1", "host": [{"name": "h0", "robots": 2, "command": MURMUR}]})
    with Fleet(both, 2) as fleet:
        rendezvous = fleet.rendezvous
        hub = open_hub(rendezvous.run, rendezvous.endpoint, rendezvous.credentials, rendezvous.certificate)
        try:
            with fleet.running(rendezvous.credentials, logs):
                presence = {Keys(rendezvous.run).presence(names.robot(n)) for n in range(2)}
                heard = [hub.receive(PATIENCE_S), hub.receive(PATIENCE_S)]
                assert {message.key for message in heard if isinstance(message, Message)} == presence
                hub.close()
                deaths: dict[str, str] = {}
                wait_until(lambda: fleet.look(deaths) or len(deaths) == 2)
        finally:
            hub.close()
    lost = "the connection to the hub was lost"
    assert deaths == {f"r{n}": f"on h0: exit code 3; last output: r{n}: {lost}" for n in range(2)}
    assert {path.name: path.read_text() for path in logs.iterdir()} == {
        f"r{n}.log": f"r{n}: {lost}\n" for n in range(2)
    }


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are found by /proc")
def test_far_robots_die_with_a_far_end_that_is_killed(tmp_path: Path) -> None:
    one = parse({"address": "127.0.0.1", "host": [{"name": "h0", "robots": 1, "command": MURMUR}]})
    with Fleet(one, 1) as fleet:
        rendezvous = fleet.rendezvous
        presence = Keys(rendezvous.run).presence("r0")
        with (
            closing(
                open_hub(rendezvous.run, rendezvous.endpoint, rendezvous.credentials, rendezvous.certificate)
            ) as hub,
            fleet.running(rendezvous.credentials, tmp_path),
        ):
            assert hub.receive(PATIENCE_S) == Message(presence, b"1")
            (remote_agents,) = (pid for pid in children() if title(pid) == "murmur robots")
            os.kill(remote_agents, signal.SIGKILL)
            assert hub.receive(PATIENCE_S) == Message(presence, b"0")
            deaths: dict[str, str] = {}
            wait_until(lambda: fleet.look(deaths) or deaths)
    assert list(deaths) == ["h0"]
    assert deaths["h0"].endswith("; with it r0")


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are found by /proc")
def test_a_router_that_dies_is_named_with_the_robots_that_went_with_it(tmp_path: Path) -> None:
    host = {"name": "h0", "robots": 2, "command": MURMUR, "router": True}
    routed = parse({"address": "127.0.0.1", "host": [host]})
    with Fleet(routed, 3) as fleet:
        rendezvous = fleet.rendezvous
        assert not {"r0", "r1"} & rendezvous.credentials.keys(), "they cannot pass the router by"
        presences = {Keys(rendezvous.run).presence(name) for name in ("r0", "r1")}
        with (
            closing(
                open_hub(rendezvous.run, rendezvous.endpoint, rendezvous.credentials, rendezvous.certificate)
            ) as hub,
            fleet.running(rendezvous.credentials, tmp_path),
        ):
            assert heard(hub, 2) == {(presence, b"1") for presence in presences}
            (victim,) = (pid for pid in all_pids() if title(pid) == "murmur router@h0" and is_ours(pid))
            os.kill(victim, signal.SIGKILL)
            assert heard(hub, 2) == {(presence, b"0") for presence in presences}
            deaths: dict[str, str] = {}
            wait_until(lambda: fleet.look(deaths) or deaths)
            wait_until(
                lambda: (
                    not any(title(pid) in ("murmur r0", "murmur r1") for pid in all_pids() if is_ours(pid))
                )
            )
            fleet.look(deaths)
    assert deaths == {"router@h0": "killed by SIGKILL, no output; with it r0, r1"}


def heard(hub: Bus, count: int) -> set[tuple[str, bytes]]:
    """The next messages that the hub hears."""
    messages = [hub.receive(PATIENCE_S) for _ in range(count)]
    return {(message.key, message.payload) for message in messages if message is not None}


def all_pids() -> list[int]:
    return [int(path.name) for path in Path("/proc").glob("[0-9]*")]


def is_ours(pid: int) -> bool:
    """Whether a process descends from this one."""
    while pid > 1:
        if pid == os.getpid():
            return True
        try:
            pid = int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
        except OSError:
            return False
    return False


def children() -> list[int]:
    return [
        int(stat.parent.name)
        for stat in Path("/proc").glob("[0-9]*/stat")
        if int(stat.read_text().rpartition(")")[2].split()[1]) == os.getpid()
    ]


def title(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode().strip()
    except OSError:
        return "gone"


@pytest.mark.parametrize("order", ["", "nonsense\n", '{"credentials": [{}]}\n'])
def test_a_far_end_that_is_told_nonsense_or_nothing_ends(order: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "deploy.commands.main", "run", "agents"],
        input=order,
        capture_output=True,
        text=True,
        cwd=ROOT,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.stdout.count("\n") == 1
    assert done.returncode == (2 if order else 0)
    assert ("murmur: " in done.stderr) == bool(order)


def test_hosts_and_the_memory_bus_do_not_go_together() -> None:
    scenario = scenarios.parse({"bus": "memory"})
    with pytest.raises(ScenarioError, match=r"^bus = 'memory': runs in one process"):
        explore(scenario, keep=False, hosts=hosts("true"))


def test_an_address_that_is_not_this_hosts_is_refused_before_anything_starts() -> None:
    elsewhere = hosts("true").model_copy(update={"address": "192.0.2.7"})
    with pytest.raises(ScenarioError, match=r"^address = '192\.0\.2\.7': the hub cannot listen there: "):
        Fleet(elsewhere, 3)
