"""Benches for planning on several hosts: what a link carries, what its delay costs, what the hub's host works.

The links are forwarders on this machine, one TCP connection a robot, that hold back what they carry. So they show what
delay does, to the byte and to the round trip, and nothing of what loss and narrow links do.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from deploy.bench.ratios import Figure, compare
from deploy.record.records import Records
from deploy.run import launch
from deploy.run.rendezvous import LOOPBACK, Rendezvous, by_certificates, on_loopback
from deploy.scenario import plan as plans
from deploy.scenario.plan import Plan
from deploy.scenario.scenario import Scenario
from protocol import keys as names
from worldsim import generators

ROBOTS = 4
LINK_STEPS, HUB_STEPS = 120, 120
SIDE_M = 30.0
REPEATS = 3
ROUND_TRIPS_MS = (0, 5, 20, 50)
TEAMS = (4, 8, 16, 32)
ROUTED = 8
"""Robots that share a router, where there are routers."""
PLANNED, HOSTS = 1000, 50
"""The team that is planned, and the hosts that it is spread over."""
CHUNK = 1 << 16
FIRST_THREAD = "of it its first thread"
"""The relay's Python; its other threads are Zenoh's."""
ROBOT, ROUTER, MOVED = "a robot", "a router", "moved at the hub"
CERTIFICATES, ROUTERS = "certificates", f"routers of {ROUTED}"


@dataclass
class Traffic:
    """What one connection carried."""

    to_hub: int = 0
    from_hub: int = 0
    turns: int = 0
    """How often its robot answered what it had heard: round trips."""
    speaks: bool = False
    """Whether the last word was the robot's."""


class Link:
    """A forwarder to the hub that holds back what it carries; a context manager.

    Parameters
    ----------
    hub : int
        The hub's port on the loopback.
    delay_s : float
        How long each way takes.
    """

    def __init__(self, hub: int, delay_s: float) -> None:
        self.traffic: list[Traffic] = []
        self.port = 0
        self._hub = hub
        self._delay_s = delay_s
        self._loop = asyncio.new_event_loop()
        self._over = asyncio.Event()
        self._ready = threading.Event()
        self._thread = threading.Thread(target=self._run, name="link", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        self._ready.wait()
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._over.set)
        self._thread.join()

    def carried(self) -> dict[str, float]:
        """What all connections have carried so far."""
        return {
            "from the hub": sum(traffic.from_hub for traffic in self.traffic),
            "to the hub": sum(traffic.to_hub for traffic in self.traffic),
            "round trips": sum(traffic.turns for traffic in self.traffic),
        }

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve())

    async def _serve(self) -> None:
        server = await asyncio.start_server(self._forward, LOOPBACK)
        self.port = server.sockets[0].getsockname()[1]
        self._ready.set()
        await self._over.wait()
        server.close()

    async def _forward(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        traffic = Traffic()
        self.traffic.append(traffic)
        try:
            from_hub, to_hub = await asyncio.open_connection(LOOPBACK, self._hub)
        except OSError:
            writer.close()  # the hub is not there yet: whoever knocks tries again
            return
        ways = (self._carry(reader, to_hub, traffic, True), self._carry(from_hub, writer, traffic, False))
        with contextlib.suppress(asyncio.CancelledError):  # the run is over
            await asyncio.gather(*ways, return_exceptions=True)

    async def _carry(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, traffic: Traffic, up: bool
    ) -> None:
        under_way: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()

        async def hand_over() -> None:
            while True:
                due, data = await under_way.get()
                await asyncio.sleep(due - self._loop.time())
                if not data or writer.is_closing():  # it is the other end that hung up
                    writer.close()
                    return
                writer.write(data)

        handing_over = asyncio.create_task(hand_over())
        data = b"first"
        while data:
            data = await reader.read(CHUNK)
            if up:
                traffic.to_hub += len(data)
                traffic.turns += not traffic.speaks
            else:
                traffic.from_hub += len(data)
            traffic.speaks = up
            under_way.put_nowait((self._loop.time() + self._delay_s, data))
        await handing_over


class _Watch:
    """What grows by the step, between the first and the last look at a run: `read` says how far it has grown."""

    def __init__(self, plan: Plan, read: Callable[[], dict[str, float]]) -> None:
        self._steps = plan.scenario.steps
        self._read = read
        self._looks: list[tuple[float, int, dict[str, float]]] = []

    def look(self, records: Records) -> None:
        if records.step:
            grown = self._read() | {MOVED: float(records.wire_bytes or 0)}
            self._looks.append((time.perf_counter(), records.step, grown))

    def steps_per_s(self) -> float:
        (began, first, _), (ended, last, _) = self._ends()
        return (last - first) / (ended - began)

    def a_step(self) -> dict[str, float]:
        """How much it grew a step."""
        (_, first, before), (_, last, after) = self._ends()
        return {name: (after[name] - before[name]) / (last - first) for name in before if name in after}

    def _ends(self) -> tuple[tuple[float, int, dict[str, float]], tuple[float, int, dict[str, float]]]:
        """The first look, and the last one before the end, when robots hand in their maps."""
        looks = [look for look in self._looks if look[1] < self._steps]
        if len(looks) < 2 or looks[0][1] == looks[-1][1]:
            raise ConnectionError("the bench's swarm was over before it could be measured")
        return looks[0], looks[-1]


def link() -> Iterator[Figure]:
    """What the link between the hub's host and a robot's carries, and what its delay costs."""
    for map_encoding, bandwidth in (("polygons", 1000), ("scans", "unlimited")):
        plan = _plan(ROBOTS, LINK_STEPS, map_encoding, bandwidth)
        what = f"{ROBOTS} robots, {map_encoding}"
        speeds: dict[int, list[float]] = {delay: [] for delay in ROUND_TRIPS_MS}
        carried: list[dict[str, float]] = []
        for _ in range(REPEATS):
            for delay in ROUND_TRIPS_MS:
                speed, traffic = _delayed(plan, delay)
                speeds[delay].append(speed)
                carried += [traffic] if delay == ROUND_TRIPS_MS[-1] else []
        for name, unit in (("from the hub", "bytes"), ("to the hub", "bytes"), ("round trips", "")):
            mean = float(np.median([traffic[name] for traffic in carried])) / ROBOTS
            yield Figure(f"{what}: {name}, a robot and step", unit, mean)
        none, *delays = ROUND_TRIPS_MS
        yield Figure(f"{what}, no delay", "steps/s", float(np.median(speeds[none])))
        for delay in delays:
            yield compare(f"{what}, {delay} ms", "steps/s", speeds[delay], "no delay", speeds[none])


def hub() -> Iterator[Figure]:
    """What one host has to bear, by the team's size and by how robots join; then, of a team that is planned.

    Processor time a step of relay, world, laboratory, a robot and a router, and bytes of the hub's connections.
    What grows with the team is carried on along a straight line through the sizes that were measured.
    """
    measured: dict[str, dict[str, list[float]]] = {}
    for robots in TEAMS:
        plan = _plan(robots, HUB_STEPS, "polygons", 1000)
        for by, rendezvous in _meetings(robots).items():
            watch = _Watch(plan, processor_ms)
            _run(plan, rendezvous, watch)
            for what, spent in _by_kind(watch.a_step(), robots).items():
                measured.setdefault(by, {}).setdefault(what, []).append(spent)
                yield Figure(f"{robots} robots, {by}: {what}, a step", _unit(what), spent)
    for by in (CERTIFICATES, ROUTERS):
        yield from _planned(measured[by], f"{PLANNED} robots on {HOSTS} hosts, {by}")


def _planned(measured: dict[str, list[float]], what: str) -> Iterator[Figure]:
    """What a step needs with the team that is planned, and how many a second that allows."""
    there = PLANNED // HOSTS
    for who, spent in measured.items():
        if who == ROUTER:
            needs, of = there * spent[-1] / ROUTED, f"a host's router, of {there} robots"
        elif who == ROBOT:
            needs, of = there * spent[-1], f"a host's {there} robots, on one core"
        else:
            slope, start = np.polyfit(TEAMS, spent, 1)
            needs, of = start + slope * PLANNED, who
        yield Figure(f"{what}: {of}, a step", _unit(who), needs)
        if who != MOVED:
            yield Figure(f"{what}: {of}, alone", "steps/s", 1000 / needs)


def _meetings(robots: int) -> dict[str, Rendezvous]:
    """How robots may join: by passwords on the loopback, by certificates, or so through routers."""
    names_of = [
        list(map(names.robot, range(first, min(first + ROUTED, robots))))
        for first in range(0, robots, ROUTED)
    ]
    routers = {names.router(f"h{number}"): there for number, there in enumerate(names_of)}
    return {
        "passwords": on_loopback(robots),
        CERTIFICATES: by_certificates(LOOPBACK, None, robots),
        ROUTERS: by_certificates(LOOPBACK, None, robots, routers),
    }


def _by_kind(spent: dict[str, float], robots: int) -> dict[str, float]:
    """What each kind of process spent; of robots and routers the mean."""
    kinds = {name: spent[name] for name in (names.RELAY, FIRST_THREAD, names.WORLD, names.RECORDER)}
    kinds[ROBOT] = float(np.mean([spent[name] for name in map(names.robot, range(robots)) if name in spent]))
    routers = [ms for name, ms in spent.items() if name.startswith(names.ROUTER)]
    if routers:
        kinds[ROUTER] = float(np.mean(routers))
    return kinds | {MOVED: spent[MOVED]}


def _unit(what: str) -> str:
    return "bytes" if what == MOVED else "ms"


def _delayed(plan: Plan, round_trip_ms: float) -> tuple[float, dict[str, float]]:
    """Steps a second with all robots behind links, and what the links carried a step."""
    robots = plan.scenario.robots
    rendezvous = by_certificates(LOOPBACK, None, robots)
    with Link(int(rendezvous.endpoint.rpartition(":")[2]), round_trip_ms / 2000) as forwarder:
        credentials = dict(rendezvous.credentials)
        for name in map(names.robot, range(robots)):
            credentials[name] = replace(credentials[name], hub=f"tls/{LOOPBACK}:{forwarder.port}")
        watch = _Watch(plan, forwarder.carried)
        _run(plan, replace(rendezvous, credentials=credentials), watch)
    return watch.steps_per_s(), watch.a_step()


def _run(plan: Plan, rendezvous: Rendezvous, watch: _Watch) -> None:
    outcome = launch.run(plan, None, watch.look, rendezvous=rendezvous)
    if outcome.deaths:
        raise ConnectionError(f"the bench's swarm broke off: {outcome.deaths}")


def _plan(robots: int, steps: int, map_encoding: str, bandwidth: int | str) -> Plan:
    scenario = Scenario.model_validate(
        {
            "robots": robots,
            "steps": steps,
            "strategy": "meier",
            "map_encoding": map_encoding,
            "bandwidth": bandwidth,
        }
    )
    return plans.make(scenario, generators.make("office", width_m=SIDE_M, height_m=SIDE_M))


def processor_ms() -> dict[str, float]:
    """Processor time of this run's processes, by name, and of the relay's first thread, where Linux tells.

    This process is the laboratory.
    """
    parents: dict[int, int] = {}
    spent: dict[int, tuple[str, float]] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            pid, (parents[pid], ms) = int(folder.name), _stat(folder)
            title = (folder / "cmdline").read_bytes().split(b"\0")[0].decode().split()
        except OSError:
            continue
        if len(title) == 2 and title[0] == "murmur":
            spent[pid] = title[1], ms
    times = {names.RECORDER: 1000 * time.process_time()}
    for pid, (name, ms) in spent.items():
        if parents.get(parents[pid]) == os.getpid():  # the fork server stands in between
            times[name] = ms
            if name == names.RELAY:
                with contextlib.suppress(OSError):
                    times[FIRST_THREAD] = _stat(Path(f"/proc/{pid}/task/{pid}"))[1]
    return times


def _stat(folder: Path) -> tuple[int, float]:
    """Parent, and milliseconds of processor time, of a process or thread."""
    fields = (folder / "stat").read_text().rpartition(")")[2].split()
    return int(fields[1]), 1000 * (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
