"""Cut TCP connections: robots join the hub through proxies, which cut their connections during given steps."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct
import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from urllib.parse import urlsplit

from deploy.record.records import Records
from deploy.run.rendezvous import Rendezvous
from protocol import keys as names

POLL_S = 0.001
CHUNK = 1 << 16
RESET = struct.pack("ii", 1, 0)
"""Value of SO_LINGER with which closing a socket sends RST instead of FIN."""


@dataclass(frozen=True, order=True)
class Cut:
    """A robot's connection is cut during a step; with `reset`, both ends receive RST instead of FIN."""

    step: int
    robot: int
    reset: bool = False


class Proxy:
    """Forwards TCP connections from a port of the loopback interface to the address `target`."""

    def __init__(self, target: tuple[str, int]) -> None:
        self.refuses = False
        """Whether new connections are closed at once."""
        self._target = target
        self._ends: set[asyncio.StreamWriter] = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        listening = asyncio.start_server(self._forward, "127.0.0.1", 0)
        self._server = asyncio.run_coroutine_threadsafe(listening, self._loop).result()
        self.port: int = self._server.sockets[0].getsockname()[1]

    def cut(self, *, reset: bool = False) -> None:
        """Close all connections, as a failing network does."""
        self._loop.call_soon_threadsafe(self._cut, reset)

    def close(self) -> None:
        """Close the port and all connections."""
        self._loop.call_soon_threadsafe(self._server.close)
        self.cut()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def _cut(self, reset: bool) -> None:
        for end in self._ends:
            if reset and not end.is_closing():
                end.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, RESET)
            end.transport.abort()
        self._ends.clear()

    async def _forward(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            if not self.refuses:
                hub_reader, hub_writer = await asyncio.open_connection(*self._target)
                self._ends |= {writer, hub_writer}
                await asyncio.gather(_pump(reader, hub_writer), _pump(hub_reader, writer))
                self._ends -= {writer, hub_writer}
        writer.transport.abort()


async def _pump(source: asyncio.StreamReader, sink: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while data := await source.read(CHUNK):
            sink.write(data)
            await sink.drain()
    sink.close()


@contextlib.contextmanager
def proxied(rendezvous: Rendezvous, robots: Sequence[int]) -> Iterator[tuple[Rendezvous, dict[int, Proxy]]]:
    """Return a rendezvous at which some robots join through proxies of their own, and the proxies by robot."""
    hub = urlsplit(rendezvous.endpoint.replace("tcp/", "tcp://"))
    assert hub.hostname is not None and hub.port is not None
    credentials, proxies = dict(rendezvous.credentials), {}
    with contextlib.ExitStack() as stack:
        for robot in robots:
            proxy = proxies[robot] = Proxy((hub.hostname, hub.port))
            stack.callback(proxy.close)
            name = names.robot(robot)
            credentials[name] = replace(credentials[name], hub=f"tcp/127.0.0.1:{proxy.port}")
        yield replace(rendezvous, credentials=credentials), proxies


class Cutter:
    """Cuts connections while a run goes on; `watch` is to be called with the run's records."""

    def __init__(self, cuts: Sequence[Cut], proxies: dict[int, Proxy], outage_s: float = 0.0) -> None:
        self._cuts, self._proxies, self._outage_s = sorted(cuts), proxies, outage_s
        self._records: Records | None = None
        self._over = threading.Event()

    def watch(self, records: Records) -> None:
        """Learn the records, whose step tells when to cut."""
        self._records = records

    @contextlib.contextmanager
    def running(self) -> Iterator[None]:
        """Cut in a thread of its own until the end of the context."""
        thread = threading.Thread(target=self._run)
        thread.start()
        try:
            yield
        finally:
            self._over.set()
            thread.join()

    def _run(self) -> None:
        left = self._cuts
        while left and not self._over.wait(POLL_S):
            if self._records is not None and self._records.step >= left[0].step:
                proxy = self._proxies[left[0].robot]
                proxy.refuses = self._outage_s > 0
                proxy.cut(reset=left[0].reset)
                self._over.wait(self._outage_s)
                proxy.refuses = False
                left = left[1:]
