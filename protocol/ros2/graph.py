"""Nodes of a ROS 2 domain, and their publishers, subscriptions, and services, read from liveliness tokens."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import zenoh

from protocol.errors import ProtocolError
from protocol.ros2.tokens import ROOT, EndpointToken, Kind, NodeToken, parse_token

TIMEOUT_S = 1.0
"""Tokens that arrive within this time count."""


@dataclass(frozen=True)
class Graph:
    """The nodes and endpoints of a domain, sorted."""

    nodes: tuple[NodeToken, ...] = ()
    endpoints: tuple[EndpointToken, ...] = ()

    def names(self, *kinds: Kind) -> dict[str, list[str]]:
        """Return the topics (or services) that endpoints of these kinds have: qualified name to types."""
        found: dict[str, set[str]] = {}
        for each in self.endpoints:
            if each.kind in kinds:
                found.setdefault(each.data_key.name, set()).add(each.data_key.type)
        return {name: sorted(types) for name, types in sorted(found.items())}

    @property
    def topics(self) -> dict[str, list[str]]:
        """Types of each topic."""
        return self.names(Kind.PUBLISHER, Kind.SUBSCRIPTION)

    @property
    def services(self) -> dict[str, list[str]]:
        """Types of each service that has a server."""
        return self.names(Kind.SERVER)

    def of_topic(self, name: str, kind: Kind) -> list[EndpointToken]:
        """Return the endpoints of one kind that a topic or service has."""
        return [each for each in self.endpoints if each.kind is kind and each.data_key.name == name]


def parse_graph(tokens: list[str]) -> Graph:
    """Return the graph that liveliness tokens describe; malformed tokens are ignored."""
    nodes, endpoints = [], []
    for token in sorted(set(tokens)):
        with suppress(ProtocolError):
            parsed = parse_token(token)
            if isinstance(parsed, NodeToken):
                nodes.append(parsed)
            else:
                endpoints.append(parsed)
    return Graph(tuple(nodes), tuple(endpoints))


def read_graph(session: zenoh.Session, domain: int) -> Graph:
    """Ask for all tokens of a domain."""
    return parse_graph(_tokens(session, f"{ROOT}/{domain}/**"))


def read_domains(session: zenoh.Session) -> set[int]:
    """Return the domains in which nodes are visible."""
    return {each.domain for each in parse_graph(_tokens(session, f"{ROOT}/**")).nodes}


def _tokens(session: zenoh.Session, key: str) -> list[str]:
    """Ask for the tokens that match a key expression."""
    replies = session.liveliness().get(key, timeout=TIMEOUT_S)
    return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]
