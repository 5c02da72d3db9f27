"""Robots of a run on another host: what `murmur run agents` does there, at the far end of the launcher's SSH.

It says which code it is, is given credentials, starts one child a robot, and passes on what they print and how they
end. It ends when they have all ended, or when its standard input is closed: when the launcher goes, so do they.

Both ways go lines of JSON. Here to the launcher: ``{"murmur", "code", "versions"}`` once, then ``{"robot", "log"}`` and
``{"robot", "exit", "words"}``. From the launcher: ``{"credentials": [...]}`` once, then ``{"end": NAME}``. Where a
credential is a router's, the robots that it names join through that; of the router is spoken as if it were a robot.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import multiprocessing
import os
import select
import signal
import sys
import tempfile
import threading
from collections.abc import Callable
from functools import cache
from io import RawIOBase
from pathlib import Path
from typing import Any

from setproctitle import setproctitle

from deploy.record.versions import versions
from protocol import keys as names
from protocol.zenoh_bus import Credential

POLL_S = 0.2
ROOMS = ("agent", "protocol")
"""Rooms whose code decides what a robot does and says; and what starts it and lets it in."""
STARTERS = (
    "deploy.run.remote_agents",
    "deploy.run.processes",
    "deploy.run.process_table",
    "netshaper.access",
    "netshaper.router",
)


def code_digest() -> str:
    """Digest of the code that a robot runs: equal digests, equal robots."""
    files = [(name, _file_of(name)) for name in STARTERS]
    for room in ROOMS:
        root = _file_of(room).parent
        files += [(f"{room}/{path.relative_to(root).as_posix()}", path) for path in root.rglob("*.py")]
    digest = hashlib.sha256()
    for name, path in sorted(files):
        digest.update(f"{name}\0".encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:16]


def _file_of(module: str) -> Path:
    """Where a module's code is, without importing it."""
    spec = importlib.util.find_spec(module)
    assert spec is not None and spec.origin is not None
    return Path(spec.origin)


@cache
def hello() -> dict[str, Any]:
    """What a far end says first."""
    found = versions()
    return {"murmur": found.pop("murmur-robots"), "code": code_digest(), "versions": found}


class _Channel:
    """The way back to the launcher: standard output, for it alone; what else is printed goes where errors go."""

    def __init__(self) -> None:
        sys.stdout.flush()
        self._file = os.fdopen(os.dup(1), "wb", buffering=0)
        os.dup2(2, 1)

    def say(self, **words: object) -> None:
        self._file.write(json.dumps(words).encode() + b"\n")


def serve() -> None:
    """Be the far end, from hello to the last robot's end.

    Raises
    ------
    ValueError
        The launcher said what makes no sense.
    """
    setproctitle("murmur robots")
    channel = _Channel()
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
        signal.signal(number, _leave)
    try:
        channel.say(**hello())
        # Byte by byte, so that nothing stays in a buffer that `select` does not know of.
        with open(0, "rb", buffering=0, closefd=False) as orders:
            order = orders.readline()
            if order:
                _run(_credentials(order), orders, channel)
    except BrokenPipeError:
        pass  # the launcher is gone, and the robots with it


def _run(credentials: list[Credential], orders: RawIOBase, channel: _Channel) -> None:
    from deploy.run.process_table import ProcessTable  # noqa: PLC0415
    from deploy.run.processes import serve_agent, serve_router  # noqa: PLC0415
    from deploy.run.rendezvous import behind  # noqa: PLC0415  hello comes first

    table: dict[str, tuple[Callable[..., None], *tuple[object, ...]]] = {}
    for credential in credentials:
        if credential.robots:
            there = behind(credential)
            table[credential.name] = serve_router, credential, there.endpoint, there.credentials
            table |= {name: (serve_agent, shown) for name, shown in there.credentials.items()}
        else:
            table[credential.name] = serve_agent, credential
    routers = {credential.name for credential in credentials if credential.robots}

    with tempfile.TemporaryDirectory(prefix="murmur-far-") as folder:
        logs = Path(folder) / "logs"
        read = dict.fromkeys(table, 0)
        running = list(table)

        def forward_maps(name: str) -> None:
            log = logs / f"{name}.log"
            text = log.read_bytes()[read[name] :] if log.exists() else b""
            if text:
                read[name] += len(text)
                channel.say(robot=name, log=text.decode(errors="replace"))

        with ProcessTable(logs) as processes:
            for name, row in table.items():
                processes.start(name, serve_tied, *row)
            while set(running) - routers:
                is_over = False
                if select.select([0], [], [], POLL_S)[0]:
                    order = orders.readline()
                    is_over = not order
                    processes.give_up(_to_end(order))
                ended, deaths = processes.ended(), processes.look()
                for name in running:
                    forward_maps(name)
                    if name in ended:
                        channel.say(robot=name, exit=ended[name], words=deaths.get(name, ""))
                running = [name for name in running if name not in ended]
                if is_over:
                    break


def serve_tied(serve: Callable[..., None], *args: object) -> None:
    """Be one robot or router, and die with the far end, even if that is killed."""
    threading.Thread(target=_die_with_parent, name="far end", daemon=True).start()
    serve(*args)


def _die_with_parent() -> None:
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os.kill(os.getpid(), signal.SIGKILL)


def _credentials(order: bytes) -> list[Credential]:
    """The robots' credentials out of the launcher's order."""
    try:
        listed = json.loads(order)["credentials"]
    except (ValueError, KeyError, TypeError):
        raise ValueError(
            "standard input: must be one line of JSON, as murmur explore --hosts says it"
        ) from None
    found = [Credential.parse(json.dumps(each)) for each in listed]
    for credential in found:
        if not credential.robots:
            names.number(credential.name)
    return found


def _to_end(order: bytes) -> str:
    """The robot that the launcher wants ended; empty if it says nothing of the kind."""
    try:
        return str(json.loads(order)["end"])
    except (ValueError, KeyError, TypeError):
        return ""


def _leave(*_: object) -> None:
    sys.exit(0)
