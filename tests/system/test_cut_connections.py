"""Robots whose TCP connections to the hub are cut, with one robot behind a proxy: each continues where it was."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from urllib.parse import urlsplit

import pytest

from deploy.record.records import Records
from deploy.record.summary import digest, summarize
from deploy.run import in_memory, launch
from deploy.run.rendezvous import Rendezvous, on_loopback
from deploy.scenario.plan import Plan
from netshaper.process import DISCONNECTED
from protocol.keys import robot
from tests.system.team import small_plan

CUT = 1
"""The robot whose connection is cut."""
PACE = 40.0


class Proxy:
    """Forwards TCP connections to `target`, and cuts them on request."""

    def __init__(self, target: tuple[str, int]) -> None:
        self._target = target
        self._server = socket.create_server(("127.0.0.1", 0))
        self._ends: list[socket.socket] = []
        self._lock = threading.Lock()
        self.port: int = self._server.getsockname()[1]
        self.refuses = False
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self) -> None:
        """Shut all connections down, as a failing network does."""
        with self._lock:
            ends, self._ends = self._ends, []
        for end in ends:
            _shut(end)

    def close(self) -> None:
        self._server.close()
        self.cut()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._server.accept()
                if self.refuses:
                    client.close()
                    continue
                hub = socket.create_connection(self._target)
                with self._lock:
                    self._ends += [client, hub]
                for ends in ((client, hub), (hub, client)):
                    threading.Thread(target=_pump, args=ends, daemon=True).start()


def _pump(source: socket.socket, sink: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while data := source.recv(1 << 16):
            sink.sendall(data)
    _shut(source)
    _shut(sink)


def _shut(end: socket.socket) -> None:
    with contextlib.suppress(OSError):
        end.shutdown(socket.SHUT_RDWR)


@contextlib.contextmanager
def proxied(robots: int) -> Iterator[tuple[Rendezvous, Proxy]]:
    """A rendezvous at which one robot joins through a proxy."""
    rendezvous = on_loopback(robots)
    hub = urlsplit(rendezvous.endpoint.replace("tcp/", "tcp://"))
    assert hub.hostname is not None
    assert hub.port is not None
    proxy = Proxy((hub.hostname, hub.port))
    credentials = dict(rendezvous.credentials)
    credentials[robot(CUT)] = replace(credentials[robot(CUT)], hub=f"tcp/127.0.0.1:{proxy.port}")
    try:
        yield replace(rendezvous, credentials=credentials), proxy
    finally:
        proxy.close()


def run(plan: Plan, cuts: list[int], pace: float | None = PACE, outage_s: float = 0.0) -> launch.Outcome:
    """Run a plan, and cut the connection during each of the steps `cuts`."""
    with proxied(plan.scenario.robots) as (rendezvous, proxy):
        seen: list[Records] = []
        over = threading.Event()

        def cut() -> None:
            left = list(cuts)
            while left and not over.wait(0.001):
                if seen and seen[0].step >= left[0]:
                    proxy.refuses = outage_s > 0
                    proxy.cut()
                    time.sleep(outage_s)
                    proxy.refuses = False
                    del left[0]

        cutter = threading.Thread(target=cut)
        cutter.start()
        try:
            return launch.run(plan, None, seen.append, rendezvous=rendezvous, pace=pace)
        finally:
            over.set()
            cutter.join()


@pytest.fixture(scope="module")
def plan() -> Plan:
    return small_plan(robots=3, map_encoding="predictive", bandwidth=1000)


def check_undisturbed(plan: Plan, records: Records, cuts: int) -> None:
    assert [robot for _, robot in records.reconnected] == cuts * [CUT]
    assert records.lost == {}
    assert records.returned == []
    assert records.protocol_errors == []
    assert digest(records) == digest(in_memory.MemoryRun(plan).complete())


@pytest.mark.parametrize("cuts", [[12], [8, 20, 30]])
def test_a_robot_continues_after_its_connection_was_cut(plan: Plan, cuts: list[int]) -> None:
    outcome = run(plan, cuts)
    assert outcome.deaths == {}
    check_undisturbed(plan, outcome.records, len(cuts))
    summary = summarize(plan, outcome.records, 1.0)
    assert [robot for _, robot in summary["reconnected"]] == len(cuts) * [CUT]


def test_a_robot_continues_after_an_outage(plan: Plan) -> None:
    check_undisturbed(plan, run(plan, [12], outage_s=1.5).records, 1)


def test_a_robot_that_stays_away_is_lost_and_the_others_continue(plan: Plan) -> None:
    records = run(plan, [12], outage_s=6.0).records
    assert records.lost == {CUT: DISCONNECTED}
    assert records.returned == []
    assert records.end is not None
    assert records.end.reason == "explored"


@pytest.mark.long
@pytest.mark.parametrize("seed", range(20))
def test_a_robot_continues_whenever_its_connection_is_cut(seed: int) -> None:
    plan = small_plan(side_m=20.0, robots=4, map_encoding="polygons", bandwidth=500, seed=seed)
    outcome = run(plan, [3 + seed, 20 + 2 * seed], pace=None)
    assert 1 <= len(outcome.records.reconnected) <= 2
    check_undisturbed(plan, outcome.records, len(outcome.records.reconnected))
