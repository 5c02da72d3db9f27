"""The launcher and remote agents together on one host: `ssh` is a script that runs its last argument."""

from __future__ import annotations

import json
import os
import re
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
from deploy.scenario.errors import ScenarioError
from netshaper.hub import open_hub
from protocol import keys as names
from protocol.bus import Bus, Message
from protocol.keys import Keys

ROOT = Path(__file__).parents[3]
MURMUR = f"exec env PYTHONPATH={ROOT} {sys.executable} -m deploy.commands.main"
TIMEOUT_S = 60


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
    deadline = time.monotonic() + TIMEOUT_S
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (
            "murmurr-is-not-there",
            r"h0: Murmur was not found: .*not found; install it there, or set command in",
        ),
        (
            "echo 'No host key is known' >&2; echo 'Host key verification failed.' >&2; exit 255;",
            r"h0: ssh cannot reach h0: No host key is known\nHost key verification failed\.\n"
            r"ssh must connect without a prompt; test it with: ssh h0 true$",
        ),
        (
            "echo Welcome; echo 'No such command' >&2; exit 2;",
            r"run agents failed \(exit code 2\): No such command",
        ),
        (
            """echo Welcome; echo '{"murmur": "0.0.9", "code": "abc"}'; cat; exit;""",
            rf"h0: has different code, Murmur 0\.0\.9 \(abc; here \S+, {hello({})['code']}\): install the same",
        ),
    ],
)
def test_error_names_the_host_that_cannot_run_robots_and_the_cause(command: str, message: str) -> None:
    with pytest.raises(HostError, match=message), Fleet(hosts(command), 3):
        pytest.fail("the host was accepted")


def test_error_names_all_hosts_that_cannot_run_robots() -> None:
    with pytest.raises(HostError) as caught, Fleet(hosts("nothing-a", "nothing-b"), 3):
        pytest.fail("the hosts were accepted")
    first, second = str(caught.value).splitlines()
    assert first.startswith("host h0: ")
    assert second.startswith("host h1: ")


def test_silent_host_times_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("deploy.run.ssh.HELLO_S", 0.2)
    with pytest.raises(HostError, match=r"h0: no reply within 0\.2 s"), Fleet(hosts("cat;"), 3):
        pytest.fail("the host was accepted")


@pytest.mark.parametrize("days", [-2, 40])
def test_a_host_whose_clock_is_wrong_is_refused_because_certificates_would_not_be_valid_there(
    days: int,
) -> None:
    there = hello({})
    there["clock"] += days * 86_400
    command = f"echo '{json.dumps(there)}'; cat; exit;"
    message = (
        r"host h0: its clock shows 20\S+ \S+ UTC, and that of this host 20\S+ \S+ UTC: .*; set the clock$"
    )
    with pytest.raises(HostError, match=message), Fleet(hosts(command), 3):
        pytest.fail("the host was accepted")


def test_other_versions_of_packages_cause_a_warning_only() -> None:
    there = hello({}) | {"versions": hello({})["versions"] | {"numpy": "1.0"}}
    command = f"echo '{json.dumps(there)}'; cat; exit;"
    warnings: list[str] = []
    with Fleet(hosts(command), 3, warnings.append):
        pass
    assert len(warnings) == 1
    assert warnings[0].startswith("host h0: has numpy 1.0, this host has ")


def test_shell_startup_files_may_print_a_title_without_a_newline() -> None:
    with Fleet(hosts(f"printf '\\033]0;h0\\007'; {MURMUR}"), 3):
        pass


FAKE_HOST = """
import sys
def send(*parts):
    for part in parts:
        sys.stdout.write(part)
    sys.stdout.flush()
"""
ACCEPTED = "import json; from deploy.run.remote_agents import hello; send(json.dumps(hello({})) + chr(10))\n"


def fake_host(tmp_path: Path, code: str) -> Hosts:
    """A host that runs `code` instead of Murmur, then waits for the end of its input."""
    script = tmp_path / "fake.py"
    script.write_text(FAKE_HOST + code + "\nsys.stdin.read()\n")
    return hosts(f"exec env PYTHONPATH={ROOT} {sys.executable} {script};")


@pytest.mark.parametrize(
    ("code", "message"),
    [
        (
            """send('{"murmur": "1", "code": "a", "versions": []}\\n')""",
            "sent a malformed message: Expected `object`",
        ),
        ("""send('{"murmur": "1", "code": 5}\\n')""", "sent a malformed message: Expected `str`, got `int`"),
        ("""send('{"murmur": ' + 100_000 * '[' + '\\n')""", "sent a malformed message: "),
        ("""send('{"murmur": "1", "x": ' + 100_000 * '[' + '\\n')""", "sent a malformed message: "),
        ("send(*(1000 * 'x' for _ in range(10_000)))", r"sent a line of more than \d+ bytes"),
        ("send('[host] welcome\\n'); sys.exit(2)", r"failed \(exit code 2\): \[host\] welcome;"),
        ("import os; os.close(1); sys.stdout = None", "closed its output"),
        ("""send('{"murmur": "1", "code": "\\\\u001b[2J"}\\n')""", r"different code, Murmur 1 \(\[2J;"),
    ],
)
def test_a_host_that_breaks_the_protocol_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, message: str
) -> None:
    monkeypatch.setattr("deploy.run.ssh.END_S", 0.2)
    with pytest.raises(HostError, match=f"^host h0: .*{message}"), Fleet(fake_host(tmp_path, code), 3):
        pytest.fail("the host was accepted")


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("""send('{"robot": "r0", "exit": "x"}\\n')""", "sent a malformed message: "),
        (
            """send('{"robot": "r0", "exit": 3, "report": ' + 90_000 * '[' + '\\n')""",
            "sent a malformed message: ",
        ),
        ("while True: send(10_000 * 'x')", "sent a line of more than"),
        ("while True: send(1000 * 'x' + '\\n')", "sent more than 1 MiB"),
        ("while True: sys.stderr.write(1000 * 'x' + '\\n')", "sent more than 1 MiB"),
    ],
)
def test_a_host_that_breaks_the_protocol_during_the_run_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, message: str
) -> None:
    monkeypatch.setattr("deploy.run.ssh.MAX_OUTPUT", 2**19, raising=False)
    deaths: dict[str, str] = {}
    with (
        Fleet(fake_host(tmp_path, ACCEPTED + "sys.stdin.readline()\n" + code), 1) as fleet,
        fleet.running(fleet.rendezvous.credentials, tmp_path / "logs"),
    ):
        wait_until(lambda: fleet.check(deaths) or deaths)
    assert list(deaths) == ["h0"]
    assert re.match(f"{message}.*; with it r0$", deaths["h0"])


def test_the_log_of_a_remote_robot_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("deploy.run.ssh.MAX_LOG", 2**20, raising=False)
    code = """
for n in range(40):
    send(json.dumps({"robot": "r0", "log": 100_000 * "x"}) + chr(10))
send(json.dumps({"robot": "r0", "exit": 1, "report": "no " + chr(27) + "[2Jmemory"}) + chr(10))
sys.exit()
"""
    (tmp_path / "logs").mkdir()
    deaths: dict[str, str] = {}
    with (
        Fleet(fake_host(tmp_path, ACCEPTED + "sys.stdin.readline()\n" + code), 1) as fleet,
        fleet.running(fleet.rendezvous.credentials, tmp_path / "logs"),
    ):
        wait_until(lambda: fleet.check(deaths) or deaths)
    assert deaths == {"r0": "on h0: no [2Jmemory"}
    log = (tmp_path / "logs" / "r0.log").read_text()
    assert log == 2**20 * "x" + "\n[host h0: output beyond 1 MiB is dropped]\n"


def test_launcher_receives_output_and_exit_codes_of_remote_robots(tmp_path: Path) -> None:
    """Two robots lose their hub before the run begins; each writes this to its log and ends."""
    logs = tmp_path / "logs"
    logs.mkdir()
    both = parse({"address": "127.0.0.1", "host": [{"name": "h0", "robots": 2, "command": MURMUR}]})
    with Fleet(both, 2) as fleet:
        rendezvous = fleet.rendezvous
        hub = open_hub(rendezvous.run, rendezvous.endpoint, rendezvous.credentials, rendezvous.certificate)
        try:
            with fleet.running(rendezvous.credentials, logs):
                presence = {Keys(rendezvous.run).presence(names.robot(n)) for n in range(2)}
                received = [hub.receive(TIMEOUT_S), hub.receive(TIMEOUT_S)]
                assert {message.key for message in received if isinstance(message, Message)} == presence
                hub.close()
                deaths: dict[str, str] = {}
                wait_until(lambda: fleet.check(deaths) or len(deaths) == 2)
        finally:
            hub.close()
    lost = "the connection to the hub was lost"
    assert deaths == {f"r{n}": f"on h0: exit code 3; last output: r{n}: {lost}" for n in range(2)}
    assert {path.name: path.read_text() for path in logs.iterdir()} == {
        f"r{n}.log": f"r{n}: {lost}\n" for n in range(2)
    }


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are found by /proc")
def test_remote_robots_end_when_their_parent_is_killed(tmp_path: Path) -> None:
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
            assert hub.receive(TIMEOUT_S) == Message(presence, b"1")
            (remote_agents,) = (pid for pid in children() if title(pid) == "murmur robots")
            os.kill(remote_agents, signal.SIGKILL)
            assert hub.receive(TIMEOUT_S) == Message(presence, b"0")
            deaths: dict[str, str] = {}
            wait_until(lambda: fleet.check(deaths) or deaths)
    assert list(deaths) == ["h0"]
    assert deaths["h0"].endswith("; with it r0")


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are found by /proc")
@pytest.mark.long
def test_crash_report_of_a_router_names_its_robots(tmp_path: Path) -> None:
    host = {"name": "h0", "robots": 2, "command": MURMUR, "router": True}
    routed = parse({"address": "127.0.0.1", "host": [host]})
    with Fleet(routed, 3) as fleet:
        rendezvous = fleet.rendezvous
        assert not {"r0", "r1"} & rendezvous.credentials.keys(), "they must join through the router"
        presences = {Keys(rendezvous.run).presence(name) for name in ("r0", "r1")}
        with (
            closing(
                open_hub(rendezvous.run, rendezvous.endpoint, rendezvous.credentials, rendezvous.certificate)
            ) as hub,
            fleet.running(rendezvous.credentials, tmp_path),
        ):
            assert receive(hub, 2) == {(presence, b"1") for presence in presences}
            (victim,) = (pid for pid in all_pids() if title(pid) == "murmur router@h0" and is_ours(pid))
            os.kill(victim, signal.SIGKILL)
            assert receive(hub, 2) == {(presence, b"0") for presence in presences}
            deaths: dict[str, str] = {}
            wait_until(lambda: fleet.check(deaths) or deaths)
            wait_until(
                lambda: (
                    not any(title(pid) in ("murmur r0", "murmur r1") for pid in all_pids() if is_ours(pid))
                )
            )
            fleet.check(deaths)
    assert deaths == {"router@h0": "killed by SIGKILL, no output; with it r0, r1"}


def receive(hub: Bus, count: int) -> set[tuple[str, bytes]]:
    """Return the next messages that the hub receives."""
    messages = [hub.receive(TIMEOUT_S) for _ in range(count)]
    return {(message.key, message.payload) for message in messages if message is not None}


def all_pids() -> list[int]:
    return [int(path.name) for path in Path("/proc").glob("[0-9]*")]


def is_ours(pid: int) -> bool:
    """Return whether a process descends from this one."""
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


@pytest.mark.parametrize("order", ["", "malformed\n", '{"credentials": [{}]}\n'])
def test_remote_agents_end_after_malformed_or_empty_input(order: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "deploy.commands.main", "run", "agents"],
        input=order,
        capture_output=True,
        text=True,
        cwd=ROOT,
        timeout=TIMEOUT_S,
        check=False,
    )
    assert done.stdout.startswith("\n{") and done.stdout.count("\n") == 2
    assert done.returncode == (2 if order else 0)
    assert ("murmur: " in done.stderr) == bool(order)


def test_hosts_require_the_zenoh_bus() -> None:
    scenario = scenarios.parse({"bus": "memory"})
    with pytest.raises(ScenarioError, match=r"^bus = 'memory': runs in one process"):
        explore(scenario, keep=False, hosts=hosts("true"))


def test_address_of_another_host_is_rejected_before_anything_starts() -> None:
    elsewhere = hosts("true").model_copy(update={"address": "192.0.2.7"})
    with pytest.raises(ScenarioError, match=r"^address = '192\.0\.2\.7': the hub cannot listen there: "):
        Fleet(elsewhere, 3)


def test_a_host_that_lacks_a_plug_in_or_has_another_one_is_rejected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    source = "from agent.encodings.none import NoEncoding\n\n\nclass Mute(NoEncoding):\n    name = 'mute'\n"
    for folder in (here, there):
        folder.mkdir()
    (here / "mute_maps.py").write_text(source)
    monkeypatch.chdir(here)
    plugins = {"map_encoding": "mute_maps:Mute"}
    command = hosts(f"cd {there} && {MURMUR}")
    missing = (
        r"h0: map encoding 'mute_maps:Mute': No module named 'mute_maps'; .*; install it there, or put its"
    )
    with pytest.raises(HostError, match=missing), Fleet(command, 3, plugins=plugins):
        pytest.fail("the host was accepted")
    (there / "mute_maps.py").write_text(source + "    loud = False\n")
    with (
        pytest.raises(HostError, match=r"h0: has other code of the map_encoding"),
        Fleet(command, 3, plugins=plugins),
    ):
        pytest.fail("the host was accepted")
    (there / "mute_maps.py").write_text(source)
    with Fleet(command, 3, plugins=plugins):
        pass
