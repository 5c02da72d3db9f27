"""Hosts on a network of their own: network namespaces at two bridges, with a cable between the bridges.

A socket belongs to the namespace in which its thread opened it, so one process can have a socket on each host.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import subprocess
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

Result = TypeVar("Result")

INTERFACE = "radio0"
BROADCAST = "10.77.0.255"
_TIMEOUT_S = 20


def why_not() -> str:
    """Return why there can be no namespaces here; empty if there can."""
    if os.geteuid() != 0:
        return "network namespaces need root"
    name = f"murmur-try-{os.getpid()}"
    try:
        _ip("netns", "add", name)
    except (OSError, subprocess.SubprocessError) as error:
        return f"no network namespaces: {error}"
    try:
        _ip("-n", name, "link", "add", "try0", "type", "bridge")
        _ip("-n", name, "link", "add", "try1", "type", "veth", "peer", "name", "try2")
    except subprocess.SubprocessError as error:
        return f"no bridges or virtual cables: {error}"
    finally:
        _ip("netns", "del", name)
    return ""


@dataclass(frozen=True)
class Hosts:
    """Hosts with the interface `INTERFACE`, the first half at one bridge and the rest at the other."""

    names: tuple[str, ...]
    hub: str

    def address(self, number: int) -> str:
        return f"10.77.0.{number + 1}"

    def on(self, number: int, action: Callable[[], Result]) -> Result:
        """Call a function in the namespace of a host."""

        def enter() -> Result:
            with Path(f"/run/netns/{self.names[number]}").open() as namespace:
                if ctypes.CDLL(None, use_errno=True).setns(namespace.fileno(), 0):
                    raise OSError(ctypes.get_errno(), "setns")
            return action()

        with ThreadPoolExecutor(1) as pool:  # a new thread: the namespace is the thread's
            return pool.submit(enter).result(_TIMEOUT_S)

    def plug(self, *, in_: bool) -> None:
        """Plug the cable between the two bridges in, or pull it."""
        _ip("-n", self.hub, "link", "set", "cable", "up" if in_ else "down")

    def second_interface(self, number: int, other: int) -> None:
        """Connect two hosts by a cable of their own, at interfaces named ``other0``."""
        for host, peer, index in ((number, other, 0), (other, number, 1)):
            if not index:
                _ip("-n", self.names[host], "link", "add", "other0", "type", "veth", "peer", "name", "other0",
                    "netns", self.names[peer])  # fmt: skip
            _ip("-n", self.names[host], "addr", "add", f"10.78.0.{index + 1}/24", "dev", "other0")
        for host in (number, other):
            _ip("-n", self.names[host], "link", "set", "other0", "up")

    def unplug_second_interface(self, number: int) -> None:
        """Remove the interface ``other0`` of a host, and of the host at the other end of its cable."""
        _ip("-n", self.names[number], "link", "del", "other0")


@contextlib.contextmanager
def hosts(count: int) -> Iterator[Hosts]:
    """Make hosts, and remove them at the end of this context."""
    names = tuple(f"murmur-h{number}-{os.getpid()}" for number in range(count))
    hub = f"murmur-hub-{os.getpid()}"
    with contextlib.ExitStack() as stack:
        for name in (hub, *names):
            _ip("netns", "add", name)
            stack.callback(_ip, "netns", "del", name)
        for bridge in ("one", "two"):
            _ip("-n", hub, "link", "add", bridge, "type", "bridge", "mcast_snooping", "0")
            _ip("-n", hub, "link", "set", bridge, "up")
        _ip("-n", hub, "link", "add", "cable", "type", "veth", "peer", "name", "end")
        for device, bridge in (("cable", "one"), ("end", "two")):
            _ip("-n", hub, "link", "set", device, "master", bridge, "up")
        made = Hosts(names, hub)
        for number, name in enumerate(names):
            port = f"port{number}"
            _ip("-n", hub, "link", "add", port, "type", "veth", "peer", "name", INTERFACE, "netns", name)
            _ip("-n", hub, "link", "set", port, "master", "one" if 2 * number < count else "two", "up")
            _ip("-n", name, "link", "set", "lo", "up")
            _ip("-n", name, "addr", "add", f"{made.address(number)}/24", "brd", "+", "dev", INTERFACE)
            _ip("-n", name, "link", "set", INTERFACE, "up")
        yield made


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True, timeout=_TIMEOUT_S)
