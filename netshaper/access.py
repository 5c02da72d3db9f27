"""Access control of the hub: the messages that each participant may send and receive, with one credential each.

Credentials are new for each run. A robot may put messages only under its own name, and receives only messages for it.
It sees only the subscriptions of relay, world, recorder, viewer, and of its own name, so it cannot find another robot
and bypass the relay. `protocol.rights` has the table of senders and receivers.

Robots may join through a router (`netshaper.router`). The router applies the same rules to each of them, and the hub
gives the router the union of their rights.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from protocol import keys as names
from protocol import rights
from protocol.keys import Keys
from protocol.zenoh_bus import Credential

PASSWORDS, CERTIFICATES = "usernames", "cert_common_names"
"""Zenoh's names for the two ways in which the hub identifies a client."""


def participants(robots: int) -> list[str]:
    """Return the names of all clients of a run with the given number of robots."""
    return [names.WORLD, names.RECORDER, names.VIEW, *(names.robot(number) for number in range(robots))]


def issue(run: str, hub: str, robots: int) -> dict[str, Credential]:
    """Make new credentials for all clients of a run, by name."""
    return passwords(run, hub, participants(robots))


def passwords(run: str, hub: str, clients: Iterable[str]) -> dict[str, Credential]:
    """Make new credentials for the clients of one hub or router, by name."""
    return {name: Credential(run, name, hub, secrets.token_urlsafe(18)) for name in clients}


def rules(keys: Keys, clients: Mapping[str, Sequence[str]], by: str = PASSWORDS) -> dict[str, Any]:
    """Return the hub's access control in zenoh's form: deny by default, at most five rules per participant.

    `clients` has the participants that each client represents; `by` is `PASSWORDS` or `CERTIFICATES`.
    """
    everyone = list(
        dict.fromkeys([*participants(0), *(name for group in clients.values() for name in group)])
    )
    config: dict[str, Any] = {"enabled": True, "default_permission": "deny"}
    config["rules"], config["subjects"], config["policies"] = [], [], []
    for client, group in clients.items():
        allowed = [rule for name in group for rule in _rules_of(keys, name, everyone)]
        _allow(config, {"id": client, by: [client]}, allowed)
    return config


def router_rules(keys: Keys, robots: Sequence[str]) -> dict[str, Any]:
    """Return a router's access control: the hub's rules for its robots, with the flows reversed towards the hub."""
    config = rules(keys, {robot: [robot] for robot in robots})
    _allow(
        config,
        {"id": names.RELAY, CERTIFICATES: [names.RELAY]},
        [_reversed(rule) for rule in config["rules"]],
    )
    return config


def _rules_of(keys: Keys, name: str, everyone: list[str]) -> list[dict[str, Any]]:
    inbox = keys.inbox(name)
    seen = rights.receivers(name, everyone)
    if name != names.VIEW:
        seen = [*seen, name]  # to find another process of its name
    allowed = {
        "put": ("put", "ingress", rights.may_put(keys, name)),
        "receive": ("put", "egress", [inbox]),
        "subscribe": ("declare_subscriber", "ingress", [inbox]),
        "presence": ("liveliness_token", "ingress", [keys.alive(name)]),
        # A client sends messages only to subscriptions that it knows.
        "discover": ("declare_subscriber", "egress", [keys.inbox(other) for other in seen]),
    }
    return [
        {
            "id": f"{name}-{right}",
            "permission": "allow",
            "messages": [message],
            "flows": [flow],
            "key_exprs": expressions,
        }
        for right, (message, flow, expressions) in allowed.items()
        if expressions
    ]


def _reversed(rule: dict[str, Any]) -> dict[str, Any]:
    """Return a rule for the other end of a connection."""
    (flow,) = rule["flows"]
    return rule | {"id": f"{rule['id']}-on", "flows": ["egress" if flow == "ingress" else "ingress"]}


def _allow(config: dict[str, Any], subject: dict[str, Any], allowed: list[dict[str, Any]]) -> None:
    config["rules"] += allowed
    config["subjects"].append(subject)
    config["policies"].append({"rules": [rule["id"] for rule in allowed], "subjects": [subject["id"]]})
