"""Robots of a run on another host: the process `murmur run agents`, which the launcher starts through SSH.

It reports its version, receives credentials, starts one child process per robot, and forwards their output and exit
codes. It ends when all of them have ended, or when its standard input is closed, as it is when the launcher ends.

Both directions use JSON lines. To the launcher: `hello` once, then ``{"robot", "log"}`` and
``{"robot", "exit", "report"}``. From the launcher: ``{"credentials": [...]}`` once, then ``{"end": NAME}``. If a
credential is a router's, the robots that it names join through this router; messages name the router like a robot.
"""

from __future__ import annotations

import json
import os
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from io import RawIOBase
from pathlib import Path
from typing import Any

from setproctitle import setproctitle

from deploy.record.code_digest import code_digest
from deploy.record.versions import versions
from deploy.scenario import plugins as plugin_checks
from protocol import keys as names
from protocol.temporary import temporary_folder
from protocol.zenoh_bus import Credential

POLL_S = 0.2
MAX_LINE = 2**19
"""Maximum bytes of a message to the launcher."""
MAX_LOG = 2**22
"""Maximum bytes of a robot's output that are forwarded."""
_PIECE = MAX_LINE // 8
"""Bytes of output per message; as JSON, a byte may take six."""
STARTERS = (
    "deploy.run.remote_agents", "deploy.run.processes", "deploy.run.process_table", "deploy.run.fork_server",
    "netshaper.access", "netshaper.router",
)  # fmt: skip
"""Modules that start a robot and authenticate it."""


def hello(plugins: Mapping[str, str]) -> dict[str, Any]:
    """Return the first message to the launcher: versions of Murmur and dependencies, its code, its plug-ins, its clock.

    `plugins` are those that the robots need, by setting. The message has digests of their code in ``plugins``, and in
    ``missing`` why the others cannot be imported. ``clock`` is in seconds since 1970, by which it judges certificates.
    """
    found = versions()
    digests, missing = plugin_checks.digests(plugins) if plugins else ({}, {})
    return {
        "murmur": found.pop("murmur-robots"), "code": code_digest(STARTERS), "versions": found, "plugins": digests,
        "missing": missing, "clock": int(time.time()),
    }  # fmt: skip


class _Channel:
    """Messages to the launcher: reserves standard output, and redirects all other output to standard error."""

    def __init__(self) -> None:
        sys.stdout.flush()
        self._file = os.fdopen(os.dup(1), "wb", buffering=0)
        os.dup2(2, 1)
        self._file.write(b"\n")  # ends what shell startup files have printed, as the title of a terminal

    def send(self, **message: object) -> None:
        """Send one message to the launcher."""
        self._file.write(json.dumps(message).encode() + b"\n")


def serve(plugins: Mapping[str, str]) -> None:
    """Run the robots of this host, which need these `plugins`, from the first message to the end of the last robot.

    Raises ValueError if the launcher sent a malformed message.
    """
    setproctitle("murmur robots")
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
        signal.signal(number, _leave)
    try:
        channel = _Channel()
        channel.send(**hello(plugins))
        # Unbuffered, because `select` does not see bytes in a buffer.
        with open(0, "rb", buffering=0, closefd=False) as orders:
            order = orders.readline()
            if order:
                _run(_credentials(order), orders, channel)
    except BrokenPipeError:
        pass  # the launcher has ended, and the robots end with it


def _run(credentials: list[Credential], orders: RawIOBase, channel: _Channel) -> None:
    from deploy.run.process_table import ProcessTable  # noqa: PLC0415
    from deploy.run.processes import serve_agent, serve_router  # noqa: PLC0415
    from deploy.run.rendezvous import behind  # noqa: PLC0415  the first message must not wait

    table: dict[str, Callable[[], None]] = {}
    for credential in credentials:
        if credential.robots:
            there = behind(credential)
            table[credential.name] = partial(serve_router, credential, there)
            table |= {name: partial(serve_agent, shown) for name, shown in there.credentials.items()}
        else:
            table[credential.name] = partial(serve_agent, credential)
    routers = {credential.name for credential in credentials if credential.robots}

    with temporary_folder() as folder:
        logs = folder / "logs"
        read = dict.fromkeys(table, 0)
        running = list(table)

        def forward_log(name: str) -> None:
            for text in _new_output(logs / f"{name}.log", read[name]):
                read[name] += len(text)
                channel.send(robot=name, log=text.decode(errors="replace"))

        with ProcessTable(logs) as processes:
            for name, task in table.items():
                processes.start(name, task)
            while set(running) - routers:
                is_over = False
                if select.select([0], [], [], POLL_S)[0]:
                    order = orders.readline()
                    is_over = not order
                    processes.give_up(_to_end(order))
                ended, deaths = processes.ended(), processes.check()
                for name in running:
                    forward_log(name)
                    if name in ended:
                        channel.send(robot=name, exit=ended[name], report=deaths.get(name, "")[-_PIECE:])
                running = [name for name in running if name not in ended]
                if is_over:
                    break


def _new_output(log: Path, start: int) -> Iterator[bytes]:
    """Read a log from byte `start` to byte `MAX_LOG`, in pieces."""
    if log.exists():
        with log.open("rb") as file:
            file.seek(start)
            while text := file.read(max(0, min(_PIECE, MAX_LOG - file.tell()))):
                yield text


def _credentials(order: bytes) -> list[Credential]:
    """Parse the credentials in the launcher's first message."""
    try:
        listed = json.loads(order)["credentials"]
    except (ValueError, KeyError, TypeError):
        raise ValueError(
            "standard input: must be one line of JSON, as murmur explore --hosts sends it"
        ) from None
    found = [Credential.parse(json.dumps(each)) for each in listed]
    for credential in found:
        if not credential.robots:
            names.number(credential.name)
    return found


def _to_end(order: bytes) -> str:
    """Return the robot that the launcher wants to end; empty for any other message."""
    try:
        return str(json.loads(order)["end"])
    except (ValueError, KeyError, TypeError):
        return ""


def _leave(*_: object) -> None:
    sys.exit(0)
