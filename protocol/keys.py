"""Key expressions of the bus: plane, direction, sender and receiver of a message.

``murmur/<run>/<plane>/tx/<from>/...`` goes to the relay, ``murmur/<run>/<plane>/rx/<to>/<from>`` to a receiver. Every
participant except the relay subscribes to one expression: all keys with its own name after ``rx``. One expression is
one queue, so messages from one sender arrive in order.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache

RELAY = "relay"
WORLD = "world"
RECORDER = "recorder"
VIEW = "view"


def robot(number: int) -> str:
    """Name of robot `number` on the bus."""
    return f"r{number}"


ROUTER = "router@"


def router(host: str) -> str:
    """Name of the router through which the robots of a host join; it sends no messages of its own."""
    return ROUTER + host


@lru_cache(maxsize=1024)
def is_robot(name: str) -> bool:
    """Whether a name is that of a robot."""
    return re.fullmatch("r(0|[1-9][0-9]{0,8})", name) is not None


@lru_cache(maxsize=1024)
def number(name: str) -> int:
    """Return the number of the robot called `name`; ValueError for any other name."""
    if not is_robot(name):
        raise ValueError(f"{name!r} is not the name of a robot, such as r0")
    return int(name[1:])


@dataclass(frozen=True)
class Keys:
    """The keys of one run; its name consists of letters, digits, `-`, `_` and dots."""

    run: str

    def __post_init__(self) -> None:
        if not re.fullmatch("[A-Za-z0-9._-]+", self.run):
            raise ValueError(f"a run cannot be called {self.run!r}: use letters, digits, '-', '_' and '.'")

    def radio_tx(self, sender: str) -> str:
        """The radio plane from `sender` to the relay: frames to be sent."""
        return f"murmur/{self.run}/radio/tx/{sender}"

    def radio_rx(self, receiver: str, sender: str) -> str:
        """The radio plane from the relay to `receiver`: frames that it receives."""
        return f"murmur/{self.run}/radio/rx/{receiver}/{sender}"

    def body(self, receiver: str, sender: str) -> str:
        """The body plane: between a robot and its sensors and motors, which the world simulates."""
        return f"murmur/{self.run}/body/rx/{receiver}/{sender}"

    def control(self, receiver: str, sender: str) -> str:
        """The control plane: step barrier, phases, reports."""
        return f"murmur/{self.run}/control/rx/{receiver}/{sender}"

    def control_tx(self, sender: str) -> str:
        """The control plane from `sender` to the relay."""
        return f"murmur/{self.run}/control/tx/{sender}"

    def inbox(self, name: str) -> str:
        """The expression that `name` subscribes to."""
        if name == RELAY:
            return f"murmur/{self.run}/*/tx/**"
        return f"murmur/{self.run}/*/rx/{name}/**"

    def alive(self, name: str) -> str:
        """Liveliness token of `name`; `*` stands for all."""
        return f"murmur/{self.run}/alive/{name}"

    def presence(self, name: str) -> str:
        """The key under which the relay's bus reports that `name` joined (payload ``1``) or left (``0``)."""
        return f"murmur/{self.run}/presence/tx/{name}"


@lru_cache(maxsize=1 << 15)
def parts(key: str) -> tuple[str, str, str, str]:
    """Split a key into (plane, tx or rx, first name, second name or empty)."""
    fields = key.split("/")
    return fields[2], fields[3], fields[4], fields[5] if len(fields) > 5 else ""


def may_be_dropped(key: str) -> bool:
    """Whether messages under a key are dropped when the network is congested: those to a viewer."""
    _, direction, receiver, _ = parts(key)
    return direction == "rx" and receiver == VIEW
