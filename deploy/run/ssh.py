"""Robots on other hosts, seen from the launcher: one `ssh` per host, which runs `murmur run agents` there.

The launcher connects to all hosts and compares their code before anything else starts. It sends credentials through
standard input. When that is closed, or the launcher ends, the remote process ends its robots
(`deploy.run.remote_agents`).
"""

from __future__ import annotations

import contextlib
import json
import queue
import shlex
import subprocess
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import IO, Annotated, Any, Self

import msgspec

from deploy.run.exit_codes import BROKEN_OFF
from deploy.run.hosts import Host, Hosts
from deploy.run.remote_agents import MAX_LINE, MAX_LOG, hello
from deploy.run.rendezvous import by_certificates
from deploy.scenario.errors import ScenarioError
from protocol import keys as names
from protocol.zenoh_bus import Credential

CONNECT_S = 10
"""Time limit for ssh to connect."""
HELLO_S = 60.0
"""Time limit for a host to report its version of Murmur."""
ALIVE_S, ALIVE_TIMES = 5, 3
"""Seconds between ssh's keepalive messages to a silent host, and how many may stay unanswered."""
END_S = 3.0
"""Time limit for the remote processes to end by themselves."""
HUNG_UP_S = 5.0
"""Time limit for them to end on request: they terminate their robots, then kill them."""
NO_COMMAND = (126, 127)
"""Exit codes of a shell that cannot run the command."""
UNREACHED = 255
"""Exit code of ssh if the connection fails."""
DAY_S = 86_400
CLOCK_BEHIND_S, CLOCK_AHEAD_S = DAY_S, 29 * DAY_S
"""How far another host's clock may be behind or ahead, so that certificates are valid there for at least a day."""

MAX_OUTPUT = 8 * MAX_LOG
"""Maximum bytes that a host sends, per robot: JSON and UTF-8 may lengthen its output."""
MAX_ERRORS, MAX_TEXT, MAX_LINES = 2**16, 2000, 20
"""Bytes that are kept of a host's last error output, characters of a line or a report from it, and lines in errors."""


class _Hello(msgspec.Struct):
    """First message of a remote process: the versions of Murmur, its code and its dependencies."""

    murmur: str
    code: str
    versions: dict[str, str] = {}
    plugins: dict[str, str] = {}
    """Digests of the code of plug-ins, by setting."""
    missing: dict[str, str] = {}
    """Why plug-ins cannot be imported, by setting."""
    clock: Annotated[int, msgspec.Meta(ge=0, lt=2**35)] = 0
    """The time there, in seconds since 1970."""


class _Event(msgspec.Struct):
    """Output of a robot, or its end: the exit code and the report of a crash."""

    robot: str
    log: str = ""
    exit: Annotated[int, msgspec.Meta(ge=-255, le=255)] | None = None
    report: str = ""


class HostError(ScenarioError):
    """A host cannot run robots; the message names the host and the cause."""


class Fleet:
    """The robots of a run on other hosts; a context manager that ends all of them.

    `notify` is called with each warning: a host has other versions of some packages. `plugins` are those that robots
    import, by setting; each host must have the same ones.

    Raises ScenarioError if the hosts have more robots than the run, or the hub cannot listen at its address.
    """

    def __init__(
        self,
        hosts: Hosts,
        robots: int,
        notify: Callable[[str], object] = lambda _: None,
        plugins: Mapping[str, str] | None = None,
    ) -> None:
        self._plugins = plugins or {}
        placing = {name: list(map(names.robot, numbers)) for name, numbers in hosts.placing(robots).items()}
        routers = {names.router(host.name): placing[host.name] for host in hosts.host if host.router}
        self.rendezvous = by_certificates(hosts.address, hosts.port, robots, routers)
        """The hub's address and the credentials, made for this run alone."""
        self._placing = [(host, placing[host.name]) for host in hosts.host]
        self._links: list[_Link] = []
        self._notify = notify

    @property
    def robots(self) -> dict[str, str]:
        """The robots on other hosts, each with the name of its host."""
        return {robot: host.name for host, robots in self._placing for robot in robots}

    def __enter__(self) -> Self:
        """Connect to all hosts.

        Raises HostError if some hosts cannot be reached, or have no Murmur or a different one; the message names all of
        them.
        """
        try:
            for host, robots in self._placing:
                self._links.append(_Link(host, robots, self._plugins))
            self._compare_versions()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._hang_up()  # does nothing after a complete run
        self._end()

    @contextlib.contextmanager
    def running(self, credentials: Mapping[str, Credential], logs: Path) -> Iterator[None]:
        """Run the robots; end those that are left when the block ends.

        Their output goes to ``NAME.log`` in `logs`, and that of ssh to ``HOST.log``.
        """
        for link in self._links:
            link.start([credentials[name] for name in link.clients], logs)
        try:
            yield
        finally:
            self._end()

    def _end(self) -> None:
        """Wait for the remote processes to end, request their end, then end each ssh."""
        _await_all(self._links, END_S)
        self._hang_up()
        _await_all(self._links, HUNG_UP_S)
        for link in self._links:
            link.close()

    def check(self, deaths: dict[str, str]) -> None:
        """Add the robots and hosts that have ended prematurely to `deaths`."""
        for link in self._links:
            for name, report in link.deaths().items():
                deaths.setdefault(name, report)

    def forget_disconnected(self, deaths: dict[str, str]) -> None:
        """Remove the robots from `deaths` that ended because the hub had ended."""
        for link in self._links:
            for name in link.broken_off:
                deaths.pop(name, None)

    def give_up(self, name: str) -> None:
        """End a robot; its end does not count as premature."""
        for link in self._links:
            if name in link.robots:
                link.give_up(name)

    def _hang_up(self) -> None:
        for link in self._links:
            link.hang_up()

    def _compare_versions(self) -> None:
        deadline = time.monotonic() + HELLO_S
        here = hello(self._plugins)
        faults = []
        for link in self._links:
            try:
                for line in link.differences(here, deadline):
                    self._notify(line)
            except HostError as error:
                faults.append(str(error))
        if faults:
            raise HostError("\n".join(faults))


class _Link:
    """One ssh and the robots that it runs, possibly with a router between them and the hub."""

    def __init__(self, host: Host, robots: list[str], plugins: Mapping[str, str]) -> None:
        self.robots = robots
        self.clients = [names.router(host.name)] if host.router else robots
        """The participants that join at the hub: the router, or the robots themselves."""
        self.broken_off: set[str] = set()
        """The participants that ended because they had lost the hub."""
        self._host = host
        self._stderr = b""
        self._fault = ""
        """Why the connection was ended: the host broke the protocol."""
        self._left = MAX_OUTPUT * (1 + len(robots))
        """Bytes that the host may still send."""
        self._logged = dict.fromkeys([*robots, *self.clients], 0)
        self._hello: queue.Queue[_Hello | None] = queue.Queue()
        self._other_output: list[str] = []
        self._ended: dict[str, str] = {}
        self._lost_router = ""
        self._logs: Path | None = None
        try:
            self._ssh = subprocess.Popen(  # in its own session: only the launcher receives Ctrl-C
                command_line(host, plugins),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                start_new_session=True,
            )
        except FileNotFoundError:
            raise HostError("ssh is not installed; robots on other hosts are started with it") from None
        assert self._ssh.stdin and self._ssh.stdout and self._ssh.stderr
        self._orders, self._output = self._ssh.stdin, self._ssh.stdout
        self._reader = threading.Thread(target=self._read_output, name=f"ssh {host.name}", daemon=True)
        self._reader.start()
        self._error_reader = threading.Thread(
            target=self._read_errors, args=(self._ssh.stderr,), name=f"ssh {host.name} errors", daemon=True
        )
        self._error_reader.start()

    def differences(self, here: Mapping[str, Any], deadline: float) -> Iterable[str]:
        """Wait for the host's first message; yield a warning for each package whose version differs from `here`.

        Raises HostError if no message arrives, or the host's code or plug-ins differ from the launcher's.
        """
        where = f"host {self._host.name}"
        try:
            there = self._hello.get(timeout=max(0.0, deadline - time.monotonic()))
        except queue.Empty:
            raise HostError(f"{where}: no reply within {HELLO_S:g} s: {self._last_output()}") from None
        if there is None:
            raise HostError(f"{where}: {self._why_silent()}")
        if there.code != here["code"]:
            raise HostError(
                f"{where}: has different code, Murmur {_printable(there.murmur)} ({_printable(there.code)}; "
                f"here {here['murmur']}, {here['code']}): install the same version on both"
            )
        if not -CLOCK_BEHIND_S < there.clock - here["clock"] < CLOCK_AHEAD_S:
            raise HostError(
                f"{where}: its clock shows {_utc(there.clock)}, and that of this host {_utc(here['clock'])}: "
                "the certificates of the run would not be valid there; set the clock"
            )
        for setting, digest in here["plugins"].items():
            if setting in there.missing:
                raise HostError(
                    f"{where}: {_printable(there.missing[setting])}; install it there, or put its file into the folder "
                    f"in which the command of the hosts file runs (now: {self._host.command})"
                )
            if there.plugins.get(setting) != digest:
                raise HostError(f"{where}: has other code of the {setting}; copy the module to it")
        for package, ours in here["versions"].items():
            theirs = _printable(there.versions.get(package, "None"))
            if theirs != ours:
                yield f"{where}: has {package} {theirs}, this host has {ours}; the digest may differ"

    def start(self, credentials: list[Credential], logs: Path) -> None:
        self._logs = logs
        self._send({"credentials": [asdict(credential) for credential in credentials]})

    def deaths(self) -> dict[str, str]:
        """Return the robots that ended prematurely; the host itself if the connection ended before its robots did."""
        ended = self._ended.copy()
        found = {name: f"on {self._host.name}: {report}" for name, report in ended.items() if report}
        if self._lost_router:
            found[names.router(self._host.name)] = self._lost_router
        missing = [name for name in self.robots if name not in ended]
        if missing and self.is_over() and not self._reader.is_alive():
            found[self._host.name] = f"{self._why_gone()}; with it {', '.join(missing)}"
        return found

    def give_up(self, name: str) -> None:
        """Request the end of a robot, once; no crash report is expected."""
        if name not in self._ended:
            self._ended[name] = ""
            self._send({"end": name})

    def _send(self, order: Mapping[str, Any]) -> None:
        with contextlib.suppress(BrokenPipeError):  # the host is gone: `deaths` reports it
            self._orders.write(json.dumps(order).encode() + b"\n")
            self._orders.flush()

    def is_over(self) -> bool:
        return self._ssh.poll() is not None

    def hang_up(self) -> None:
        """Close the remote process's standard input, so that it ends its robots."""
        with contextlib.suppress(BrokenPipeError):
            self._orders.close()

    def close(self) -> None:
        if self._output.closed:
            return
        for end in (self._ssh.terminate, self._ssh.kill):
            if not self.is_over():
                end()
                _await_all([self], 1.0)
        self._reader.join()
        self._output.close()
        self._error_reader.join(1.0)
        errors = self._errors()
        if errors and self._logs is not None:
            self._logs.mkdir(parents=True, exist_ok=True)
            (self._logs / f"{self._host.name}.log").write_text(errors, encoding="utf-8")

    def _read_output(self) -> None:
        """Process the messages of the remote process, line by line, until it ends (runs on a thread)."""
        greeted = False
        while not self._fault and (line := self._output.readline(MAX_LINE + 1)):
            if len(line) > MAX_LINE:
                self._refuse(f"sent a line of more than {MAX_LINE} bytes")
                break
            self._count(line)
            try:
                if not greeted:
                    self._hello.put(msgspec.json.decode(line, type=_Hello))
                    greeted = True
                    continue
                event = msgspec.json.decode(line, type=_Event)
            except (msgspec.MsgspecError, RecursionError) as error:
                if line.startswith(b"{") and (greeted or b'"murmur"' in line):
                    self._refuse(f"sent a malformed message: {str(error)[:MAX_TEXT]}")
                    break
            else:
                if event.robot in self._logged:
                    self._process(event)
                    continue
            self._other_output = [*self._other_output[-9:], _printable(line.decode(errors="replace"))]
        self._hello.put(None)

    def _read_errors(self, stream: IO[bytes]) -> None:
        """Keep the last error output, until it ends (runs on a thread)."""
        with stream:
            while not self._fault and (piece := stream.read1(MAX_ERRORS)):  # type: ignore[attr-defined]
                self._stderr = (self._stderr + piece)[-MAX_ERRORS:]
                self._count(piece)

    def _count(self, data: bytes) -> None:
        """Count received bytes against the limit."""
        self._left -= len(data)
        if self._left < 0:
            self._refuse(f"sent more than {MAX_OUTPUT * (1 + len(self.robots)) >> 20} MiB")

    def _refuse(self, fault: str) -> None:
        """End the connection to a host that breaks the protocol."""
        self._fault = self._fault or fault
        self._ssh.kill()

    def _process(self, event: _Event) -> None:
        """Write a robot's output to its log, or note its end."""
        name, code = event.robot, event.exit
        if event.log and self._logs is not None:
            self._log(name, event.log.encode())
        elif code is not None and name not in self._ended:
            report = (_printable(event.report) or f"exit code {code}") if code else ""
            if code == BROKEN_OFF:
                self.broken_off.add(name)
            missing = [robot for robot in self.robots if robot not in self._ended]
            if name in self.robots:
                self._ended[name] = "" if self._lost_router else report
            elif report and missing:
                self._lost_router = f"{report}; with it {', '.join(missing)}"

    def _log(self, name: str, output: bytes) -> None:
        """Append a robot's output to its log, up to `MAX_LOG` bytes."""
        assert self._logs is not None
        output = output[: MAX_LOG - self._logged[name]]
        self._logged[name] += len(output)
        if output and self._logged[name] == MAX_LOG:
            output += f"\n[host {self._host.name}: output beyond {MAX_LOG >> 20} MiB is dropped]\n".encode()
        if output:
            with (self._logs / f"{name}.log").open("ab") as file:
                file.write(output)

    def _why_silent(self) -> str:
        """Return why the host's first message did not arrive."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._ssh.wait(END_S)
        if self._ssh.poll() is None:
            self._refuse("closed its output")
        code = self._ssh.wait()
        if self._fault:
            return self._fault
        if code == UNREACHED:
            return (
                f"ssh cannot reach {self._host.target}: {self._all_output()}\n"
                f"ssh must connect without a prompt; test it with: {shlex.join(_connection(self._host))} true"
            )
        if code in NO_COMMAND:
            return (
                f"Murmur was not found: {self._last_output()}; install it there, or set command in the hosts file "
                f"(now: {self._host.command})"
            )
        return (
            f"{self._host.command} run agents failed (exit code {code}): {self._last_output()}; "
            "install the same version of Murmur on both, or correct command in the hosts file"
        )

    def _why_gone(self) -> str:
        if self._fault:
            return self._fault
        code = self._ssh.poll()
        cause = (
            "the connection was lost" if code == UNREACHED else f"murmur run agents ended, exit code {code}"
        )
        return f"{cause}: {self._last_output()}"

    def _errors(self) -> str:
        """Return the standard error of ssh and of the remote process."""
        if self.is_over():
            self._error_reader.join(1.0)
        return self._stderr.decode(errors="replace")

    def _last_output(self) -> str:
        return self._all_output().splitlines()[-1]

    def _all_output(self) -> str:
        """Return the last lines that ssh and the host printed: ssh may need several to explain an error."""
        lines = [*self._other_output, *map(_printable, self._errors().splitlines())]
        return "\n".join(list(filter(None, lines))[-MAX_LINES:]) or "no output"


def command_line(host: Host, plugins: Mapping[str, str]) -> list[str]:
    """Return the ssh command line for a host whose robots need plug-ins, given by setting.

    It never asks for a password and contains no credential.
    """
    plain = [
        "BatchMode=yes", f"ConnectTimeout={CONNECT_S}", f"ServerAliveInterval={ALIVE_S}",
        f"ServerAliveCountMax={ALIVE_TIMES}", "ControlPath=none", "ClearAllForwardings=yes", "LogLevel=ERROR",
    ]  # fmt: skip
    # ssh uses the first value of an option that is given twice.
    ours = [part for option in plain for part in ("-o", option)]
    needs = "".join(f" --plugin {shlex.quote(f'{setting}={name}')}" for setting, name in plugins.items())
    ssh, *given, target = _connection(host)
    return [ssh, "-T", "-a", "-x", *given, *ours, "--", target, f"{host.command} run agents{needs}"]


def _connection(host: Host) -> list[str]:
    """Return the ssh command line that connects to a host as a user would, with the settings of the hosts file."""
    given = [part for option in host.options for part in ("-o", option)]
    port = ["-p", str(host.port)] if host.port is not None else []
    return ["ssh", *given, *port, host.target]


def _utc(seconds: int) -> str:
    return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M} UTC"


def _printable(text: str) -> str:
    """Return the end of a text from a host without control characters, which could change the terminal."""
    kept = "".join(character for character in text if character.isprintable() or character in "\n\t")
    return kept.strip()[-MAX_TEXT:]


def _await_all(links: Iterable[_Link], timeout_s: float) -> None:
    """Wait until all links have ended, for at most `timeout_s`."""
    deadline = time.monotonic() + timeout_s
    while not all(link.is_over() for link in links) and time.monotonic() < deadline:
        time.sleep(0.02)
