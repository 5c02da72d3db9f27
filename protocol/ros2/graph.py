"""Nodes of a ROS 2 domain, and their publishers, subscriptions, and services, read from liveliness tokens."""

from __future__ import annotations

from dataclasses import dataclass, field

import zenoh

from protocol.errors import ProtocolError
from protocol.ros2.tokens import ROOT, EndpointToken, Kind, NodeToken, all_tokens, parse_token


@dataclass(frozen=True)
class Graph:
    """The nodes and endpoints of a domain, sorted; `malformed` has an error for each token that cannot be read."""

    nodes: tuple[NodeToken, ...] = ()
    endpoints: tuple[EndpointToken, ...] = ()
    malformed: tuple[str, ...] = field(default=())

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
    """Return the graph that liveliness tokens describe."""
    nodes, endpoints, malformed = [], [], []
    for token in sorted(set(tokens)):
        try:
            parsed = parse_token(token)
        except ProtocolError as error:
            malformed.append(str(error))
            continue
        if isinstance(parsed, NodeToken):
            nodes.append(parsed)
        else:
            endpoints.append(parsed)
    return Graph(tuple(nodes), tuple(endpoints), tuple(malformed))


def read_graph(session: zenoh.Session, domain: int, timeout_s: float) -> Graph:
    """Ask for all tokens of a domain; those that arrive within `timeout_s` count."""
    replies = session.liveliness().get(all_tokens(domain), timeout=timeout_s)
    return parse_graph([str(reply.ok.key_expr) for reply in replies if reply.ok is not None])


def read_domains(session: zenoh.Session, timeout_s: float) -> set[int]:
    """Return the domains in which nodes are visible."""
    replies = session.liveliness().get(f"{ROOT}/**", timeout=timeout_s)
    return {
        each.domain for each in parse_graph([str(reply.ok.key_expr) for reply in replies if reply.ok]).nodes
    }
