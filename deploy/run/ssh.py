"""Robots on other hosts, from the launcher's side: one `ssh` a host, with `murmur run agents` at its far end.

All hosts are reached and asked for their code before anything else starts. Credentials go through standard input; when
that is closed, by us or by our end, the far end ends its robots (`deploy.run.remote_agents`).
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, Self

from deploy.run.hosts import Host, Hosts
from deploy.run.processes import BROKEN_OFF
from deploy.run.remote_agents import hello
from deploy.run.rendezvous import by_certificates
from deploy.scenario.scenario import ScenarioError
from protocol import keys as names
from protocol.zenoh_bus import Credential

CONNECT_S = 10
"""How long ssh may take to be let in."""
HELLO_S = 60.0
"""How long a host may take to say which Murmur it has."""
ALIVE_S, ALIVE_TIMES = 5, 3
"""ssh asks a silent host so often, so many times, before it gives up."""
END_S = 3.0
"""How long the far ends may take to end by themselves."""
HUNG_UP_S = 5.0
"""How long they may take once they are told to: they terminate their robots, then kill them."""
NO_COMMAND = (126, 127)
UNREACHED = 255
"""Exit code of ssh itself."""


class HostError(ScenarioError):
    """A host that cannot take robots; the message names it, and says why."""


class Fleet:
    """The robots of a run that are on other hosts; a context manager that leaves none behind.

    Parameters
    ----------
    hosts : Hosts
        The other hosts.
    robots : int
        How many robots the run has.
    tell : callable, optional
        Hears of what does not stop the run: other versions of packages on a host.

    Raises
    ------
    ScenarioError
        The hosts have more robots than the run, or the hub cannot listen at their address of it.

    Attributes
    ----------
    meeting : Meeting
        Where all processes of the run meet, made for this run alone.
    """

    def __init__(self, hosts: Hosts, robots: int, tell: Callable[[str], object] = lambda _: None) -> None:
        placing = {name: list(map(names.robot, there)) for name, there in hosts.placing(robots).items()}
        routers = {names.router(host.name): placing[host.name] for host in hosts.host if host.router}
        self.rendezvous = by_certificates(hosts.address, hosts.port, robots, routers)
        self._links = [_Link(host, placing[host.name]) for host in hosts.host]
        self._tell = tell

    @property
    def robots(self) -> set[str]:
        """Names of the robots that are on other hosts."""
        return {robot for link in self._links for robot in link.robots}

    def __enter__(self) -> Self:
        """Reach all hosts.

        Raises
        ------
        HostError
            Some cannot be reached, or have no Murmur, or another one; all such hosts are named.
        """
        try:
            for link in self._links:
                link.open()
            self._check()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._hang_up()  # who has run and ended is gone already
        self._end()

    @contextlib.contextmanager
    def running(self, credentials: Mapping[str, Credential], logs: Path) -> Iterator[None]:
        """Have the robots run until they end, and leave none when this ends.

        What they print goes to ``NAME.log`` in `logs`, what ssh says to ``HOST.log``.
        """
        for link in self._links:
            link.start([credentials[name] for name in link.clients], logs)
        try:
            yield
        finally:
            self._end()

    def _end(self) -> None:
        """Wait for the far ends, have them end, then end their ssh."""
        _await_all(self._links, END_S)
        self._hang_up()
        _await_all(self._links, HUNG_UP_S)
        for link in self._links:
            link.close()

    def look(self, deaths: dict[str, str]) -> None:
        """Add to `deaths` the robots, and the hosts, that have ended before their time."""
        for link in self._links:
            for name, words in link.deaths().items():
                deaths.setdefault(name, words)

    def forget_who_left(self, deaths: dict[str, str]) -> None:
        """Take those from `deaths` who ended because the hub had gone."""
        for link in self._links:
            for name in link.broken_off:
                deaths.pop(name, None)

    def give_up(self, name: str) -> None:
        """Have a robot ended, which is not missed."""
        for link in self._links:
            if name in link.robots:
                link.give_up(name)

    def _hang_up(self) -> None:
        for link in self._links:
            link.hang_up()

    def _check(self) -> None:
        deadline = time.monotonic() + HELLO_S
        faults = []
        for link in self._links:
            try:
                for line in link.differences(deadline):
                    self._tell(line)
            except HostError as error:
                faults.append(str(error))
        if faults:
            raise HostError("\n".join(faults))


class _Link:
    """One ssh, and the robots at its far end; perhaps a router between them and the hub.

    Attributes
    ----------
    clients : list of str
        Who of them joins at the hub: the router, or the robots themselves.
    broken_off : set of str
        Who ended because it had lost the hub.
    """

    def __init__(self, host: Host, robots: list[str]) -> None:
        self.robots = robots
        self.clients = [names.router(host.name)] if host.router else robots
        self.broken_off: set[str] = set()
        self._host = host
        self._ssh: subprocess.Popen[bytes] | None = None
        self._said = tempfile.TemporaryFile()  # noqa: SIM115  closed by `close`
        self._hello: queue.Queue[dict[str, Any] | None] = queue.Queue()
        self._noise: list[str] = []
        self._ended: dict[str, str] = {}
        self._lost_router = ""
        self._logs: Path | None = None
        self._ear = threading.Thread(target=self._listen, name=f"ssh {host.name}", daemon=True)

    def open(self) -> None:
        """Start ssh; in a session of its own, so that Ctrl-C is the launcher's affair."""
        try:
            self._ssh = subprocess.Popen(
                command_line(self._host),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._said,
                start_new_session=True,
            )
        except FileNotFoundError:
            raise HostError("ssh is not installed here; robots on other hosts are started by it") from None
        self._ear.start()

    def differences(self, deadline: float) -> Iterable[str]:
        """Wait for the far end's hello; say in which packages it differs.

        Raises
        ------
        HostError
            There is none, or its code is not ours.
        """
        where = f"host {self._host.name}"
        try:
            there = self._hello.get(timeout=max(0.0, deadline - time.monotonic()))
        except queue.Empty:
            raise HostError(f"{where}: said nothing for {HELLO_S:g} s: {self._last_words()}") from None
        if there is None:
            raise HostError(f"{where}: {self._why_silent()}")
        here = hello()
        if there.get("code") != here["code"]:
            raise HostError(
                f"{where}: has Murmur {there.get('murmur')} of other code ({there.get('code')}; "
                f"here {here['murmur']}, {here['code']}): install the same on both"
            )
        theirs = there.get("versions", {})
        for package, ours in here["versions"].items():
            if theirs.get(package) != ours:
                yield f"{where}: has {package} {theirs.get(package)}, here it is {ours}; the digest may differ"

    def start(self, credentials: list[Credential], logs: Path) -> None:
        self._logs = logs
        self._order({"credentials": [asdict(credential) for credential in credentials]})

    def deaths(self) -> dict[str, str]:
        """Robots that ended before their time; the host itself if it is gone and they with it."""
        ended = self._ended.copy()
        found = {name: f"on {self._host.name}: {words}" for name, words in ended.items() if words}
        if self._lost_router:
            found[names.router(self._host.name)] = self._lost_router
        missing = [name for name in self.robots if name not in ended]
        if missing and self._ssh is not None and self._ssh.poll() is not None and not self._ear.is_alive():
            found[self._host.name] = f"{self._why_gone()}; with it {', '.join(missing)}"
        return found

    def give_up(self, name: str) -> None:
        """Have the far end end a robot, once; it need not say how."""
        if name not in self._ended and self._ssh is not None and self._ssh.stdin is not None:
            self._ended[name] = ""
            self._order({"end": name})

    def _order(self, order: Mapping[str, Any]) -> None:
        assert self._ssh is not None and self._ssh.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # it is gone: `deaths` tells
            self._ssh.stdin.write(json.dumps(order).encode() + b"\n")
            self._ssh.stdin.flush()

    def is_over(self) -> bool:
        return self._ssh is None or self._ssh.poll() is not None

    def hang_up(self) -> None:
        """Close the far end's standard input: it ends its robots then."""
        if self._ssh is not None and self._ssh.stdin is not None:
            with contextlib.suppress(BrokenPipeError):
                self._ssh.stdin.close()

    def close(self) -> None:
        if self._ssh is not None:
            for end in (self._ssh.terminate, self._ssh.kill):
                if not self.is_over():
                    end()
                    _await_all([self], 1.0)
            self._ear.join()
            if self._ssh.stdout is not None:
                self._ssh.stdout.close()
            self._ssh = None
            said = self._words()
            if said and self._logs is not None:
                self._logs.mkdir(parents=True, exist_ok=True)
                (self._logs / f"{self._host.name}.log").write_text(said, encoding="utf-8")
        self._said.close()

    def _listen(self) -> None:
        """Take what the far end says, line by line, until it is gone (runs on a thread)."""
        assert self._ssh is not None and self._ssh.stdout is not None
        greeted = False
        for line in self._ssh.stdout:
            said = _read(line)
            if not greeted and "murmur" in said:
                greeted = True
                self._hello.put(said)
            elif greeted and said.get("robot") in {*self.robots, *self.clients}:
                self._take(said)
            else:
                self._noise = [*self._noise[-9:], line.decode(errors="replace").strip()]
        self._hello.put(None)

    def _take(self, said: Mapping[str, Any]) -> None:
        name = said["robot"]
        if "log" in said and self._logs is not None:
            with (self._logs / f"{name}.log").open("a", encoding="utf-8") as file:
                file.write(str(said["log"]))
        elif "exit" in said and name not in self._ended:
            code = said["exit"]
            words = str(said.get("words") or f"exit code {code}") if code else ""
            if code == BROKEN_OFF:
                self.broken_off.add(name)
            missing = [robot for robot in self.robots if robot not in self._ended]
            if name in self.robots:
                self._ended[name] = "" if self._lost_router else words
            elif words and missing:
                self._lost_router = f"{words}; with it {', '.join(missing)}"

    def _why_silent(self) -> str:
        """Why there was no hello."""
        code = self._ssh.wait() if self._ssh is not None else None
        if code == UNREACHED:
            return f"ssh cannot get to {self._host.target}: {self._last_words()}"
        if code in NO_COMMAND:
            return (
                f"there is no Murmur: {self._last_words()}; install it there, or say in the hosts file by which "
                f"command it is called (now: {self._host.command})"
            )
        return (
            f"what {self._host.command} calls there takes no robots (exit code {code}): {self._last_words()}; "
            "install the same Murmur on both"
        )

    def _why_gone(self) -> str:
        code = self._ssh.poll() if self._ssh is not None else None
        what = (
            "the connection was lost" if code == UNREACHED else f"its robots' starter ended, exit code {code}"
        )
        return f"{what}: {self._last_words()}"

    def _words(self) -> str:
        """What ssh and the far end's errors said."""
        size = os.fstat(self._said.fileno()).st_size
        return os.pread(self._said.fileno(), size, 0).decode(errors="replace")

    def _last_words(self) -> str:
        lines = [line.strip() for line in [*self._noise, *self._words().splitlines()] if line.strip()]
        return lines[-1] if lines else "without a word"


def command_line(host: Host) -> list[str]:
    """The ssh that reaches a host. It asks for no password, and no credential is on it."""
    given = [part for option in host.options for part in ("-o", option)]
    port = ["-p", str(host.port)] if host.port is not None else []
    plain = [
        "BatchMode=yes",
        f"ConnectTimeout={CONNECT_S}",
        f"ServerAliveInterval={ALIVE_S}",
        f"ServerAliveCountMax={ALIVE_TIMES}",
        "ControlPath=none",
        "ClearAllForwardings=yes",
        "LogLevel=ERROR",
    ]
    # Of an option that is given twice ssh takes the first.
    ours = [part for option in plain for part in ("-o", option)]
    return ["ssh", "-T", "-a", "-x", *given, *ours, *port, "--", host.target, f"{host.command} run agents"]


def _read(line: bytes) -> dict[str, Any]:
    """What a far end says in a line; empty if that is none of its words."""
    try:
        said = json.loads(line)
    except ValueError:
        return {}
    return said if isinstance(said, dict) else {}


def _await_all(links: Iterable[_Link], timeout_s: float) -> None:
    """Wait until all are over, so long at most."""
    deadline = time.monotonic() + timeout_s
    while not all(link.is_over() for link in links) and time.monotonic() < deadline:
        time.sleep(0.02)
